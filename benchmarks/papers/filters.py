"""The scene's extended Kalman filters of [SLAPSE] VI and [MVO] 5, with numerical Jacobians.

The papers give no process noise; what is chosen here stands in `RATES`. Stamps are in seconds, the
unit of length is the first baseline, as in [SLAPSE] VII-B.
"""

from mv_slapse.geometry import plane as planes_
from mv_slapse.geometry import rotation
from mv_slapse.geometry.camera import to_pixels, to_rays
import numpy as np
from scipy.spatial.transform import Rotation

from papers import two_views
from papers.two_views import Joint, View

# Random walks: of the angular velocity [rad/s^1.5], of the velocity as a share of it [1/s^0.5].
RATES = 0.3, 0.3
START_TURN, START_DIRECTION = 0.01, 0.03  # standard deviations of the first motion [rad]
NEW_PLANE = 10.0  # of a plane that nothing was known of, as a share of it
STEP = 1e-6


def euler(angles: np.ndarray) -> np.ndarray:
    """Return the rotation matrix of y-x-z Euler angles given as (about x, about y, about z)."""
    return Rotation.from_euler('YXZ', angles[[1, 0, 2]]).as_matrix()


def angles(R: np.ndarray) -> np.ndarray:
    """Return the y-x-z Euler angles of a rotation matrix as (about x, about y, about z)."""
    return Rotation.from_matrix(R).as_euler('YXZ')[[1, 0, 2]]


def jacobian(function, x: np.ndarray) -> np.ndarray:
    """Return the derivative (M, N) of a function of (N,) by central differences."""
    steps = STEP * np.eye(len(x))
    return np.array([function(x + s) - function(x - s) for s in steps]).T / (2 * STEP)


class Kalman:
    """State x (N,) and covariance P (N, N)."""

    def __init__(self, x: np.ndarray, P: np.ndarray):
        """Start."""
        self.x, self.P = x, P

    def predict(self, transition, noise: np.ndarray):
        """Move on by a function of state and noise; ``noise`` (K,) are variances."""
        none = np.zeros(len(noise))
        F = jacobian(lambda x: transition(x, none), self.x)
        G = jacobian(lambda n: transition(self.x, n), none)
        self.x = transition(self.x, none)
        self.P = F @ self.P @ F.T + (G * noise) @ G.T

    def update(self, residual, information: np.ndarray):
        """Take in residuals (M,), a function of the state, with information (M,) or (M, M)."""
        self.correct(residual(self.x), -jacobian(residual, self.x), information)

    def correct(self, off: np.ndarray, H: np.ndarray, information: np.ndarray):
        """Take in residuals (M,) of an observation whose derivative by the state is H (M, N)."""
        weighed = information[:, None] * H if information.ndim == 1 else information @ H
        self.P = np.linalg.solve(np.eye(len(self.x)) + self.P @ (H.T @ weighed), self.P)
        self.P = 0.5 * (self.P + self.P.T)
        self.x = self.x + self.P @ (weighed.T @ off)


class PlaneFilter(Kalman):
    """Planes (3 each) before twelve elements of the camera; what both filters have in common."""

    def __init__(self, x: np.ndarray, P: np.ndarray):
        """Start without planes."""
        super().__init__(x, P)
        self.ids: list[int] = []

    @property
    def planes(self) -> np.ndarray:
        """Return the planes (P, 3) of the state."""
        return self.x[:-12].reshape(-1, 3)

    def keep(self, ids):
        """Delete the planes that are not among ``ids``, VI-C of [SLAPSE]."""
        kept = np.array([id_ in ids for id_ in self.ids], bool)
        rows = np.r_[np.repeat(kept, 3), np.ones(12, bool)]
        self.ids = [id_ for id_ in self.ids if id_ in ids]
        self.x, self.P = self.x[rows], self.P[np.ix_(rows, rows)]

    def add(self, id_: int, plane: np.ndarray):
        """Add a plane that nothing is known of yet; its first update tells it."""
        at, n = len(self.x) - 12, len(self.x)
        order = np.r_[:at, n:n + 3, at:n]
        P = np.zeros((n + 3, n + 3))
        P[:n, :n] = self.P
        P[n:, n:] = (NEW_PLANE * np.linalg.norm(plane))**2 * np.eye(3)
        self.ids.append(id_)
        self.x, self.P = np.r_[self.x, plane][order], P[np.ix_(order, order)]

    def noise(self, dt: float) -> np.ndarray:
        """Return the variances of (angular velocity, velocity) after a time [s]."""
        turn, share = RATES
        speed = np.linalg.norm(self.x[-3:])
        return np.repeat([turn**2 * dt, (share * speed)**2 * dt], 3)


def started(R: np.ndarray, t: np.ndarray, dt: float, size: int) -> tuple:
    """Return camera part (12,) and covariance of a state after the first motion.

    ``R``, unit ``t``: X_prev = R X_cur + t. Of (angles, way, their rates): the way's length is
    the unit, without an error.
    """
    P = np.zeros((6, 6))
    P[:3, :3] = START_TURN**2 * np.eye(3)
    P[3:, 3:] = START_DIRECTION**2 * (np.eye(3) - np.outer(t, t))
    to_all = np.vstack([np.eye(6), np.eye(6) / dt])
    way = np.r_[angles(R), t]
    return np.r_[way, way / dt], to_all @ P @ to_all.T


class Slapse(PlaneFilter):
    """(17)-(19) of [SLAPSE]: planes in camera k, the last motion, and its rates.

    The motion is X_prev = R X_cur + t. The rate of a motion is per second, since key frames are
    not always equally far apart. Its pose is the product of the motions.
    """

    has_pose = False  # in its state

    def __init__(self, R: np.ndarray, t: np.ndarray, dt: float):
        """Start with the first motion."""
        super().__init__(*started(R, t, dt, 12))
        self.R_world, self.t_world = np.eye(3), np.zeros(3)

    @property
    def motion(self) -> tuple[np.ndarray, np.ndarray]:
        """Return R_prev_from_cur and t_prev_from_cur."""
        return euler(self.x[-12:-9]), self.x[-9:-6]

    def step(self, dt: float):
        """Predict, (18)."""
        def transition(x, noise):
            rate, speed = x[-6:-3] + noise[:3], x[-3:] + noise[3:]
            R, t = euler(rate * dt), speed * dt
            planes = x[:-12].reshape(-1, 3)
            planes = planes @ R / (1 + planes @ t)[:, None]
            return np.r_[planes.ravel(), rate * dt, t, rate, R.T @ speed]

        self.predict(transition, self.noise(dt))

    def observe(self, view: View, row: np.ndarray, sigma: np.ndarray):
        """Update with the matches of known planes, (19); ``row`` (N,) is the plane of each."""
        rays = to_rays(view.K, view.x_cur)

        def residual(x):
            there = two_views.transfer(rays, euler(x[-12:-9]), x[-9:-6],
                                       x[:-12].reshape(-1, 3)[row])
            return (view.x_prev - to_pixels(view.K, there)).ravel()

        self.update(residual, np.repeat(1 / sigma**2, 2))

    def advance(self):
        """Take the motion into the pose; returns it, X_world = R X_cam + t."""
        R, t = self.motion
        self.t_world = self.t_world + self.R_world @ t
        self.R_world = self.R_world @ R
        return self.R_world, self.t_world

    def in_camera(self) -> np.ndarray:
        """Return the planes (P, 3) in camera k."""
        return self.planes


class Mvo(PlaneFilter):
    """(13) of [MVO]: planes in {W}, the camera's pose in {W} and its rates.

    It observes the motion and the planes of (10), whose unit is the baseline, through the pose and
    the rates: a pose and the one before are not both in the state.
    """

    has_pose = True

    def __init__(self, R: np.ndarray, t: np.ndarray, dt: float):
        """Start with the first motion, X_prev = R X_cur + t, from the origin."""
        super().__init__(*started(R, t, dt, 12))
        self.dt = dt

    def step(self, dt: float):
        """Predict with constant velocity."""
        def transition(x, noise):
            rate, speed = x[-6:-3] + noise[:3], x[-3:] + noise[3:]
            R = euler(x[-12:-9]) @ euler(rate * dt)
            return np.r_[x[:-12], angles(R), x[-9:-6] + speed * dt, rate, speed]

        self.predict(transition, self.noise(dt))
        self.dt = dt

    def observe(self, found: Joint, ids: list[int]):
        """Update with (10), whose planes have these ids; all of them are in the state."""
        rows, B = [self.ids.index(id_) for id_ in ids], two_views.tangent(found.t)

        def residual(x):
            R_prev_from_cur, t_prev_from_cur = self._motion(x)
            R, t = R_prev_from_cur.T, -R_prev_from_cur.T @ t_prev_from_cur
            baseline = np.linalg.norm(t)
            planes = baseline * _in_camera(x)[rows]
            return -np.r_[rotation.log(R @ found.R.T), B.T @ t / baseline,
                          (planes - found.planes).ravel()]

        self.update(residual, found.information)

    def _motion(self, x):
        """Return R_prev_from_cur and t_prev_from_cur that the rates of a state amount to."""
        R = euler(x[-6:-3] * self.dt)
        return R, R @ euler(x[-12:-9]).T @ x[-3:] * self.dt

    @property
    def motion(self) -> tuple[np.ndarray, np.ndarray]:
        """Return R_prev_from_cur and t_prev_from_cur."""
        return self._motion(self.x)

    def add_in_camera(self, id_: int, plane: np.ndarray):
        """Add a plane (3,) that is given in camera k."""
        R, t = euler(self.x[-12:-9]), self.x[-9:-6]
        self.add(id_, planes_.transform(plane, R, t))

    def advance(self):
        """Return the pose, X_world = R X_cam + t."""
        return euler(self.x[-12:-9]), self.x[-9:-6].copy()

    def pose_covariance(self) -> np.ndarray:
        """Return the covariance (6, 6) of (position, rotation about the axes of {W})."""
        R = euler(self.x[-12:-9])
        J = np.zeros((6, 6))
        J[:3, 3:] = np.eye(3)
        J[3:, :3] = jacobian(lambda a: rotation.log(euler(a) @ R.T), self.x[-12:-9])
        return J @ self.P[-12:-6, -12:-6] @ J.T

    def in_camera(self) -> np.ndarray:
        """Return the planes (P, 3) in camera k."""
        return _in_camera(self.x)


def _in_camera(x: np.ndarray) -> np.ndarray:
    """Return the planes of a state (13) in its camera, (16)."""
    planes, t = x[:-12].reshape(-1, 3), x[-9:-6]
    return planes @ euler(x[-12:-9]) / (1 + planes @ t)[:, None]
