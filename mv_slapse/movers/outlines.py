"""Where regions of blocks that move alike lie, and what their blocks have in common."""

from typing import NamedTuple

from mv_slapse.geometry.blocks import COVERED, MACROBLOCK
from mv_slapse.kernels.binding import compiled
import numpy as np

NOT_KNOWN = np.zeros(3)


class Rules(NamedTuple):
    """Constants of outlines."""

    covered: float = COVERED
    macroblock: float = MACROBLOCK
    foot_height: float = 40.0  # px above the lower edge that show how near it is
    repeated: float = 0.5  # px within which a vector repeats another
    relief: float = 0.05  # share of their inverse depth by which bodies are no planes, nor is land
    farthest: float = 9.0  # squared error, in variances, that a block tells at most of land
    dependence: float = 2.0  # blocks that tell as much of it as one
    lowest: float = 1.0  # [m] of what may be a vehicle or a person: cars are above 1.05,
    tallest: float = 3.3
    widest: float = 8.25
    iterations: float = 3.0  # of its reweighting: more change the share by less than a per cent


RULES = Rules()


class Outlines(NamedTuple):
    """Where regions lie in the picture; R of them."""

    low: np.ndarray  # (R, 2): corner of the box around the centres of its blocks [px],
    high: np.ndarray  # (R, 2): and the corner opposite [px]
    foot: np.ndarray  # (R, 2): middle of the lowest row's lower edge [px]
    drop: np.ndarray  # (R,): rows of the foot below the horizon [px]; infinite if unknown
    under: np.ndarray  # (R,): inverse depth of the ground there [1/baseline]; 0 if unknown
    filled: np.ndarray  # (R,): share of the box that blocks cover
    rho: np.ndarray  # (R,): mean apparent inverse depth of the blocks near the foot [1/baseline]
    # (R,): how much rather they show still land at another height than the road's than one depth,
    # as chi-square: land looks farther than the road, as a car ahead does, and hides it, but its
    # inverse depth grows from row to row as the road's does, in one proportion
    land: np.ndarray
    kinds: np.ndarray  # (R,) int64: vectors that differ
    turned: np.ndarray  # (R, 2): mean shift by the camera's rotation [px]
    # (3,): greatest width, greatest and least height of vehicles, as shares of the camera's height
    limit: np.ndarray


def outlines(regions, K: np.ndarray, ground: np.ndarray | None, level: np.ndarray | None,
             camera_height: float) -> Outlines:
    """Return the Outlines of regions, as of movers.regions.

    ``ground`` (3,) is n / d in camera k [1/baseline], ``level`` the same at any length, where only
    the horizon is known; the camera's height above the ground is in metres.
    """
    ground, level = (NOT_KNOWN if up is None else up for up in (ground, level))
    return Outlines(*compiled.region_outlines(regions, K, ground, level, RULES),
                    np.array([RULES.widest, RULES.tallest, RULES.lowest]) / camera_height)
