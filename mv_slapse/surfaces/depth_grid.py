"""Inverse depths that earlier pairs have measured, by macroblock, carried on to the next pair.

As in semi-dense visual odometry (Engel, Sturm, Cremers, ICCV 2013). One pair knows a block's depth
to some 4 %, within which the end wall behind a facade passes for a part of it; several pairs know
it to half of that.
"""

from dataclasses import dataclass, replace

from mv_slapse.geometry import two_view
from mv_slapse.geometry.blocks import grid_index, grid_shape, MACROBLOCK
from mv_slapse.surfaces.consensus import Depths
import numpy as np

FORGETTING = 0.7  # share of what is known that lasts a pair: vectors of pairs in a row err alike
DRIFT = 0.01  # share of the depth by which a pair's motion and the interpolation err
SAME_SURFACE = 1.15  # ratio of inverse depths next door: beyond, an edge; set-backs differ by 0.2
GATE = 9.0  # squared, 3 sigma: what differs by more is another surface, or was measured wrongly
LEAST_WEIGHT = 0.75  # of the bilinear weights that must have a depth


@dataclass(frozen=True)
class DepthGrid:
    """Inverse depths of a key frame by macroblock, each (rows, columns) [1/baseline].

    ``information`` is one over the variance, 0 where nothing is known.
    """

    rho: np.ndarray
    information: np.ndarray

    def predicted(self, pair: two_view.Pair, R, t, ratio: float):
        """Return what is known of a pair's blocks beforehand: rho, information (N,).

        Parameters
        ----------
        pair : Pair
        R, t : (3, 3), (3,) arrays
            X_cur = R X_prev + t, |t| = 1.
        ratio : float
            This baseline over the last.
        """
        rho, information = self._at(pair.x_prev)
        rho, information = ratio * rho, information / ratio**2
        ahead = pair.rays_prev @ R[2]
        nearer = ahead + rho * t[2]
        good = (nearer > 0) & (information > 0)
        nearer = np.where(good, nearer, 1.0)
        rho = rho / nearer
        slope = ahead / nearer**2
        variance = slope**2 / (FORGETTING * np.where(good, information, 1.0))
        return rho, np.where(good, 1 / (variance + np.square(DRIFT * rho) + 1e-18), 0.0)

    def _at(self, x: np.ndarray):
        """Interpolate at pixels (N, 2): rho, information (N,), which is 0 across edges.

        Inverse depth is linear on a plane.
        """
        place = (x + 0.5) / MACROBLOCK - 0.5
        corner = np.floor(place).astype(int)
        step = np.array([[0, 0], [1, 0], [0, 1], [1, 1]])
        near = corner[:, None] + step
        weight = np.prod(np.abs(1 - step - (place - corner)[:, None]), axis=2)
        inside = np.all((near >= 0) & (near < self.rho.shape[::-1]), axis=2)
        column, row = np.moveaxis(np.where(inside[..., None], near, 0), 2, 0)
        rho, known = self.rho[row, column], self.information[row, column]
        weight[~inside | (known == 0)] = 0
        total = weight.sum(axis=1)
        low = np.min(np.where(weight > 0, rho, np.inf), axis=1)
        good = (total > LEAST_WEIGHT) & (np.max(rho * (weight > 0), axis=1) < SAME_SURFACE * low)
        weight /= np.maximum(total, LEAST_WEIGHT)[:, None]
        variance = np.sum(np.square(weight) / np.maximum(known, 1e-18), axis=1)
        return np.sum(weight * rho, axis=1), np.where(good, 1 / np.maximum(variance, 1e-18), 0.0)


def joined(depths: Depths, rho: np.ndarray, information: np.ndarray) -> Depths:
    """Return depths (N,) that count what was known of each beforehand, unless it contradicts."""
    own = np.square(depths.sigma)
    near = np.square(rho - depths.rho) * information < GATE * (1 + own * information)
    information = np.where(near, information, 0.0)
    gain = own * information / (1 + own * information)
    return replace(depths, rho=depths.rho + gain * (rho - depths.rho),
                   sigma=depths.sigma * np.sqrt(1 - gain))


def noted(width: int, height: int, depths: Depths) -> DepthGrid:
    """Note the depths of a picture [px] for the next pair; those of a macroblock are averaged."""
    columns, rows = grid_shape(width, height)
    cell = grid_index(depths.x, width, height)
    cell, inside = cell[cell >= 0], cell >= 0
    each = 1 / np.square(depths.sigma[inside])
    count, total = (np.bincount(cell, weight, rows * columns) for weight in (None, each))
    rho = np.bincount(cell, each * depths.rho[inside], len(total)) / np.maximum(total, 1e-18)
    # What one macroblock's vectors tell is hardly more than what one of them does.
    information = total / np.maximum(count, 1)
    return DepthGrid(rho.reshape(rows, columns), information.reshape(rows, columns))
