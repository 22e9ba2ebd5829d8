"""Where regions of blocks that move alike lie, and what their blocks have in common."""

from typing import NamedTuple

from mv_slapse.geometry.blocks import MACROBLOCK
from mv_slapse.geometry.moving_plane import COVERED
from mv_slapse.kernels.binding import compiled
import numpy as np

LOWEST, TALLEST, WIDEST = 0.825, 3.3, 8.25  # [m] of what may be a vehicle or a person
REPEATED = 0.5  # px within which a vector repeats another
NOT_KNOWN = np.zeros(3)


class Rules(NamedTuple):
    """Constants of outlines."""

    covered: float = COVERED
    macroblock: float = MACROBLOCK
    foot_height: float = 40.0  # px above the lower edge that show how near it is
    repeated: float = REPEATED
    relief: float = 0.05  # share of their inverse depth by which bodies are no planes, nor is land
    farthest: float = 9.0  # squared error, in variances, that a block tells at most of land
    dependence: float = 2.0  # blocks that tell as much of it as one
    iterations: float = 3.0  # of its reweighting: more change the share by less than a per cent


RULES = Rules()


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
    first : (R,) int64
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
        How much rather they show still land at another height than the road's than one depth, as
        chi-square: land looks farther than the road, as a car ahead does, and hides it, but its
        inverse depth grows from row to row as the road's does, in one proportion.
    kinds : (R,) int64
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
    ground, level = (NOT_KNOWN if up is None else up for up in (ground, level))
    return Outlines(*compiled.region_outlines(blocks, K, ground, level, RULES),
                    np.array([WIDEST, TALLEST, LOWEST]) / camera_height)
