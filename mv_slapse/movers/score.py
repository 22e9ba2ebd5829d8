"""How badly a still surface explains each region of blocks that move alike.

Two questions are asked of a region as a whole:

* Does any depth at or above the ground explain it? Its rate g must then be rho t, with rho at
  least the ground's (direction, epipolar and below-ground constraints of [MVO] in one).
* Does it stand where it seems to be? An oncoming car looks like something still and nearer, which
  would hover over the ground that is seen right below it (the magnitude constraint).

The answers are squared distances less what noise gives.
"""

from typing import NamedTuple

from mv_slapse.geometry.blocks import MACROBLOCK
from mv_slapse.kernels.binding import compiled
from mv_slapse.movers.moving_plane import Surfaces, View
from mv_slapse.movers.outlines import Outlines
import numpy as np


class Rules(NamedTuple):
    """Constants of the scores."""

    bias: float = 0.35  # px that a region's vectors have in common
    least_drop: float = 8.0  # px below the horizon from which on a lower edge tells something
    foot_sigma: float = 6.0  # px of the lower edge, seen to a block, and of the horizon
    edge_sigma: float = MACROBLOCK / 12**0.5  # px of the lower edge, seen to a block, alone
    ground_sigma: float = 0.07  # share of the ground's inverse depth: slope, kerbs
    bank_sigma: float = 0.04  # rad by which land beside the road slopes against the road's plane
    lowest_part: float = 0.3  # height of what comes towards the camera, as a share of its height
    least_filled: float = 0.4  # share of its box that a vehicle's blocks cover
    relief: float = 0.04  # share of a region's rate by which it errs where it is no plane,
    wide: float = 250.0  # px, if it is as wide as this
    pull: float = 0.04  # share of a turn of the camera by which a region's vectors may all miss it
    least_ratio: float = 1.2  # of apparent over ground's inverse depth at which something hovers
    clearance: float = 0.06  # logarithm of that ratio: what is left when the next is taken off
    outlier: float = 0.05  # density of a wrong vector's depth, to the peak of a right one's
    underbody: float = 0.25  # share of its height that a body ends above the ground: a car .2
    least_reach: float = 28.0  # px below a region in which the ground is looked for
    half_covered: float = 8.0  # px over which blocks below a body cease to show it: 4 of 10 at 7.5
    shown: float = 0.15  # share of this place that shows ground that is surely there
    unseen: float = 8.0  # largest score of what looks below the ground, where that is not seen
    no_land: float = 13.0  # largest score of what looks so, less what tells of land
    dependence: float = 2.0  # blocks below or above a region that tell as much as one
    around: float = 48.0  # px about a region in which copied vectors count, or half its size
    few: float = 2.0  # blocks there that tell as much as the whole picture
    least_copied: float = 0.02  # share of them that there may always be
    credit: float = 0.16  # score of a vector by the odds that it is no copy: as of 1 Mbit/s
    border: float = 48.0  # px from the picture's sides: what they cut may be of any width
    together: float = 4.0  # departed blocks that tell as much as one: they err by one common depth
    bodies: float = 0.8  # share of the evidence of several pairs that counts: 16 for a mover,
    copied: float = 0.5  # share of what vectors deserve that it counts up to: copies last, too
    step: float = 10.0  # largest part of the score of one pair,
    back: float = -5.0  # and smallest
    macroblock: float = MACROBLOCK


RULES = Rules()


def scores(fit: Surfaces, outline: Outlines, view: View, seen, nearer: float,
           told: tuple[np.ndarray, np.ndarray]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return three scores (R,) of regions: they move, they have left, they are bodies that move.

    The first is the squared distance from all that is still, less what noise gives; ``seen`` are
    all blocks, in regions or not. The ground may be ``nearer`` by a factor; if so nothing is known
    to hover over it. ``told`` has log-likelihoods (R,) that regions have left where they stood, as
    of movers.reference_depth.departure, and the evidence (R,) of several pairs that they are
    bodies, as of movers.body, which counts where this pair says so, too. No score is more than the
    vectors deserve; where no plane fits all are 0.
    """
    return compiled.region_scores(fit, outline, view, seen, nearer == 1, told, RULES)
