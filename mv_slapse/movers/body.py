"""Bodies that look farther than the ground they hide, found among blocks that singly tell nothing.

A car ahead moves as something still and farther off does, which the ground before it would have
to hide. Where the parallax is small its blocks err by as much as that: each by itself may be
ground. Together they are not, since all of them show one depth, and the ground's changes from row
to row.
"""

import itertools
from typing import Any, NamedTuple

from mv_slapse.geometry import lattice
from mv_slapse.geometry.blocks import CELL
import numpy as np
from scipy import ndimage
from scipy.spatial import cKDTree

DEPTHS = 20  # of each pair that a body is looked for at, 19 % from one to the next,
RANGE = (0.03, 0.8)  # as shares of the greatest inverse depth of the ground that is seen
BODY = 0.08  # share of its inverse depth by which a body is no plane, and half of that step
ROAD = 0.07  # the same of the ground, at least: slope, kerbs
SHARP = 0.15  # of a block's depth, as a share: standard deviation at which it tells how flat it is
USUAL = 20  # such blocks below it that tell as much as what grounds usually are
MOST = 3.0  # log-likelihood that one block tells at most: its vector may be wrong
AGREES = 3.0  # standard deviations of a body's depth within which a block is of it
WINDOW = 5  # cells, 40 px, over which blocks must tell together
LEAST = 4.0  # log-likelihood in there that makes a body worth a closer look,
FADED = 2.0  # at which it ends,
CLEAR = 1.5  # and of each of its blocks: what lies beside a body is pulled along with it
MANY = 6  # bodies of one pair that are looked at
FINE = 2.0**20  # steps of a log-likelihood of 1 in which those of a window are summed
HALF_NORMAL = 0.6745  # median of the absolute value of a standard normal


class Blocks(NamedTuple):
    """Blocks that move along their epipolar lines, below the horizon.

    Attributes
    ----------
    x, block : (N, 2), (N, 2) float64
        Centres and sizes [px].
    rho, sigma, under : (N,) float64
        Apparent inverse depths, what noise makes of them, and the ground's there [1/baseline].
    """

    x: np.ndarray
    block: np.ndarray
    rho: np.ndarray
    sigma: np.ndarray
    under: np.ndarray


def with_bodies(members: list[np.ndarray], field: Any, size: tuple[int, int], least: int,
                reach: float) -> list[np.ndarray]:
    """Return regions with the bodies that only together look farther than the ground.

    A body takes the blocks of regions that clearly look farther; those of others it leaves alone.

    Parameters
    ----------
    members : list of (M,) int arrays
        Blocks of each region.
    field : object
        Of all blocks: ``x``, ``block``, ``rho``, ``seen`` (as of region_scores), whether each
        looks farther than the ground by itself (``below``) and moves along its epipolar line
        (``fits``).
    size : (int, int)
        Width and height of the picture [px].
    least : int
        Blocks of a region, at least.
    reach : float
        Between centres of neighbours, at most [px].
    """
    sunk = [np.mean(field.below[member]) > 0.5 for member in members]
    others = list(itertools.compress(members, np.logical_not(sunk)))
    free = field.fits & (field.seen.under > 0)
    for member in others:
        free[member] = False
    at = np.flatnonzero(free)
    own = list(itertools.compress(members, sunk))
    for body in bodies(Blocks(field.x[at], field.block[at], field.rho[at], field.seen.sigma[at],
                              field.seen.under[at]), size):
        body = at[body]
        left = [np.setdiff1d(member, body) for member in own]
        beside = np.concatenate([np.zeros(0, int), *left])
        # What surrounds a larger one is no body: its vectors are pulled along.
        surrounds = len(beside) > len(body) and np.median(cKDTree(field.x[beside]).query(
            field.x[body])[0]) < reach
        if len(body) >= least and not surrounds:
            own = [member for member in left if len(member) >= least] + [body]
    return others + own


def bodies(blocks: Blocks, size: tuple[int, int]) -> list[np.ndarray]:
    """Return the blocks (M,) int of each body that together look farther than the ground.

    Parameters
    ----------
    blocks : Blocks
    size : (int, int)
        Width and height of the picture [px].
    """
    if not len(blocks.x):
        return []
    depths = np.geomspace(*RANGE, DEPTHS) * np.max(blocks.under)
    gain = _gain(blocks, depths[:, None])
    number = lattice.paint(*size, blocks.x, blocks.block, np.arange(len(blocks.x)))
    cells = np.maximum(blocks.block.prod(axis=1) / CELL**2, 1.0)
    shown = np.where(number >= 0, np.rint(FINE * gain / cells)[:, number], 0.0)
    clear = (gain > CLEAR)[:, number] & (number >= 0)
    # Sums of whole numbers are exact: windows around the same blocks are equal to the last bit,
    # and the first of them is taken on every processor.
    total = np.rint(WINDOW**2 * ndimage.uniform_filter(shown, (0, WINDOW, WINDOW),
                                                       mode='constant')) / FINE
    square = np.ones((WINDOW, WINDOW), bool)
    found = []
    while len(found) < MANY and total.max() >= LEAST:
        k, row, column = np.unravel_index(np.argmax(total), total.shape)
        part, _ = ndimage.label((total[k] >= FADED) & clear[k], np.ones((3, 3)))
        near = tuple(slice(max(at - WINDOW // 2, 0), at + WINDOW // 2 + 1) for at in (row, column))
        if np.any(part[near]):
            body = part == np.argmax(np.bincount(part[near][part[near] > 0]))
            found.append(np.unique(number[body]))
            total[:, ndimage.binary_dilation(body, square)] = 0.0
        total[k][near] = 0.0
    return found


def _gain(blocks, depths):
    """Return how much rather blocks (N,) show inverse depths (G, 1) than the ground, (G, N)."""
    rho, sigma, under = blocks.rho, blocks.sigma, blocks.under
    ground = np.maximum(under - rho, 0.0) / np.hypot(sigma, _unevenness(blocks) * under)
    body = np.abs(rho - depths) / np.hypot(sigma, BODY * depths)
    gain = np.clip(0.5 * (ground**2 - body**2), -MOST, MOST)
    gain = np.where(body < AGREES, gain, 0.0)
    # Above the row where body and ground are equally far something still may be there.
    return np.where(depths < under, gain, np.minimum(gain, 0.0))


def _unevenness(blocks):
    """Return the share by which the ground may be farther than the plane that is taken for it.

    It is known as well as what lies below it agrees: beside a ditch, or where the plane is wrong,
    that is by a third.
    """
    ratio = blocks.rho / blocks.under
    lower = 1 - ratio[(blocks.sigma < SHARP * blocks.under) & (ratio > 0) & (ratio < 1)]
    usual = np.full(USUAL, HALF_NORMAL * ROAD)
    return max(ROAD, float(np.median(np.r_[lower, usual])) / HALF_NORMAL)
