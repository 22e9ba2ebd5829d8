"""Moving planes of a key frame pair: robust estimate of (12) in [MVO] with its gauge settled.

A region of a few macroblocks fixes its mean motion well, its growth less, the tilt of its plane
hardly. The tilt therefore has a prior (surfaces of vehicles and people are upright), whose
variance shows in the covariance where the vectors add nothing.
"""

from dataclasses import dataclass

from mv_slapse.geometry import moving_plane
from mv_slapse.geometry.camera import to_rays
from mv_slapse.geometry.epipolar import derotate
from mv_slapse.geometry.moving_plane import LOG_DEPTH, RATE, SLOPE
from mv_slapse.records import ScalePrior
import numpy as np

MIN_BLOCKS = 4
ITERATIONS = 10
INLIER = 3.0  # [sigma], also the scale of the robust kernel
YAW_SIGMA = 1.0  # tangent of the angle between a surface and the picture plane
UPRIGHT_SIGMA = {True: 0.3, False: 0.5}  # the same against the vertical; ground known or not
FREE_SIGMA = 1.0  # of ln Z where only the smallest motion settles it
FREE_DEPTH = (3.0, 60.0)  # [baseline] between which the smallest motion may lie
LEVEL = np.array([0.0, 1.0, 0.0])  # "down" for a camera of unknown tilt


@dataclass(frozen=True)
class MovingPlane:
    """A moving plane of one key frame pair; lengths in the unit of ``t_cur_from_prev``.

    Attributes
    ----------
    plane, t_d : (3,), (3,) float64
        n / d in camera k and displacement from k to k-1, (11) of [MVO].
    product : (3, 3) float64
        (t - t_d) plane^T, what two views observe.
    covariance : (6, 6) float64
        Of (plane, t_d), long along the gauge.
    scale_prior : ScalePrior
        What settled the gauge.
    closing, closing_variance : float, float
        Share of its depth that the surface lost during the pair; of the same scale at any depth.
    centre : (2,) float64
        Ray (x, y, 1) of the region's centre in camera k.
    inlier : (N,) bool
        Correspondences that agree.
    rms : float
        Of the inliers' errors, in their own standard deviations.
    """

    plane: np.ndarray
    t_d: np.ndarray
    product: np.ndarray
    covariance: np.ndarray
    scale_prior: ScalePrior
    closing: float
    closing_variance: float
    centre: np.ndarray
    inlier: np.ndarray
    rms: float


@dataclass(frozen=True)
class _Region:
    """What the fit reads: rays, matches and noise of one region."""

    rays: np.ndarray
    x_prev: np.ndarray
    sigma: np.ndarray
    K: np.ndarray
    R_cur_from_prev: np.ndarray
    centre: np.ndarray

    def errors(self, theta):
        """Return errors (N, 2) and Jacobian (N, 2, 5), both in standard deviations."""
        x_prev, jacobian = moving_plane.transfer(theta, self.rays, self.centre, self.K,
                                                 self.R_cur_from_prev)
        return ((self.x_prev - x_prev) / self.sigma[:, None],
                jacobian / self.sigma[:, None, None])


def time_to_contact(closing: float, variance: float, dt: float) -> tuple[float, float]:
    """Time until the seen surface reaches the camera's plane, and its variance [s], [s^2].

    With the product M = (t - t_d) plane^T and the ray r of the region's centre, -M r is the
    surface's displacement relative to the camera over its depth Z. Its third coordinate is -s:
    in dt the depth shrinks by s Z, so tau = Z / (s Z / dt) = dt / s, in which no scale is left.

    Parameters
    ----------
    closing, variance : float
        s and its variance; infinite times where s is not positive.
    dt : float
        Time of the pair [s].
    """
    if closing <= 0:
        return np.inf, np.inf
    return dt / closing, dt**2 * variance / closing**4


def fit_moving_plane(x_cur, x_prev, sigma, block, K, R_cur_from_prev, t_cur_from_prev,
                     ground=None, previous=None) -> MovingPlane | None:
    """Estimate the plane and the displacement of a moving region, (12) of [MVO].

    Parameters
    ----------
    x_cur, x_prev : (N, 2) arrays
        Block centres in key frame k and their matches in the previous one, undistorted [px].
    sigma : (N,) array
        Standard deviation of a coordinate of ``x_prev`` [px].
    block : (N, 2) array
        Width and height of the blocks [px].
    K, R_cur_from_prev, t_cur_from_prev : (3, 3), (3, 3), (3,) arrays
        Intrinsics [px] and camera motion; its length is the unit (zero: standing camera, then
        the unit is the ground's).
    ground : (3,) array, optional
        Ground plane n / d in camera k, in the same unit.
    previous : MovingPlane, optional
        The region's estimate of the previous pair, a start for the iteration.

    Returns
    -------
    moving : MovingPlane or None
        None where fewer than 4 vectors, or less than half of them, agree on a motion.
    """
    if len(x_cur) < MIN_BLOCKS:
        return None
    rays = to_rays(K, np.asarray(x_cur, float))
    region = _Region(rays, np.asarray(x_prev, float), np.asarray(sigma, float), K,
                     R_cur_from_prev, _middle(rays[:, :2]))
    rows, values = _tilt_prior(ground, region.centre)
    best = min((_minimise(region, start, rows, values) for start in _starts(region, previous)),
               key=lambda fit: _cost(region, fit[0]))
    return _settled(region, *best, np.asarray(x_cur, float), np.asarray(block, float),
                    np.asarray(t_cur_from_prev, float), ground)


def _middle(x):
    """Middle of the range, which a few blocks lost on one side do not move as they do a mean."""
    return 0.5 * (np.quantile(x, 0.05, axis=0) + np.quantile(x, 0.95, axis=0))


def _tilt_prior(ground, centre):
    """Return rows (2, 2) and values (2,) of the prior on (A, B), in standard deviations.

    Upright: the plane's normal ~ w is perpendicular to the ground's.
    """
    down = LEVEL if ground is None else ground / np.linalg.norm(ground)
    upright = 1 / UPRIGHT_SIGMA[ground is not None]
    rows = np.array([[1 / YAW_SIGMA, 0.0], upright * (down[:2] - down[2] * centre)])
    return rows, np.array([0.0, -upright * down[2]])


def _starts(region, previous):
    """Yield starts (5,): the median motion, and the previous pair's estimate."""
    still = derotate(to_rays(region.K, region.x_prev), region.R_cur_from_prev)
    yield np.r_[np.median(region.rays[:, :2] - still[:, :2], axis=0), 0.0, 0.0, 0.0]
    if previous is not None:
        yield np.r_[-previous.product @ np.r_[region.centre, 1.0], 0.0, 0.0]


def _minimise(region, theta, rows, values):
    """Return theta (5,) and its normal matrix after robust Gauss-Newton with the tilt's prior."""
    for _ in range(ITERATIONS):
        error, jacobian = region.errors(theta)
        squared = np.sum(error**2, axis=1)
        # Geman-McClure: a vector far off counts for nothing, so the mean cannot be dragged. While
        # the start is bad the kernel is as wide as what half of the vectors reach.
        weight = 1 / (1 + squared / max(2 * INLIER**2, 4 * np.median(squared)))**2
        normal = np.einsum('nij,n,nik->jk', jacobian, weight, jacobian)
        slope = np.einsum('nij,n,ni->j', jacobian, weight, error)
        normal[SLOPE, SLOPE] += rows.T @ rows
        slope[SLOPE] += rows.T @ (values - rows @ theta[SLOPE])
        # A growth of 1 in a pair is beyond any use; this keeps a column of blocks solvable.
        normal[2, 2] += 1.0
        slope[2] -= theta[2]
        theta = theta + np.linalg.solve(normal, slope)
    return theta, normal


def _cost(region, theta):
    """Return the truncated squared error."""
    return np.sum(np.minimum(np.sum(region.errors(theta)[0]**2, axis=1), INLIER**2))


def _settled(region, theta, normal, x_cur, block, t_cur_from_prev, ground):
    """Return the MovingPlane of a fit, or None where too few vectors agree."""
    squared = np.sum(region.errors(theta)[0]**2, axis=1)
    inlier = squared < 2 * INLIER**2
    n = int(inlier.sum())
    if n < max(MIN_BLOCKS, 0.5 * len(x_cur)) or not np.all(np.isfinite(theta)):
        return None
    # Vectors that scatter more than their sigma says widen the covariance; none narrow it.
    variance = np.sum(squared[inlier]) / max(2 * n - 5, 1)
    covariance = np.zeros((6, 6))
    covariance[:5, :5] = np.linalg.inv(normal) * max(1.0, variance)
    log_depth, gauge, prior = _gauge(theta, region, x_cur[inlier], block[inlier],
                                     t_cur_from_prev, ground)
    by_theta = np.vstack([np.eye(5, 6), gauge[:6]])
    covariance = by_theta @ covariance @ by_theta.T
    covariance[LOG_DEPTH, LOG_DEPTH] += gauge[6]
    full = np.r_[theta, log_depth]
    state, jacobian = moving_plane.to_plane(full, region.centre, t_cur_from_prev)
    return MovingPlane(state[:3], state[3:], moving_plane.product(full, region.centre),
                       jacobian @ covariance @ jacobian.T, prior, -theta[2], covariance[2, 2],
                       region.centre, inlier, float(np.sqrt(variance)))


def _gauge(theta, region, x_cur, block, t_cur_from_prev, ground):
    """Return ln Z, its (derivative by theta (6,), variance) as (7,), and the prior used."""
    gauge = np.zeros(7)
    if ground is not None:
        found = moving_plane.contact_depth(ground, moving_plane.contact(x_cur, block), region.K,
                                           theta[SLOPE], region.centre)
        if found is not None:
            gauge[SLOPE], gauge[6] = found.by_slope, found.variance
            return found.value, gauge, ScalePrior.GROUND_CONTACT
    gauge[6] = FREE_SIGMA**2
    return _smallest_motion(theta[RATE], t_cur_from_prev), gauge, ScalePrior.SMALLEST_MOTION


def _smallest_motion(rate, t_cur_from_prev):
    """Return the ln Z at which t_d = t - Z g is smallest, within sensible depths."""
    if not np.any(t_cur_from_prev):
        return float(np.mean(np.log(FREE_DEPTH)))
    nearest = rate @ t_cur_from_prev / max(rate @ rate, 1e-12)
    return float(np.log(np.clip(nearest, *FREE_DEPTH)))
