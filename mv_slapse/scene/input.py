"""What an extraction tells the scene filter: correspondences that count, the pose they show."""

from mv_slapse.geometry import two_view
from mv_slapse.geometry.blocks import macroblock_of
from mv_slapse.geometry.camera import to_rays
from mv_slapse.records import CameraMotion, Extraction, Label
from mv_slapse.scene.state import Pose
import numpy as np
from scipy import ndimage

AROUND = 5  # macroblocks across the window in which what is still must be the greater part


def stationary(extraction: Extraction):
    """Return the stationary correspondences and the plane id of each (N,)."""
    still = ((extraction.label == Label.STATIONARY) | (extraction.label == Label.INFINITY))
    stray = _beside_movers(extraction) | (_share_around(extraction, still) < 0.5)
    stationary = still & ((extraction.plane_id >= 0) | ~stray)
    x_cur, x_prev = (x[stationary].astype(float) for x in (extraction.x_cur, extraction.x_prev))
    pair = two_view.Pair(to_rays(extraction.K, x_cur), to_rays(extraction.K, x_prev), x_prev,
                         extraction.sigma[stationary].astype(float), extraction.K)
    return pair, extraction.plane_id[stationary]


def _beside_movers(extraction: Extraction) -> np.ndarray:
    """Return the blocks (N,) that touch a macroblock of a mover.

    On no plane half of them are the mover's own, and one that drives ahead along the camera's way
    nearly keeps the epipolar geometry: the turn of each pair would lean by half a standard
    deviation.
    """
    moving = extraction.label == Label.MOVING
    if not moving.any():
        return moving
    cell = _cells(extraction)
    taken = np.zeros(np.max(cell, axis=1) + 1, bool)
    taken[tuple(index[moving] for index in cell)] = True
    return ndimage.binary_dilation(taken, np.ones((3, 3)))[cell]


def _share_around(extraction: Extraction, still: np.ndarray) -> np.ndarray:
    """Return the share (N,) of the vectors around each block, itself too, that are ``still``.

    A few of a mover's wrong vectors lie on their epipolar lines by chance, most often on those of
    a motion that leans already: on no plane only the blocks around tell.
    """
    cell = _cells(extraction)
    total, agree = np.zeros((2, *(np.max(cell, axis=1, initial=0) + 1)))
    np.add.at(total, cell, 1.0)
    np.add.at(agree, cell, still.astype(float))
    around, agreeing = (ndimage.uniform_filter(grid, AROUND, mode='constant')[cell]
                        for grid in (total, agree))
    return agreeing / np.maximum(around, 1e-9)


def _cells(extraction: Extraction) -> tuple[np.ndarray, np.ndarray]:
    """Return the macroblock of each block, counted from the first: two (N,) int arrays."""
    cell = macroblock_of(extraction.x_cur)
    return tuple((cell - cell.min(axis=0, initial=0)).T)


def shown(previous: Pose, motion: CameraMotion, baseline: float) -> Pose:
    """Return the pose that a pair shows after the previous one, its way so long [map unit]."""
    R_world_from_cam = previous.R @ motion.R_cur_from_prev.T
    return Pose(R_world_from_cam,
                previous.t - R_world_from_cam @ motion.t_cur_from_prev * baseline)
