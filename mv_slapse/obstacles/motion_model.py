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

from mv_slapse.kernels.binding import compiled
import numpy as np

BEARING, LOG_DEPTH, RATE, SLOPE = slice(0, 2), slice(2, 3), slice(3, 6), slice(6, 8)
SIZE = SLOPE.stop
SLOPE_NOISE = 0.5  # [1/sqrt(s)] a surface may turn, and another face of it come into view
MANOEUVRE_TIME = 0.5  # [s] for which an acceleration lasts
SLOPE_LIMIT = 5.0  # steeper than this the surface is seen edge-on


class CameraStep(NamedTuple):
    """Motion of the camera between two key frames, in map units and seconds."""

    R_cur_from_prev: np.ndarray  # (3, 3)
    t_cur_from_prev: np.ndarray  # (3,)
    dt: float
    # (3,): velocity of the scene relative to the camera at the previous key frame, in its axes:
    # what the relative velocity there contains
    before: np.ndarray
    before_covariance: np.ndarray  # (3, 3)


class Motion(NamedTuple):
    """Cartesian form of a state: centre [unit], velocity in camera axes [unit/s], covariance."""

    position: np.ndarray
    velocity: np.ndarray
    covariance: np.ndarray


def predict(mu: np.ndarray, step: CameraStep, after: np.ndarray, after_covariance: np.ndarray,
            acceleration: float):
    """Move a state (8,) to the next key frame at constant velocity in {W}, (15) of [MVO].

    ``after`` (3,) is the velocity of the scene relative to the camera over this step, in current
    axes, with its covariance (3, 3); ``acceleration`` the obstacle's standard deviation
    [unit/s^2]. Returns mu, F, Q, or None where the obstacle passes behind the camera.
    """
    return compiled.predict_obstacle(mu, step, after, after_covariance, acceleration,
                                     MANOEUVRE_TIME, SLOPE_NOISE)


def to_cartesian(mu: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return position, relative velocity and w, (9,), and their derivative (9, 8)."""
    return compiled.obstacle_to_cartesian(mu)


def motion(mu: np.ndarray, P: np.ndarray, scene: np.ndarray,
           scene_covariance: np.ndarray) -> Motion:
    """Return position and velocity in the world, both in camera axes.

    ``scene`` (3,) is the velocity of the scene relative to the camera [unit/s]: an obstacle that
    stands still moves with it.
    """
    return Motion(*compiled.obstacle_motion(mu, P, scene, scene_covariance))


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
    return compiled.still_distance(mu, P, scene, scene_covariance, nearer)
