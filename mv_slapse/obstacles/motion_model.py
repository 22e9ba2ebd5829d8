"""State of a moving obstacle and how it moves: (14) and (15) of [MVO] in another chart.

[MVO] keeps plane n / d and velocity in {W}. There n / d is singular for a plane through the
origin, and depth and speed, which only their ratio is observed of, are both in every element.
The state here is relative to the camera of the newest key frame:

* bearing (2,): ray (x, y, 1) of the centre of the seen surface
* log_depth (1,): ln Z of the centre
* rate (3,): velocity relative to the camera over Z [1/s]; time to contact is -1 / rate[2]
* slope (2,): tilt of the plane, w = (A, B, 1 - A x - B y), plane = -w / Z

It is one to one with plane, velocity and the point of the plane that is followed. A pair's
observation (16) is the state itself, so that the update is linear and what two views cannot see
stays in one element; all curvature is in the prediction. (Aidala and Hammel's modified polar
coordinates, known from tracking by bearings, with a plane.)
"""

from typing import NamedTuple

import numpy as np

BEARING, LOG_DEPTH, RATE, SLOPE = slice(0, 2), slice(2, 3), slice(3, 6), slice(6, 8)
SIZE = 8
SLOPE_NOISE = 0.5  # [1/sqrt(s)] a surface may turn, and another face of it come into view
MANOEUVRE_TIME = 0.5  # [s] for which an acceleration lasts
SLOPE_LIMIT = 5.0  # steeper than this the surface is seen edge-on


class CameraStep(NamedTuple):
    """Motion of the camera between two key frames, in map units and seconds.

    Attributes
    ----------
    R_cur_from_prev, t_cur_from_prev : (3, 3), (3,) float64
    dt : float
    before, before_covariance : (3,), (3, 3) float64
        Velocity of the scene relative to the camera at the previous key frame, in its axes: what
        the relative velocity there contains.
    """

    R_cur_from_prev: np.ndarray
    t_cur_from_prev: np.ndarray
    dt: float
    before: np.ndarray
    before_covariance: np.ndarray


class Motion(NamedTuple):
    """Cartesian form of a state: centre [unit], velocity in camera axes [unit/s], covariance."""

    position: np.ndarray
    velocity: np.ndarray
    covariance: np.ndarray


def predict(mu: np.ndarray, step: CameraStep, after: np.ndarray, after_covariance: np.ndarray,
            acceleration: float):
    """Move a state to the next key frame at constant velocity in {W}, (15) of [MVO].

    Parameters
    ----------
    mu : (8,) array
    step : CameraStep
    after, after_covariance : (3,), (3, 3) arrays
        Velocity of the scene relative to the camera over this step, in current axes.
    acceleration : float
        Of the obstacle, standard deviation [unit/s^2].

    Returns
    -------
    mu, F, Q : (8,), (8, 8), (8, 8) arrays or None
        None where the obstacle passes behind the camera.
    """
    R, dt = step.R_cur_from_prev, step.dt
    cartesian, to = to_cartesian(mu)
    velocity = R @ (cartesian[3:6] - step.before)
    moved = np.r_[R @ cartesian[:3] + step.t_cur_from_prev + dt * velocity, velocity + after,
                  R @ cartesian[6:]]
    if moved[2] <= 0.05 * np.exp(mu[2]) or moved[6:] @ moved[:3] <= 0.05 * moved[2]:
        return None
    linear = np.kron(np.eye(3), R)
    linear[:3, 3:6] = dt * R
    back, from_ = from_cartesian(moved)
    noise = np.zeros((9, 9))
    noise[:6, :6] = _motion_noise(dt, acceleration, R @ step.before_covariance @ R.T,
                                  after_covariance)
    Q = from_ @ noise @ from_.T
    Q[SLOPE, SLOPE] += SLOPE_NOISE**2 * dt * np.eye(2)
    return back, from_ @ linear @ to, Q


def _motion_noise(dt, acceleration, before, after):
    """Covariance (6, 6) of position and relative velocity: acceleration and the camera's speed."""
    spectral_density = 2 * MANOEUVRE_TIME * acceleration**2
    pushed = spectral_density * np.array([[dt**3 / 3, dt**2 / 2], [dt**2 / 2, dt]])
    known = np.array([[dt**2, dt], [dt, 1.0]])
    return (np.kron(pushed, np.eye(3)) + np.kron(known, before)
            + np.kron(np.diag([0.0, 1.0]), after))


def to_cartesian(mu: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return position, relative velocity and w, (9,), and their derivative (9, 8)."""
    (x, y), depth, (A, B) = mu[BEARING], np.exp(mu[2]), mu[SLOPE]
    ray, w = np.array([x, y, 1.0]), np.array([A, B, 1 - A * x - B * y])
    jacobian = np.zeros((9, SIZE))
    jacobian[:3, BEARING] = depth * np.eye(3, 2)
    jacobian[:3, 2] = depth * ray
    jacobian[3:6, 2] = depth * mu[RATE]
    jacobian[3:6, RATE] = depth * np.eye(3)
    jacobian[8, BEARING] = -A, -B
    jacobian[6:, SLOPE] = np.vstack([np.eye(2), [-x, -y]])
    return np.r_[depth * ray, depth * mu[RATE], w], jacobian


def from_cartesian(cartesian: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the state (8,) of position, relative velocity and w at any scale, derivative (8, 9).

    The inverse of ``to_cartesian``; the position must lie in front of the camera.
    """
    X, V, w = cartesian[:3], cartesian[3:6], cartesian[6:]
    depth = X[2]
    ray, facing = X / depth, w @ X / X[2]
    slope = w[:2] / facing
    by_bearing = np.c_[np.eye(2), -ray[:2]] / depth
    jacobian = np.zeros((SIZE, 9))
    jacobian[BEARING, :3] = by_bearing
    jacobian[2, 2] = 1 / depth
    jacobian[RATE, 2] = -V / depth**2
    jacobian[RATE, 3:6] = np.eye(3) / depth
    jacobian[SLOPE, :3] = -np.outer(slope / facing, w[:2] @ by_bearing)
    jacobian[SLOPE, 6:] = (np.eye(2, 3) - np.outer(slope, ray)) / facing
    return np.r_[ray[:2], np.log(depth), V / depth, slope], jacobian


def motion(mu: np.ndarray, P: np.ndarray, scene: np.ndarray,
           scene_covariance: np.ndarray) -> Motion:
    """Return position and velocity in the world, both in camera axes.

    ``scene`` (3,) is the velocity of the scene relative to the camera [unit/s]: an obstacle that
    stands still moves with it.
    """
    cartesian, jacobian = to_cartesian(mu)
    covariance = jacobian[:6] @ P @ jacobian[:6].T
    covariance[3:, 3:] += scene_covariance
    return Motion(cartesian[:3], cartesian[3:6] - scene, covariance)


def plane(mu: np.ndarray) -> np.ndarray:
    """Return n / d (3,) in the camera frame."""
    return -to_cartesian(mu)[0][6:] / np.exp(mu[2])


def moving_statistic(mu: np.ndarray, P: np.ndarray, scene: np.ndarray,
                     scene_covariance: np.ndarray, nearer: float = 0.0) -> float:
    """How badly "it stands still" fits: smallest squared distance over all depths, chi2 of 3.

    A still surface at depth Z has rate = scene / Z. A depth known by a prior only can be wrong
    by far, so that the linear test of velocity / sigma would either see motion in it or miss
    motion that no depth explains; here the depth is free and pays for leaving its own Gaussian.
    ``nearer`` is a standard deviation of ln Z by which it may be nearer, but not farther. The
    scene's speed is wrong by a factor, as the depth is: however unsure, it is not zero.
    """
    speed = max(np.linalg.norm(scene), 1e-12)
    ahead = scene / speed
    along = ahead @ scene_covariance @ ahead
    variance = P[2, 2] + along / speed**2
    sigma = np.where(np.arange(81) < 40, np.sqrt(variance + nearer**2), np.sqrt(variance))
    offset = np.linspace(-4, 4, 81) * sigma
    gain = P[RATE, 2] / variance
    conditional = P[RATE, RATE] - np.outer(gain, P[RATE, 2])
    inverse_depth = np.exp(-(mu[2] + offset))[:, None]
    error = mu[RATE] + offset[:, None] * gain - inverse_depth * scene
    aside = scene_covariance - along * np.outer(ahead, ahead)
    S = conditional + inverse_depth[:, :, None]**2 * aside
    distance = np.einsum('ni,ni->n', error, np.linalg.solve(S, error[:, :, None])[:, :, 0])
    return float(np.min(distance + (offset / sigma)**2))
