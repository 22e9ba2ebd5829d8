"""Where regions of blocks that move alike lie, and what their blocks have in common."""

from typing import NamedTuple

from mv_slapse.geometry import lattice
from mv_slapse.geometry.camera import to_rays
from mv_slapse.geometry.moving_plane import COVERED
from mv_slapse.movers.terrain import land_rather
import numpy as np

FOOT_HEIGHT = 40.0  # px above the lower edge that show how near it is
LOWEST, TALLEST, WIDEST = 0.825, 3.3, 8.25  # [m] of what may be a vehicle or a person
REPEATED = 0.5  # px within which a vector repeats another


class Blocks(NamedTuple):
    """Blocks of one region after the other.

    Attributes
    ----------
    x, block : (N, 2), (N, 2) float64
        Centres and sizes [px].
    vector : (N, 2) float64
        Where they were in the previous key frame, from where they are [px].
    turned : (N, 2) float64
        The part of that which the camera's rotation makes [px].
    rho, sigma : (N,), (N,) float64
        Apparent inverse depths and what noise makes of them [1/baseline].
    first : (R,) int
        Where each region begins.
    """

    x: np.ndarray
    block: np.ndarray
    vector: np.ndarray
    turned: np.ndarray
    rho: np.ndarray
    sigma: np.ndarray
    first: np.ndarray


class Outlines(NamedTuple):
    """Where regions lie in the picture; R of them.

    Attributes
    ----------
    low, high : (R, 2), (R, 2) float64
        Corners of the boxes around the centres of their blocks [px].
    foot : (R, 2) float64
        Middle of the lowest row's lower edge [px].
    drop : (R,) float64
        Rows of the foot below the horizon [px]; infinite where that is unknown.
    under : (R,) float64
        Inverse depth of the ground there [1/baseline]; 0 where that is unknown.
    filled : (R,) float64
        Share of the box that blocks cover.
    rho : (R,) float64
        Mean apparent inverse depth of the blocks near the foot [1/baseline].
    land : (R,) float64
        How much rather they show land at another height than a body, as of land_rather.
    kinds : (R,) int
        Vectors that differ.
    turned : (R, 2) float64
        Mean shift by the camera's rotation [px].
    limit : (3,) float64
        Greatest width, greatest and least height of vehicles, as shares of the camera's height.
    """

    low: np.ndarray
    high: np.ndarray
    foot: np.ndarray
    drop: np.ndarray
    under: np.ndarray
    filled: np.ndarray
    rho: np.ndarray
    land: np.ndarray
    kinds: np.ndarray
    turned: np.ndarray
    limit: np.ndarray

    @property
    def size(self) -> np.ndarray:
        """Return widths and heights (R, 2) [px]."""
        return self.high - self.low + lattice.MACROBLOCK


def _below_horizon(x: np.ndarray, K: np.ndarray, level: np.ndarray | None) -> np.ndarray:
    """Return how many rows (N,) pixels (N, 2) lie below the horizon; infinite: unknown.

    ``level`` (3,) is normal to the ground at any length, up.
    """
    if level is None or level[1] >= 0:
        return np.full(len(x), np.inf)
    return to_rays(K, x) @ level / (level[1] / K[1, 1])


def outlines(blocks: Blocks, K: np.ndarray, ground: np.ndarray | None,
             level: np.ndarray | None, camera_height: float) -> Outlines:
    """Return the Outlines of regions.

    Parameters
    ----------
    blocks : Blocks
    K : (3, 3) array
    ground : (3,) array or None
        Ground plane n / d in camera k [1/baseline].
    level : (3,) array or None
        The same at any length, where only the horizon is known.
    camera_height : float
        Above the ground [m].
    """
    x, block, first = blocks.x, blocks.block, blocks.first
    size = np.diff(first, append=len(x))
    bottom = x[:, 1] + 0.5 * block[:, 1]
    # A single block below all others is taken for a stray, as geometry.moving_plane.contact does.
    order = np.lexsort((bottom, np.repeat(np.arange(len(first)), size)))
    edge = bottom[order[first + np.maximum(size - 2, 0)]]
    lowest = (bottom >= np.repeat(edge, size) - 0.5).astype(float)
    across = np.add.reduceat(x[:, 0] * lowest, first) / np.add.reduceat(lowest, first)
    foot = np.stack([across, edge - (0.5 - COVERED) * lattice.MACROBLOCK], axis=1)
    area, drop = np.add.reduceat(block.prod(axis=1), first), _below_horizon(foot, K, level)
    under, each = (np.zeros(len(at)) if ground is None else -to_rays(K, at) @ ground
                   for at in (foot, x))
    land = land_rather(blocks.rho, blocks.sigma, each, first)
    low, high = np.minimum.reduceat(x, first), np.maximum.reduceat(x, first)
    filled = area / np.prod(high - low + lattice.MACROBLOCK, axis=1)
    lower = (bottom > np.repeat(edge, size) - FOOT_HEIGHT).astype(float)
    rho = np.add.reduceat(blocks.rho * lower, first) / np.add.reduceat(lower, first)
    across, down = np.round(blocks.vector / REPEATED).astype(np.int64).T % 65536
    kinds = np.unique((np.repeat(np.arange(len(first)), size) << 32) + (across << 16) + down)
    turned = np.add.reduceat(blocks.turned, first) / size[:, None]
    return Outlines(low, high, foot, drop, under, filled, rho, land, np.bincount(kinds >> 32),
                    turned, np.array([WIDEST, TALLEST, LOWEST]) / camera_height)
