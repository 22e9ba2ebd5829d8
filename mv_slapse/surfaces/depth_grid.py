"""Inverse depths that earlier pairs have measured, by macroblock, carried on to the next pair.

As in semi-dense visual odometry (Engel, Sturm, Cremers, ICCV 2013). One pair knows a block's depth
to some 4 %, within which the end wall behind a facade passes for a part of it; several pairs know
it to half of that.
"""

from dataclasses import dataclass

from mv_slapse.changed import replace
from mv_slapse.geometry import two_view
from mv_slapse.geometry.blocks import grid_shape
from mv_slapse.kernels.binding import compiled
from mv_slapse.motion.observations import Depths
import numpy as np

GATE = 9.0  # squared, 3 sigma: what differs by more is another surface, or was measured wrongly

# What the kernel goes by.
POLICY = {
    # Share of what is known that lasts a pair: vectors of pairs in a row err alike.
    'forgetting': 0.7,
    'drift': 0.01,  # share of the depth by which a pair's motion and the interpolation err
    # Ratio of inverse depths next door: beyond, an edge; set-backs differ by 0.2.
    'same_surface': 1.15,
    'least_weight': 0.75,  # of the bilinear weights that must have a depth
}


@dataclass(frozen=True)
class DepthGrid:
    """Inverse depths of a key frame by macroblock, each (rows, columns) [1/baseline].

    ``information`` is one over the variance, 0 where nothing is known.
    """

    rho: np.ndarray
    information: np.ndarray

    def predicted(self, pair: two_view.Pair, R, t, ratio: float):
        """Return what is known of a pair's blocks beforehand: rho, information (N,).

        It is interpolated between macroblocks, and nothing is known across edges.

        Parameters
        ----------
        pair : Pair
        R, t : (3, 3), (3,) arrays
            X_cur = R X_prev + t, |t| = 1.
        ratio : float
            This baseline over the last.
        """
        return compiled.carry_depths(
            self.rho, self.information, np.ascontiguousarray(pair.x_prev, float), pair.rays_prev,
            np.ascontiguousarray(R), np.ascontiguousarray(t), ratio, POLICY)


def joined(depths: Depths, rho: np.ndarray, information: np.ndarray) -> Depths:
    """Return depths (N,) that count what was known of each beforehand, unless it contradicts."""
    mean, sigma = compiled.join_depths(depths.rho, depths.sigma, rho, information, GATE)
    return replace(depths, rho=mean, sigma=sigma)


def noted(width: int, height: int, depths: Depths, chosen: np.ndarray | None = None) -> DepthGrid:
    """Note the depths of a picture [px] for the next pair; those of a macroblock are averaged.

    ``chosen`` (N,) bool are the blocks to note, all without it.
    """
    columns, rows = grid_shape(width, height)
    _, rho, sigma, x = depths.columns
    chosen = np.ones(len(rho), bool) if chosen is None else chosen
    return DepthGrid(*compiled.note_depths(rho, sigma, x, chosen, rows, columns))
