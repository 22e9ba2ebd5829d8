"""Moving planes of a key frame pair: robust estimate of (12) in [MVO] with its gauge settled.

The homography (11) of [MVO] holds only the product ``(t - t_d) plane^T``, which is ``-g w^T``
about the ray ``(c, 1)`` of a region's centre. Rate ``g`` (3,) is ``t - t_d`` over the depth Z
there, slope (A, B) makes ``w(x) = 1 + (A, B) @ (x - c)``, the inverse depth relative to the
centre's. The gauge ``ln Z`` is what two views say nothing of.

A region of a few macroblocks fixes its mean motion well, its growth less, the tilt of its plane
hardly. The tilt therefore has a prior (surfaces of vehicles and people are upright), whose
variance shows in the covariance where the vectors add nothing.
"""

from typing import NamedTuple

import cv2
from mv_slapse.geometry.blocks import COVERED
from mv_slapse.geometry.camera import UP
from mv_slapse.geometry.rotation import norm
from mv_slapse.kernels.binding import compiled
from mv_slapse.records import ScalePrior
import numpy as np

MIN_BLOCKS = 4
UPRIGHT_SIGMA = {True: 0.3, False: 0.5}  # tangent against the vertical; ground known or not


class Rules(NamedTuple):
    """Constants of the fit."""

    iterations: int = 10
    converged: float = 1e-2  # [sigma^2] by which the next iteration would lower the cost
    inlier: float = 3.0  # [sigma], also the scale of the robust kernel
    yaw_sigma: float = 1.0  # tangent of the angle between a surface and the picture plane
    upright_sigma: float = 0.3  # one of UPRIGHT_SIGMA
    least: float = MIN_BLOCKS
    covered: float = COVERED
    free_sigma: float = 1.0  # of ln Z where only the smallest motion settles it
    nearest: float = 3.0  # [baseline] between which the smallest motion may lie,
    farthest: float = 60.0  # and the other end


class MovingPlane(NamedTuple):
    """A moving plane of one key frame pair; lengths in the unit of ``t_cur_from_prev``."""

    plane: np.ndarray  # (3,): n / d in camera k
    covariance: np.ndarray  # (6, 6): of (plane, t_d), long along the gauge
    t_d: np.ndarray  # (3,): displacement from k to k-1, (11) of [MVO]
    product: np.ndarray  # (3, 3): (t - t_d) plane^T, what two views observe
    scale_prior: ScalePrior  # what settled the gauge


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

    theta: np.ndarray  # (R, 5): rate and slope
    # (R, 5, 5): of their estimate, wider where vectors scatter more than their sigma says
    covariance: np.ndarray
    centre: np.ndarray  # (R, 2): first two coordinates of the ray they are about
    inlier: np.ndarray  # (N,) bool: vectors that agree
    # (R,): of the inliers' errors: 1 where they scatter as sigma says; infinite where less than
    # half of a region's vectors agree
    variance: np.ndarray


def homography(product: np.ndarray, K: np.ndarray, R_cur_from_prev: np.ndarray) -> np.ndarray:
    """Return H (..., 3, 3), x_prev ~ H x_cur, of moving planes by products, (11) of [MVO]."""
    return K @ R_cur_from_prev.T @ (np.eye(3) + product) @ cv2.invert(K)[1]


def fit_surfaces(regions: Regions, view: View, ground: np.ndarray | None) -> Surfaces:
    """Estimate rate and slope of each region, one at least: robust Gauss-Newton, (12) of [MVO].

    A prior holds each plane upright: its normal ~ w is perpendicular to the ground's, ``ground``
    (3,), n / d in camera k in any unit.
    """
    down = -UP if ground is None else ground / norm(ground)
    rules = Rules(upright_sigma=UPRIGHT_SIGMA[ground is not None])
    return Surfaces(*compiled.fit_moving_surfaces(*regions, view, down, rules))


def settled(fit: Surfaces, blocks, i: int, view: View,
            ground: np.ndarray | None) -> MovingPlane | None:
    """Return the MovingPlane of region i of a fit, or None where too few vectors agree.

    ``blocks`` has centres ``x`` and sizes ``block`` (N, 2) [px], the ``members`` (M,) int64 of one
    region after the other, and where each begins, ``first`` (R,). ``ground`` (3,) is n / d in
    camera k in the unit of the view's translation. Where a region stands on it that settles the
    gauge, else the smallest motion.
    """
    found = compiled.settle_surface(fit, (blocks.x, blocks.block, blocks.members, blocks.first),
                                    i, view, ground, Rules())
    if found is None:
        return None
    *plane, on_ground = found
    return MovingPlane(
        *plane, ScalePrior.GROUND_CONTACT if on_ground else ScalePrior.SMALLEST_MOTION)
