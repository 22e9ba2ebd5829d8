"""Large pictures on a coarser lattice, so that the cost of a pair is bounded.

What the extraction asks of blocks is asked of macroblocks of 16 px. A picture with more of them
than ``max_blocks`` is taken as the same picture on a smaller sensor: pixels are divided by a
factor, and of the blocks in each macroblock of that sensor the most telling one stands for all.
"""

from functools import lru_cache

from mv_slapse.changed import replace
from mv_slapse.geometry.blocks import grid_centres, grid_shape, MACROBLOCK, macroblock_of
from mv_slapse.geometry.camera import Camera
from mv_slapse.kernels.binding import compiled
from mv_slapse.records import Correspondences, Extraction
from mv_slapse.strip_matches import NONE
import numpy as np


def factor_of(width: int, height: int, max_blocks: int) -> float:
    """Return by which factor a picture [px] is too large for so many macroblocks; 1: by none.

    It is one of the steps 1, 1.5, 2 and so on, so that a macroblock of the smaller picture holds
    as many blocks as the next one.
    """
    columns, rows = grid_shape(width, height)
    return max(1.0, float(np.ceil(2 * np.sqrt(columns * rows / max_blocks)) / 2))


def camera_of(camera: Camera, factor: float) -> Camera:
    """Return the camera that takes a picture smaller by a factor; its lens stays."""
    K = camera.K / factor
    K[:2, 2], K[2, 2] = _smaller(camera.K[:2, 2], factor), 1.0
    width, height = _size(camera.width, camera.height, factor)
    return replace(camera, width=width, height=height, K=K)


def correspondences_of(given: Correspondences, factor: float) -> Correspondences:
    """Return what a picture smaller by a factor shows: one block at most for each macroblock.

    It is the one whose vector is most probable, of equal ones the one with the least noise, and
    stands for all of the macroblock.
    """
    x = _smaller(given.x_cur, factor)
    width, height = _size(given.width, given.height, factor)
    rows = compiled.best_of_cells(
        _cell(x, width, height), int(np.prod(grid_shape(width, height))),
        given.probability.astype(float), given.sigma.astype(float))
    return replace(
        given, width=width, height=height, x_cur=x[rows].astype(np.float32),
        x_prev=_smaller(given.x_prev[rows], factor).astype(np.float32),
        sigma=(given.sigma[rows] / factor).astype(np.float32),
        probability=given.probability[rows],
        block=np.full((len(rows), 2), MACROBLOCK, np.uint8), strips=NONE)


def extraction_of(coarse: Extraction, factor: float, given: Correspondences,
                  K: np.ndarray) -> Extraction:
    """Return an extraction of the smaller picture in pixels and macroblocks of the given one.

    ``K`` (3, 3): intrinsics of the given one [px].
    """
    cell = _cells(given.width, given.height, factor)
    size = np.round(coarse.block * factor).astype(np.uint8)
    return replace(
        coarse, width=given.width, height=given.height, K=K, block=size,
        x_cur=_larger(coarse.x_cur, factor).astype(np.float32),
        x_prev=_larger(coarse.x_prev, factor).astype(np.float32),
        sigma=(coarse.sigma * factor).astype(np.float32),
        macroblock_label=coarse.macroblock_label[cell],
        macroblock_plane=coarse.macroblock_plane[cell])


@lru_cache(4)
def _cells(width: int, height: int, factor: float) -> np.ndarray:
    """Return which macroblock (M,) of a smaller picture holds each of a picture [px]."""
    return _cell(_smaller(grid_centres(width, height), factor), *_size(width, height, factor))


def _cell(x: np.ndarray, width: int, height: int) -> np.ndarray:
    """Return which macroblock (N,) of a picture holds each pixel (N, 2).

    The last ones hold what lies at the edge: a larger picture's macroblocks reach beyond it.
    """
    columns, rows = grid_shape(width, height)
    column, row = macroblock_of(x).T
    return np.clip(row, 0, rows - 1) * columns + np.clip(column, 0, columns - 1)


def _smaller(x: np.ndarray, factor: float) -> np.ndarray:
    """Return pixels (..., 2) of a picture smaller by a factor; centres lie at whole numbers."""
    return (np.asarray(x, float) + 0.5) / factor - 0.5


def _larger(x: np.ndarray, factor: float) -> np.ndarray:
    """Return pixels (..., 2) of the picture that ``_smaller`` was given."""
    return (np.asarray(x, float) + 0.5) * factor - 0.5


def _size(width: int, height: int, factor: float) -> tuple[int, int]:
    return int(np.ceil(width / factor)), int(np.ceil(height / factor))
