"""Bodies that look farther than the ground they hide, found among blocks that singly tell nothing.

A car ahead moves as something still and farther off does, which the ground before it would have
to hide. Where the parallax is small its blocks err by as much as that: each by itself may be
ground. Together they are not, since all of them show one depth, and the ground's changes from row
to row. What goes on below the row where the ground is as far tells so, column by column, by the
vectors of this pair and by what those before foresee (the column model of the Stixel world,
Pfeiffer & Franke, of two surfaces).
"""

from typing import NamedTuple

from mv_slapse.kernels.binding import compiled
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
    most: float = 3.0  # log-likelihood that one block tells at most: its vector may be wrong
    agrees: float = 3.0  # standard deviations of a body's depth within which a block is of it
    least: float = 4.0  # log-likelihood that makes a body worth a closer look,
    beside: float = 1.0  # more of each of its columns: noise tells some
    many: float = 6.0  # bodies of one pair that are looked at
    above: float = 0.7  # share of its inverse depth that the ground has in its highest row
    widest: float = 3.3  # [m] of a vehicle, by the rows from the horizon down to its foot
    blocks: float = 4.0  # of a body at least
    reach: float = 24.0  # px between centres of neighbours


RULES = Rules()


def with_bodies(regions, width: int, camera_height: float) -> tuple[np.ndarray, np.ndarray]:
    """Return regions with the bodies that only together look farther than the ground.

    A body takes the blocks of regions that look as far. Of ``regions`` x, rho, noise, foreseen,
    under, below, fits, members and first are read, as of movers.regions; ``width`` is the
    picture's [px], ``camera_height`` above the ground [m]. Returns members and first.
    """
    rules = RULES._replace(widest=RULES.widest / camera_height)
    return compiled.with_bodies(regions, width, rules)
