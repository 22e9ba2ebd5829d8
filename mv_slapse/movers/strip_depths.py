"""Depths of strips by where they were a while ago, as further blocks of a pair.

In one pair of a tenth of a second a car ahead and the road under it differ by less than a vector
errs; over half a second by several times that. The camera's way in between is put together from
the pairs, in heights of the camera above the ground, which each pair shows by the ground's depth.
"""

from typing import NamedTuple

from mv_slapse.geometry.rotation import norm
from mv_slapse.kernels.binding import compiled
from mv_slapse.movers.moving_plane import View
from mv_slapse.strip_matches import SIZE, SPAN, StripMatches
import numpy as np


class Rules(NamedTuple):
    """Constants of strips."""

    height: float = SIZE[1]  # px, of a strip
    # px by which a strip may miss its epipolar line: beyond, neither what stands nor what drives
    # ahead explains it
    passes: float = 3.0
    agrees: float = 4.0  # standard deviations of a block's own depth within which it is the same


RULES = Rules()
DEPTH, FURTHER = ('rho', 'noise'), ('x', 'x_prev', 'parallax', 'under')


class Way(NamedTuple):
    """The camera's motions from earlier key frames to the last one."""

    stamp: tuple[int, ...] = ()  # of the earlier key frames [ns], the oldest first
    R: tuple[np.ndarray, ...] = ()  # (3, 3), R_cur_from_then,
    t: tuple[np.ndarray, ...] = ()  # (3,), t_cur_from_then [heights of the camera]

    def gone_on(self, stamps: tuple[int, int], view: View, baseline: float) -> 'Way':
        """Return it in the later camera of a pair with these stamps [ns].

        ``baseline`` is the pair's in heights of the camera.
        """
        previous, stamp = stamps
        t = baseline * view.t
        kept = [i for i, then in enumerate(self.stamp) if stamp - then <= SPAN]
        return Way((*(self.stamp[i] for i in kept), previous),
                   (*(view.R @ self.R[i] for i in kept), view.R),
                   (*(view.R @ self.t[i] + t for i in kept), t))

    def since(self, stamp: int, baseline: float) -> tuple[np.ndarray, np.ndarray] | None:
        """Return R (3, 3) and t (3,) [baseline] from a key frame on; None: not known."""
        if stamp not in self.stamp:
            return None
        i = self.stamp.index(stamp)
        return self.R[i], self.t[i] / baseline


def with_strips(blocks, strips: StripMatches, way: Way, view: View, ground: np.ndarray):
    """Return the blocks of a pair, as of movers.regions, with what strips tell of them.

    A strip that is a block already tells its depth better, others follow as further blocks that
    have moved as such a depth does in this pair. ``strips`` are without distortion, ``way`` leads
    to the pair's later camera, ``ground`` (3,) is n / d there [1/baseline].
    """
    since = way.since(strips.stamp, norm(ground))
    if since is None or not since[1][2] < 0:  # of what comes nearer alone
        return blocks
    columns = tuple(np.ascontiguousarray(column, float)
                    for column in (strips.x_cur, strips.x_earlier, strips.sigma))
    row, *told = compiled.strip_depths(blocks, columns, since, view, ground, RULES)
    n = len(blocks.x)
    more = max(row.max(initial=-1) + 1 - n, 0)
    whole = {name: np.concatenate((column, np.zeros((more, *column.shape[1:]), column.dtype)))
             for name, column in blocks.columns().items()}
    further = row >= n
    for name, values in zip((*DEPTH, *FURTHER), told, strict=True):
        which = slice(None) if name in DEPTH else further
        whole[name][row[which]] = values[which]
    whole['plane_id'][n:], whole['block'][n:], whole['fits'][n:] = -1, SIZE, True
    return blocks._replace(**whole)
