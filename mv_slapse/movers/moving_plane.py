"""Moving planes of a key frame pair: robust estimate of (12) in [MVO] with its gauge settled.

A region of a few macroblocks fixes its mean motion well, its growth less, the tilt of its plane
hardly. The tilt therefore has a prior (surfaces of vehicles and people are upright), whose
variance shows in the covariance where the vectors add nothing.
"""

from dataclasses import dataclass
from typing import NamedTuple

from mv_slapse.geometry import moving_plane
from mv_slapse.geometry.camera import UP
from mv_slapse.geometry.moving_plane import LOG_DEPTH, RATE, SLOPE
from mv_slapse.geometry.vector import norm
from mv_slapse.kernels.binding import compiled
from mv_slapse.records import ScalePrior
import numpy as np

MIN_BLOCKS = 4
UPRIGHT_SIGMA = {True: 0.3, False: 0.5}  # tangent against the vertical; ground known or not
FREE_SIGMA = 1.0  # of ln Z where only the smallest motion settles it
FREE_DEPTH = (3.0, 60.0)  # [baseline] between which the smallest motion may lie


class Rules(NamedTuple):
    """Constants of the fit."""

    iterations: int = 10
    converged: float = 1e-2  # [sigma^2] by which the next iteration would lower the cost
    inlier: float = 3.0  # [sigma], also the scale of the robust kernel
    yaw_sigma: float = 1.0  # tangent of the angle between a surface and the picture plane
    upright_sigma: float = 0.3  # one of UPRIGHT_SIGMA


@dataclass(frozen=True)
class MovingPlane:
    """A moving plane of one key frame pair; lengths in the unit of ``t_cur_from_prev``."""

    plane: np.ndarray  # (3,): n / d in camera k
    t_d: np.ndarray  # (3,): displacement from k to k-1, (11) of [MVO]
    product: np.ndarray  # (3, 3): (t - t_d) plane^T, what two views observe
    covariance: np.ndarray  # (6, 6): of (plane, t_d), long along the gauge
    scale_prior: ScalePrior  # what settled the gauge
    # share of its depth that the surface lost during the pair; of the same scale at any depth
    closing: float
    closing_variance: float  # of that share
    centre: np.ndarray  # (2,): ray (x, y, 1) of the region's centre in camera k
    inlier: np.ndarray  # (N,) bool: correspondences that agree
    rms: float  # of the inliers' errors, in their own standard deviations


class View(NamedTuple):
    """A camera and its motion: K (3, 3) [px], X_cur = R X_prev + t, (3, 3) and (3,)."""

    K: np.ndarray
    R: np.ndarray
    t: np.ndarray


class Regions(NamedTuple):
    """Blocks of several regions, one region after the other."""

    x: np.ndarray  # (N, 2): centres in key frame k, undistorted [px]
    x_prev: np.ndarray  # (N, 2): their matches in the previous one [px]
    sigma: np.ndarray  # (N,): standard deviation of a coordinate of ``x_prev`` [px]
    first: np.ndarray  # (R,) int64: where each region begins


class Surfaces(NamedTuple):
    """Moving planes of several regions, their gauge still open."""

    theta: np.ndarray  # (R, 5): rate and slope as in geometry.moving_plane
    # (R, 5, 5): of their estimate, wider where vectors scatter more than their sigma says
    covariance: np.ndarray
    centre: np.ndarray  # (R, 2): first two coordinates of the ray they are about
    inlier: np.ndarray  # (N,) bool: vectors that agree
    # (R,): of the inliers' errors: 1 where they scatter as sigma says; infinite where less than
    # half of a region's vectors agree
    variance: np.ndarray

    def only(self, i: int, rows: slice) -> 'Surfaces':
        """Return the surface of region i alone, whose blocks are in some rows."""
        one = slice(i, i + 1)
        return Surfaces(self.theta[one], self.covariance[one], self.centre[one],
                        self.inlier[rows], self.variance[one])


def fit_surfaces(regions: Regions, view: View, ground: np.ndarray | None) -> Surfaces:
    """Estimate rate and slope of each region, one at least: robust Gauss-Newton, (12) of [MVO].

    A prior holds each plane upright: its normal ~ w is perpendicular to the ground's, ``ground``
    (3,), n / d in camera k in any unit.
    """
    down = -UP if ground is None else ground / norm(ground)
    rules = Rules(upright_sigma=UPRIGHT_SIGMA[ground is not None])
    return Surfaces(*compiled.fit_moving_surfaces(*regions, view, down, rules))


def settled(fit: Surfaces, x_cur: np.ndarray, block: np.ndarray, view: View,
            ground: np.ndarray | None) -> MovingPlane | None:
    """Return the MovingPlane of a fit of one region, or None where too few vectors agree.

    ``x_cur`` and ``block`` (N, 2) are its blocks' centres and sizes [px]; ``ground`` (3,) is n / d
    in camera k in the unit of the view's translation.
    """
    inlier, theta, centre = fit.inlier, fit.theta[0], fit.centre[0]
    if inlier.sum() < max(MIN_BLOCKS, 0.5 * len(x_cur)) or not np.all(np.isfinite(theta)):
        return None
    covariance = np.zeros((6, 6))
    covariance[:5, :5] = fit.covariance[0]
    log_depth, gauge, prior = _gauge(theta, centre, view, x_cur[inlier], block[inlier], ground)
    by_theta = np.vstack([np.eye(5, 6), gauge[:6]])
    covariance = by_theta @ covariance @ by_theta.T
    covariance[LOG_DEPTH, LOG_DEPTH] += gauge[6]
    full = np.r_[theta, log_depth]
    state, jacobian = moving_plane.to_plane(full, centre, view.t)
    return MovingPlane(state[:3], state[3:], moving_plane.product(full, centre),
                       jacobian @ covariance @ jacobian.T, prior, -theta[2], covariance[2, 2],
                       centre, inlier, float(np.sqrt(fit.variance[0])))


def _gauge(theta, centre, view, x_cur, block, ground):
    """Return ln Z, its (derivative by theta (6,), variance) as (7,), and the prior used."""
    gauge = np.zeros(7)
    if ground is not None:
        found = moving_plane.contact_depth(ground, moving_plane.contact(x_cur, block), view.K,
                                           theta[SLOPE], centre)
        if found is not None:
            gauge[SLOPE], gauge[6] = found.by_slope, found.variance
            return found.value, gauge, ScalePrior.GROUND_CONTACT
    gauge[6] = FREE_SIGMA**2
    return _smallest_motion(theta[RATE], view.t), gauge, ScalePrior.SMALLEST_MOTION


def _smallest_motion(rate, t_cur_from_prev):
    """Return the ln Z at which t_d = t - Z g is smallest, within sensible depths."""
    if not np.any(t_cur_from_prev):
        return float(np.mean(np.log(FREE_DEPTH)))
    nearest = rate @ t_cur_from_prev / max(rate @ rate, 1e-12)
    return float(np.log(np.clip(nearest, *FREE_DEPTH)))
