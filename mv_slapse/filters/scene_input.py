"""Which correspondences of an extraction correct the scene."""

from mv_slapse.geometry import two_view
from mv_slapse.geometry.blocks import macroblock_of
from mv_slapse.geometry.camera import to_rays
from mv_slapse.records import Extraction, Label
import numpy as np
from scipy import ndimage


def stationary(extraction: Extraction):
    """Return the stationary correspondences and the plane id of each (N,)."""
    stationary = ((extraction.label == Label.STATIONARY) | (extraction.label == Label.INFINITY))
    stationary &= ~_beside_movers(extraction)
    x_cur, x_prev = (x[stationary].astype(float) for x in (extraction.x_cur, extraction.x_prev))
    pair = two_view.Pair(to_rays(extraction.K, x_cur), to_rays(extraction.K, x_prev), x_prev,
                         extraction.sigma[stationary].astype(float), extraction.K)
    return pair, extraction.plane_id[stationary]


def _beside_movers(extraction: Extraction) -> np.ndarray:
    """Return the blocks (N,) on no plane that touch a macroblock of a mover.

    Half of them are the mover's own, and one that drives ahead along the camera's way nearly
    keeps the epipolar geometry: the turn of each pair would lean by half a standard deviation.
    """
    moving = extraction.label == Label.MOVING
    if not moving.any():
        return moving
    cell = macroblock_of(extraction.x_cur)
    cell = tuple((cell - cell.min(axis=0)).T)
    taken = np.zeros(np.max(cell, axis=1) + 1, bool)
    taken[tuple(index[moving] for index in cell)] = True
    near = ndimage.binary_dilation(taken, np.ones((3, 3)))[cell]
    return near & (extraction.plane_id < 0)
