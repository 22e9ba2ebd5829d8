"""Moving planes of a key frame pair: robust estimate of (12) in [MVO] with its gauge settled.

A region of a few macroblocks fixes its mean motion well, its growth less, the tilt of its plane
hardly. The tilt therefore has a prior (surfaces of vehicles and people are upright), whose
variance shows in the covariance where the vectors add nothing.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

from mv_slapse.geometry import moving_plane
from mv_slapse.geometry.camera import to_rays
from mv_slapse.geometry.epipolar import derotate
from mv_slapse.geometry.moving_plane import LOG_DEPTH, RATE, SLOPE
from mv_slapse.records import ScalePrior
import numpy as np

MIN_BLOCKS = 4
ITERATIONS = 10
CONVERGED = 1e-2  # [sigma^2] by which the next iteration would lower the cost
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
class Regions:
    """Blocks of several regions, one region after the other.

    Attributes
    ----------
    rays : (N, 3) float64
        Of key frame k.
    x_prev, sigma : (N, 2), (N,) float64
        Matches in the previous key frame and their standard deviation [px].
    first : (R,) int
        Where each region begins.
    """

    rays: np.ndarray
    x_prev: np.ndarray
    sigma: np.ndarray
    first: np.ndarray

    @cached_property
    def size(self) -> np.ndarray:
        """Return the number of blocks of each region, (R,)."""
        return np.diff(self.first, append=len(self.rays))

    @cached_property
    def number(self) -> np.ndarray:
        """Return the number of each block's region, (N,)."""
        return np.repeat(np.arange(len(self.first)), self.size)

    def rank(self, values: np.ndarray, share: float) -> np.ndarray:
        """Return the value (R,) below which a share of each region's values (N,) lies."""
        order = np.lexsort((values, self.number))
        return values[order[self.first + np.round(share * (self.size - 1)).astype(int)]]


class Surfaces(NamedTuple):
    """Moving planes of several regions, their gauge still open.

    Attributes
    ----------
    theta, normal : (R, 5), (R, 5, 5) float64
        Rate and slope as in geometry.moving_plane, and the normal matrix of their estimate.
    centre : (R, 2) float64
        First two coordinates of the ray they are about.
    squared : (N,) float64
        Squared error of each block in standard deviations.
    inlier : (N,) bool
    variance : (R,) float64
        Of the inliers' errors: 1 where they scatter as sigma says.
    """

    theta: np.ndarray
    normal: np.ndarray
    centre: np.ndarray
    squared: np.ndarray
    inlier: np.ndarray
    variance: np.ndarray

    @property
    def covariance(self) -> np.ndarray:
        """Return the covariance (R, 5, 5) of theta.

        Vectors that scatter more than their sigma says widen it; none narrow it.
        """
        return np.linalg.inv(self.normal) * np.maximum(1.0, self.variance)[:, None, None]

    def only(self, i: int, regions: Regions) -> 'Surfaces':
        """Return the surface of region i alone."""
        one, its = slice(i, i + 1), slice(regions.first[i], regions.first[i] + regions.size[i])
        return Surfaces(self.theta[one], self.normal[one], self.centre[one], self.squared[its],
                        self.inlier[its], self.variance[one])


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
                     ground=None) -> MovingPlane | None:
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

    Returns
    -------
    moving : MovingPlane or None
        None where fewer than 4 vectors, or less than half of them, agree on a motion.
    """
    if len(x_cur) < MIN_BLOCKS:
        return None
    x_cur = np.asarray(x_cur, float)
    region = Regions(to_rays(K, x_cur), np.asarray(x_prev, float), np.asarray(sigma, float),
                     np.zeros(1, int))
    fit = fit_surfaces(region, K, R_cur_from_prev, ground)
    return settled(fit, x_cur, np.asarray(block, float), K, np.asarray(t_cur_from_prev, float),
                   ground)


def fit_surfaces(regions: Regions, K: np.ndarray, R_cur_from_prev: np.ndarray,
                 ground: np.ndarray | None) -> Surfaces:
    """Estimate rate and slope of all regions at once: robust Gauss-Newton, (12) of [MVO].

    Parameters
    ----------
    regions : Regions
        At least one.
    K, R_cur_from_prev : (3, 3), (3, 3) arrays
    ground : (3,) array or None
        Ground plane n / d in camera k, any unit: it tells what is upright.
    """
    rays, size = regions.rays[:, :2], regions.size
    # The middle of the range does not move, as a mean does, with a few blocks lost on one side.
    centre = np.stack([0.5 * (regions.rank(x, 0.05) + regions.rank(x, 0.95)) for x in rays.T], 1)
    theta = np.zeros((len(centre), 5))
    parallax = rays - derotate(to_rays(K, regions.x_prev), R_cur_from_prev)[:, :2]
    theta[:, :2] = np.stack([regions.rank(m, 0.5) for m in parallax.T], 1)
    prior = _tilt_prior(ground, centre)
    for _ in range(ITERATIONS):
        error, jacobian = _errors(regions, theta, centre, K, R_cur_from_prev)
        normal, slope = _normal_equations(regions, theta, error, jacobian, *prior)
        step = np.linalg.solve(normal, slope[:, :, None])[:, :, 0]
        theta += step
        if np.all(np.sum(step * slope, axis=1) < CONVERGED):
            break
    squared = np.sum(_errors(regions, theta, centre, K, R_cur_from_prev)[0]**2, axis=1)
    inlier = squared < 2 * INLIER**2
    n = np.add.reduceat(inlier.astype(float), regions.first)
    variance = np.add.reduceat(squared * inlier, regions.first) / np.maximum(2 * n - 5, 1)
    # A region of wrong vectors only must not look exact.
    variance[n < 0.5 * size] = np.inf
    return Surfaces(theta, normal, centre, squared, inlier, variance)


def _errors(regions, theta, centre, K, R_cur_from_prev):
    """Return errors (N, 2) and Jacobian (N, 2, 5), both in standard deviations."""
    x_prev, jacobian = moving_plane.transfer(
        theta[regions.number], regions.rays, centre[regions.number], K, R_cur_from_prev)
    return ((regions.x_prev - x_prev) / regions.sigma[:, None],
            jacobian / regions.sigma[:, None, None])


def _normal_equations(regions, theta, error, jacobian, rows, values):
    """Return normal matrices (R, 5, 5) and right sides (R, 5) with robust weights and priors."""
    squared = np.sum(error**2, axis=1)
    # Geman-McClure: a vector far off counts for nothing, so the mean cannot be dragged. While
    # the start is bad the kernel is as wide as what half of the vectors reach.
    width = np.maximum(2 * INLIER**2, 4 * regions.rank(squared, 0.5))[regions.number]
    weighted = jacobian / ((1 + squared / width)**2)[:, None, None]
    normal = np.add.reduceat(np.swapaxes(weighted, 1, 2) @ jacobian, regions.first)
    slope = np.add.reduceat(np.sum(weighted * error[:, :, None], axis=1), regions.first)
    normal[:, SLOPE, SLOPE] += np.swapaxes(rows, 1, 2) @ rows
    missing = values - np.sum(rows * theta[:, None, SLOPE], axis=2)
    slope[:, SLOPE] += np.sum(rows * missing[:, :, None], axis=1)
    # A growth of 1 in a pair is beyond any use; this keeps a column of blocks solvable.
    normal[:, 2, 2] += 1.0
    slope[:, 2] -= theta[:, 2]
    return normal, slope


def _tilt_prior(ground, centre):
    """Return rows (R, 2, 2) and values (R, 2) of the prior on (A, B), in standard deviations.

    Upright: the plane's normal ~ w is perpendicular to the ground's.
    """
    down = LEVEL if ground is None else ground / np.linalg.norm(ground)
    upright = 1 / UPRIGHT_SIGMA[ground is not None]
    rows = np.zeros((len(centre), 2, 2))
    rows[:, 0, 0] = 1 / YAW_SIGMA
    rows[:, 1] = upright * (down[:2] - down[2] * centre)
    return rows, np.tile([0.0, -upright * down[2]], (len(centre), 1))


def settled(fit: Surfaces, x_cur: np.ndarray, block: np.ndarray, K: np.ndarray,
            t_cur_from_prev: np.ndarray, ground: np.ndarray | None) -> MovingPlane | None:
    """Return the MovingPlane of a fit of one region, or None where too few vectors agree.

    Arguments as of fit_moving_plane.
    """
    inlier, theta, centre = fit.inlier, fit.theta[0], fit.centre[0]
    if inlier.sum() < max(MIN_BLOCKS, 0.5 * len(x_cur)) or not np.all(np.isfinite(theta)):
        return None
    covariance = np.zeros((6, 6))
    covariance[:5, :5] = fit.covariance[0]
    log_depth, gauge, prior = _gauge(theta, centre, K, x_cur[inlier], block[inlier],
                                     t_cur_from_prev, ground)
    by_theta = np.vstack([np.eye(5, 6), gauge[:6]])
    covariance = by_theta @ covariance @ by_theta.T
    covariance[LOG_DEPTH, LOG_DEPTH] += gauge[6]
    full = np.r_[theta, log_depth]
    state, jacobian = moving_plane.to_plane(full, centre, t_cur_from_prev)
    return MovingPlane(state[:3], state[3:], moving_plane.product(full, centre),
                       jacobian @ covariance @ jacobian.T, prior, -theta[2], covariance[2, 2],
                       centre, inlier, float(np.sqrt(fit.variance[0])))


def _gauge(theta, centre, K, x_cur, block, t_cur_from_prev, ground):
    """Return ln Z, its (derivative by theta (6,), variance) as (7,), and the prior used."""
    gauge = np.zeros(7)
    if ground is not None:
        found = moving_plane.contact_depth(ground, moving_plane.contact(x_cur, block), K,
                                           theta[SLOPE], centre)
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
