"""Blocks that may belong to a mover: they tell nothing sure of the camera's motion.

Above the horizon what drives as fast as the camera moves as what is far off does, and the label
of such a block is a guess. Where a mover is, that guess is not made: the first estimate of a pair
does without the places that the last pair showed moving, and the last estimate without blocks
around a mover that move as it does.
"""

from mv_slapse.geometry import moving_plane
from mv_slapse.geometry.blocks import lookup, MACROBLOCK, paint
from mv_slapse.geometry.camera import to_pixels
from mv_slapse.motion.estimate import MIN_CORRESPONDENCES
from mv_slapse.movers.regions import RULES
from mv_slapse.records import Extraction, Label
import numpy as np

REACH = (0.3, 1.0)  # of a mover's height below and above it: a bus found by its lower half
SLACK = (1.0, 0.12)  # px, share of the parallax: by how much a mover's own vectors differ
LEAST_LEFT = 0.3  # share of the blocks that must be left to estimate the motion from


def like_movers(shown: Extraction, parallax: np.ndarray) -> np.ndarray:
    """Return the blocks (N,) bool on no plane, around a mover, that move as it does.

    ``shown`` has motion, labels and moving planes; ``parallax`` (N,) are the lengths of its
    vectors without the camera's rotation [px].
    """
    found = np.zeros(len(shown.x_cur), bool)
    movers = [plane for plane in shown.planes if plane.label is Label.MOVING]
    if not movers:
        return found
    x, R = shown.x_cur.astype(float), shown.motion.R_cur_from_prev
    slack = SLACK[0] + SLACK[1] * parallax
    for plane in movers:
        box = _around(x[shown.plane_id == plane.id])
        near = np.flatnonzero(np.all((x >= box[0]) & (x <= box[1]), axis=1)
                              & (shown.plane_id < 0))
        H = moving_plane.homography(plane.product, shown.K, R)
        before = to_pixels(H, np.c_[x[near], np.ones(len(near))])
        error = np.linalg.norm(before - shown.x_prev[near], axis=1)
        found[near[error < slack[near]]] = True
    return found


def _around(x):
    """Return the corners (2, 2) of the place in which a mover (N, 2) may have more blocks."""
    low, high = x.min(axis=0) - MACROBLOCK, x.max(axis=0) + MACROBLOCK
    height = high[1] - low[1]
    return low - (0.0, REACH[1] * height), high + (0.0, REACH[0] * height)


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
                 (shown.label == Label.MOVING).astype(int))


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
    enough = free.sum() >= max(LEAST_LEFT * len(free), MIN_CORRESPONDENCES)
    return free if enough else np.ones(len(free), bool)
