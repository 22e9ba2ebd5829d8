"""How badly a still surface explains each region of blocks that move alike.

Two questions are asked of a region as a whole:

* Does any depth at or above the ground explain it? Its rate g must then be rho t, with rho at
  least the ground's (direction, epipolar and below-ground constraints of [MVO] in one).
* Does it stand where it seems to be? An oncoming car looks like something still and nearer, which
  would hover over the ground that is seen right below it (the magnitude constraint).

The answers are squared distances less what noise gives.
"""

from typing import NamedTuple

from mv_slapse.geometry.camera import to_rays
from mv_slapse.geometry.moving_plane import RATE
from mv_slapse.planes import lattice
from mv_slapse.planes.moving import Surfaces
import numpy as np

BIAS = 0.35  # px that a region's vectors have in common
BELOW_GROUND = 0.75  # share of the ground's inverse depth below which nothing still can be
LEAST_DROP = 12.0  # px below the horizon from which on a lower edge tells something
LOWEST, TALLEST = 0.35, 2.0  # heights of a camera, of what may be a vehicle or a person
RELIEF = 0.04  # share of a region's rate by which it errs where the region is no plane,
WIDE = 250.0  # px, if it is as wide as this
LEAST_RATIO = 1.2  # of apparent over ground's inverse depth at which something may hover
HOVER_SIGMA = 0.15  # of the log of that ratio: the edge's block
STEP = 60.0  # largest part of the score of one pair


class Outlines(NamedTuple):
    """Where regions lie in the picture; R of them.

    Attributes
    ----------
    low, high : (R, 2), (R, 2) float64
        Corners of the boxes around the centres of their blocks [px].
    foot : (R, 2) float64
        Middle of the lowest row's lower edge [px].
    drop : (R,) float64
        Rows of the foot below the horizon [px]; not positive: above it, or no ground is known.
    under : (R,) float64
        Inverse depth of the ground there [1/baseline].
    """

    low: np.ndarray
    high: np.ndarray
    foot: np.ndarray
    drop: np.ndarray
    under: np.ndarray

    @property
    def size(self) -> np.ndarray:
        """Return widths and heights (R, 2) [px]."""
        return self.high - self.low + lattice.MACROBLOCK


def outlines(x: np.ndarray, block: np.ndarray, first: np.ndarray, K: np.ndarray,
             ground: np.ndarray | None) -> Outlines:
    """Return the Outlines of regions.

    Parameters
    ----------
    x, block : (N, 2), (N, 2) arrays
        Centres and sizes of the blocks of one region after the other [px].
    first : (R,) array
        Where each region begins.
    K : (3, 3) array
    ground : (3,) array or None
        Ground plane n / d in camera k [1/baseline].
    """
    size = np.diff(first, append=len(x))
    bottom = x[:, 1] + 0.5 * block[:, 1]
    # A single block below all others is taken for a stray, as geometry.moving_plane.contact does.
    order = np.lexsort((bottom, np.repeat(np.arange(len(first)), size)))
    edge = bottom[order[first + np.maximum(size - 2, 0)]]
    lowest = (bottom >= np.repeat(edge, size) - 0.5).astype(float)
    across = np.add.reduceat(x[:, 0] * lowest, first) / np.add.reduceat(lowest, first)
    foot = np.stack([across, edge], axis=1)
    under = np.zeros(len(first))
    drop = np.zeros(len(first))
    if ground is not None and ground[1] < 0:
        under = -to_rays(K, foot) @ ground
        drop = under / (-ground[1] / K[1, 1])
    return Outlines(np.minimum.reduceat(x, first), np.maximum.reduceat(x, first), foot, drop,
                    under)


def scores(fit: Surfaces, outline: Outlines, K: np.ndarray, t: np.ndarray, x: np.ndarray,
           ground_like: np.ndarray) -> np.ndarray:
    """Return squared distances (R,) of regions from all that is still, less what noise gives.

    Parameters
    ----------
    fit, outline : Surfaces, Outlines
        Of R regions.
    K, t : (3, 3), (3,) arrays
        Intrinsics [px]; translation of the camera, the unit of length.
    x, ground_like : (M, 2), (M,) arrays
        Centres of all blocks of the picture, and which of them move as the ground does.
    """
    rate, size, drop = fit.theta[:, RATE], outline.size, outline.drop
    W = np.linalg.inv(_covariance(fit, rate, size, K))
    Wt = W @ t
    information = np.maximum(Wt @ t, 1e-12)
    apparent, sigma = np.sum(rate * Wt, axis=1) / information, 1 / np.sqrt(information)
    # The lower edge may lie a block higher than it seems, where the ground is farther.
    sure = np.maximum(drop - lattice.MACROBLOCK, 0) / np.maximum(drop, 1.0)
    error = rate - np.maximum(apparent, BELOW_GROUND * outline.under * sure)[:, None] * t
    distance = np.sum((W @ error[:, :, None])[:, :, 0] * error, axis=1) - 3
    near = drop > LEAST_DROP
    # Flat on the road: wrong vectors of the road, as no vehicle is that low.
    flat = near & (size[:, 1] < LOWEST * drop)
    distance[flat] = np.minimum(distance[flat], 0.0)
    stands = near & ~flat & (size[:, 1] <= TALLEST * drop)
    for i in np.flatnonzero(stands & (apparent >= LEAST_RATIO * outline.under)):
        ratio = apparent[i] / outline.under[i]
        if _ground_below(outline, i, x, ground_like):
            spread = np.hypot(HOVER_SIGMA, sigma[i] / apparent[i])
            distance[i] += (np.log(ratio) / spread)**2 - 1
    return np.clip(distance, -5, STEP)


def _covariance(fit, rate, size, K):
    """Return the covariance (R, 3, 3) of the rates with what their vectors err alike."""
    bias = np.empty((len(rate), 3))
    bias[:, :2] = BIAS / np.diag(K)[:2]
    bias[:, 2] = BIAS / (0.5 * np.min(size, axis=1))
    # A surface that is not one plane shifts its rate by a share of it.
    shape = (RELIEF * np.linalg.norm(rate, axis=1)
             * np.minimum(1.0, np.max(size, axis=1) / WIDE))**2
    covariance = fit.covariance[:, RATE, RATE]
    covariance[:, range(3), range(3)] += bias**2 + shape[:, None]
    return covariance


def _ground_below(outline, i, x, ground_like):
    """Return whether the ground is seen right below a region."""
    across = np.abs(x[:, 0] - outline.foot[i, 0]) < 0.5 * outline.size[i, 0]
    below = x[:, 1] - outline.foot[i, 1]
    seen = across & (below > 0) & (below < 1.75 * lattice.MACROBLOCK)
    return bool(seen.any()) and ground_like[seen].mean() > 0.5
