"""Moving planes of [MVO]: (11), (12), and the filter (14)-(16), one for each plane.

All hold as printed. But (12) tells only the product (t - t_d) plane^T: any distance fits a pair,
with a speed to match, and a constant velocity does not tell it later. Here it is that at which the
plane's lower edge stands on the road, where the scene's filter has one, else roughly that of the
smallest motion; the filter is told what (12) and this are worth.
"""

from typing import NamedTuple

from mv_slapse.geometry import plane
from mv_slapse.geometry.blocks import MACROBLOCK
from mv_slapse.geometry.camera import to_rays, UP
from mv_slapse.movers.moving_plane import homography
import numpy as np
from scipy.optimize import least_squares

from papers import moving_plane
from papers.filters import Kalman
from papers.moving_plane import LOG_DEPTH, RATE, SLOPE
from papers.two_views import View

LEVEL = 0.95  # cosine of a road's normal against the vertical of a camera that looks ahead
FREE, NEAREST, FARTHEST = 1.0, 3.0, 60.0  # smallest motion: error of ln Z, bounds [baseline]
ACCELERATION = 0.3  # velocity's random walk, as a share of the camera's speed [1/s^0.5]
UNKNOWN = 10.0  # of a plane that nothing was known of and, in camera's speeds, of its velocity


class Observed(NamedTuple):
    """A moving plane of a pair in camera k: (plane, t_d) (6,), and its information (6, 6)."""

    z: np.ndarray
    information: np.ndarray


def observed(view: View, R: np.ndarray, t: np.ndarray, road: np.ndarray | None,
             sigma: float, tilt: float = np.inf) -> Observed:
    """Minimise (12) for the matches of one plane; R, t as in [MVO], t in the unit of the map.

    ``road`` (3,) is n / d in camera k, ``sigma`` of a match [px]. The minimum is sought over the
    five numbers that (12) depends on: rate, the relative displacement over the depth Z of the
    blocks' middle, and slope, which ``tilt`` holds near zero: by a standard deviation of it.
    """
    centre, at = to_rays(view.K, view.x_cur)[:, :2].mean(0), np.c_[view.x_cur, np.ones(
        len(view.x_cur))]

    def errors(theta):
        H = homography(moving_plane.product(theta, centre), view.K, R)
        there = at @ H.T
        return np.r_[(there[:, :2] / there[:, 2:] - view.x_prev).ravel(),
                     sigma / tilt * theta[SLOPE]]

    fit = least_squares(errors, np.zeros(5), method='lm')
    log_depth, by_theta, variance = _distance(fit.x, centre, view, t, road)
    information = np.outer(by_theta, by_theta) / variance
    information[:5, :5] += fit.jac.T @ fit.jac / sigma**2
    z, jacobian = moving_plane.to_plane(np.r_[fit.x, log_depth], centre, t)
    back = np.linalg.inv(jacobian)
    return Observed(z, back.T @ information @ back)


def _distance(theta, centre, view, t, road):
    """Return ln Z, the derivative (6,) of what is known of it by (theta, ln Z), its variance."""
    by_theta = np.eye(6)[LOG_DEPTH]
    if road is not None:
        edge = moving_plane.contact(view.x_cur, np.full(view.x_cur.shape, MACROBLOCK))
        found = moving_plane.contact_depth(road, edge, view.K, theta[SLOPE], centre)
        if found is not None:
            by_theta[SLOPE] = -found.by_slope
            return found.value, by_theta, found.variance
    baseline, rate = np.linalg.norm(t), theta[RATE]
    least = np.clip(rate @ t / max(rate @ rate, 1e-12), NEAREST * baseline, FARTHEST * baseline)
    return np.log(least), by_theta, FREE**2


def road_of(planes: np.ndarray) -> np.ndarray | None:
    """Return the levellest of planes (P, 3) below the camera, None where none is level."""
    level = planes @ UP / np.linalg.norm(planes, axis=1)
    return planes[level.argmax()] if level.max(initial=0) > LEVEL else None


def moved(x: np.ndarray, dt: float) -> tuple[np.ndarray, np.ndarray]:
    """Return the state (6,) after a time, (15), and the derivative (6, 6)."""
    n, v = x[:3], x[3:]
    share = 1 / (1 - n @ v * dt)
    F = np.eye(6)
    F[:3, :3] = share * np.eye(3) + share**2 * dt * np.outer(n, v)
    F[:3, 3:] = share**2 * dt * np.outer(n, n)
    return np.r_[share * n, v], F


def seen(x: np.ndarray, R: np.ndarray, t: np.ndarray, dt: float) -> tuple[np.ndarray, np.ndarray]:
    """Return (16) of a state, X_W = R X_cam + t, and the derivative (6, 6)."""
    n, share = x[:3], 1 / (1 + x[:3] @ t)
    H = np.zeros((6, 6))
    H[:3, :3] = share * R.T @ (np.eye(3) - share * np.outer(n, t))
    H[3:, 3:] = -dt * R.T
    return np.r_[share * R.T @ n, -dt * R.T @ x[3:]], H


class Obstacle(Kalman):
    """(14): plane and velocity (6,) in {W}."""

    def __init__(self, first: Observed, R: np.ndarray, t: np.ndarray, dt: float, speed: float):
        """Start where a pair shows it; ``speed`` is the camera's."""
        n, v = plane.transform(first.z[:3], R, t), -R @ first.z[3:] / dt
        size = np.repeat([np.linalg.norm(n), speed], 3)
        super().__init__(np.r_[n, v], np.diag((UNKNOWN * size)**2))
        self.observe(first, R, t, dt)

    def step(self, dt: float, speed: float):
        """Predict, (15)."""
        self.x, F = moved(self.x, dt)
        self.P = F @ self.P @ F.T
        self.P[3:, 3:] += (ACCELERATION * speed)**2 * dt * np.eye(3)

    def observe(self, found: Observed, R: np.ndarray, t: np.ndarray, dt: float):
        """Update, (16)."""
        z, H = seen(self.x, R, t, dt)
        self.correct(found.z - z, H, found.information)

    def shown(self, view: View, R: np.ndarray, t: np.ndarray, velocity: np.ndarray):
        """Return box (4,) [px], place and velocity (3,) in {W}, and time to contact, in a row.

        The place is where the ray of the middle of the blocks of ``view`` meets the plane; None
        where it does not. ``velocity`` is the camera's.
        """
        n = seen(self.x, R, t, 0.0)[0][:3]
        low, high = view.x_cur.min(0) - MACROBLOCK / 2, view.x_cur.max(0) + MACROBLOCK / 2
        ray = to_rays(view.K, 0.5 * (low + high)[None])[0]
        inverse, closing = -n @ ray, n @ R.T @ (self.x[3:] - velocity)
        if not inverse > 0:
            return None
        return (*low, *(high - low), *(R @ ray / inverse + t), *self.x[3:],
                1 / closing if closing > 0 else np.inf)
