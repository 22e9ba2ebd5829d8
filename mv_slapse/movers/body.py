"""Bodies that look farther than the ground they hide, found among blocks that singly tell nothing.

A car ahead moves as something still and farther off does, which the ground before it would have
to hide. Where the parallax is small its blocks err by as much as that: each by itself may be
ground. Together they are not, since all of them show one depth, and the ground's changes from row
to row. What goes on below the row where the ground is as far tells so, column by column (the
column model of the Stixel world, Pfeiffer & Franke, of two surfaces).

One pair seldom tells enough. What drives ahead steadily comes nearer as something still and
farther off would, so what was told of a depth and column is carried on as if it stood still, and
summed as long as it is above zero (the cumulative sum of E. S. Page, "Continuous inspection
schemes", Biometrika 41, 1954). Only on the way ahead: the plane of the road is no model of the
land beside it.
"""

from typing import NamedTuple

from mv_slapse.kernels.binding import compiled
from mv_slapse.movers.moving_plane import View
import numpy as np


class Rules(NamedTuple):
    """Constants of bodies."""

    depths: float = 32.0  # of each pair that a body is looked for at, 11 % from one to the next,
    farthest: float = 0.03  # from this share of the greatest inverse depth of the ground seen
    nearest: float = 0.8  # to this one
    body: float = 0.06  # share of its inverse depth by which a body is no plane, and half a step
    road: float = 0.07  # the same of the ground, at least: slope, kerbs
    sharp: float = 0.15  # of a block's depth, as a share: sigma at which it tells how flat it is
    usual: float = 20.0  # such blocks below it that tell as much as what grounds usually are
    most: float = 3.0  # log-likelihood that one block tells at most: its vector may be wrong,
    once: float = 4.0  # one column in a pair, whose vectors are copied from one another,
    lasting: float = 2.0  # and of that what the next pair is told: no pair decides alone
    fading: float = 0.95  # of what was told, from pair to pair
    lane: float = 6.0  # [m] beside the way ahead, at the depth shown, where it is carried on:
    # half a car beyond 1.2 m, which looks 1.4 to 3 times as far off
    agrees: float = 3.0  # standard deviations of a body's depth within which a block is of it
    least: float = 8.0  # log-likelihood that makes a body worth a closer look,
    beside: float = 1.0  # more of each of its columns: noise tells some
    many: float = 6.0  # bodies of one pair that are looked at
    above: float = 0.7  # share of its inverse depth that the ground has in its highest row
    widest: float = 3.3  # [m] of a vehicle, by the rows from the horizon down to its foot
    blocks: float = 4.0  # of a body at least
    reach: float = 24.0  # px between centres of neighbours


RULES = Rules()


class Bodies(NamedTuple):
    """What pairs tell of upright bodies: log-likelihoods by apparent inverse depth and column."""

    depths: np.ndarray = np.zeros(0)  # (D,) [1/height of the camera]
    told: np.ndarray = np.zeros((0, 0))  # (D, C), C columns of macroblocks


def with_bodies(regions, view: View, ground: np.ndarray, camera_height: float,
                size: tuple[int, int], before: Bodies
                ) -> tuple[np.ndarray, np.ndarray, np.ndarray, Bodies]:
    """Return regions with the bodies that only together look farther than the ground.

    A body takes the blocks of regions that look as far. Of ``regions`` x, rho, noise, under,
    below, fits, own, members and first are read, as of movers.regions; ``ground`` (3,) is n / d,
    ``size`` the picture's [px], ``camera_height`` above the ground [m], ``before`` what the last
    pair returned. Each region has a block of the pair's own, not strips alone.
    Returns members, first, the evidence (R,) of several pairs for each region, 0 if it is no body,
    and what the next pair is told.
    """
    rules = RULES._replace(widest=RULES.widest / camera_height, lane=RULES.lane / camera_height)
    (members, first), evidence, *told = compiled.with_bodies(
        regions, view, ground, size, tuple(before), rules)
    return members, first, evidence, Bodies(*told)
