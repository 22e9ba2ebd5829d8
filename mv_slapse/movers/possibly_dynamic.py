"""Blocks that may belong to a mover: they tell nothing sure of the camera's motion.

Above the horizon what drives as fast as the camera moves as what is far off does, and the label
of such a block is a guess. Where a mover is, that guess is not made: the first estimate of a pair
does without the places that the last pair showed moving, and the last estimate without blocks
around a mover that move as it does.
"""

from mv_slapse.geometry.blocks import lookup, paint
from mv_slapse.kernels.binding import compiled
from mv_slapse.motion.estimate import MIN_CORRESPONDENCES
from mv_slapse.movers.moving_plane import homography
from mv_slapse.movers.regions import RULES
from mv_slapse.records import Extraction, Label
import numpy as np

REACH = (1.0, 0.3)  # of a mover's height above and below it: a bus found by its lower half
LEAST_LEFT = 0.3  # share of the blocks that must be left to estimate the motion from


def like_movers(shown: Extraction, parallax: np.ndarray) -> np.ndarray:
    """Return the blocks (N,) bool on no plane, around a mover, that move as it does.

    ``shown`` has motion, labels and moving planes; ``parallax`` (N,) are the lengths of its
    vectors without the camera's rotation [px].
    """
    movers = [plane for plane in shown.planes if plane.label is Label.MOVING]
    if not movers:
        return np.zeros(len(shown.x_cur), bool)
    H = homography(np.array([plane.product for plane in movers]), shown.K,
                                shown.motion.R_cur_from_prev)
    return compiled.blocks_like_movers(
        shown.x_cur, shown.x_prev, shown.plane_id, parallax, np.array([m.id for m in movers]),
        np.reshape(H, (-1, 9)), REACH, (RULES.alike, RULES.alike_share))


def below(rays: np.ndarray, rho: np.ndarray, blur: np.ndarray, floor: np.ndarray,
          spread: float = 0.0) -> np.ndarray:
    """Return the blocks (N,) bool that look farther than the ground (3,) that they hide.

    Nothing still can be there, whatever it is: what drives ahead shows itself so at once. By rays
    (N, 3), inverse depths (N,) and what noise makes of them; ``spread`` is the standard deviation
    of the logarithm of the ground's depth.
    """
    nearest = RULES.below_ground * np.exp(-2 * spread) * -(rays @ floor)
    return rho + 2 * blur < nearest


def painted(shown: Extraction) -> np.ndarray:
    """Return the grid of cells that holds 1 where there is a mover."""
    return paint(shown.width, shown.height, shown.x_cur, shown.block,
                 (shown.label == Label.MOVING.value).astype(int))


def taken(grid: np.ndarray | None, x_prev: np.ndarray) -> np.ndarray:
    """Return which blocks (N,) bool come from a place that held a mover in the last pair.

    ``grid`` as of ``painted``, ``x_prev`` (N, 2) in pixels.
    """
    if grid is None:
        return np.zeros(len(x_prev), bool)
    return lookup(grid, x_prev) > 0


def without(held: np.ndarray) -> np.ndarray:
    """Return the blocks (N,) bool that are left of those not held; all, where that is too few."""
    free = ~held
    enough = np.count_nonzero(free) >= max(LEAST_LEFT * len(free), MIN_CORRESPONDENCES)
    return free if enough else np.ones(len(free), bool)
