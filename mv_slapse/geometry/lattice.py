"""The lattice of macroblocks: which cell a pixel lies in, and which blocks belong together."""

from mv_slapse.kernels.binding import compiled
import numpy as np


def paint(width: int, height: int, x: np.ndarray, block: np.ndarray, values: np.ndarray):
    """Return an int32 grid of cells that holds each block's value, -1 elsewhere.

    Where blocks overlap the later one wins.
    """
    return compiled.paint_cells(width, height, np.ascontiguousarray(x, float),
                                np.ascontiguousarray(block, float),
                                np.ascontiguousarray(values, np.int32))


def lookup(grid: np.ndarray, x: np.ndarray) -> np.ndarray:
    """Return the grid's value at pixels (N, 2), -1 outside."""
    return compiled.look_up_cells(grid, np.ascontiguousarray(x, float))


def count_macroblocks(x: np.ndarray) -> int:
    """Return in how many macroblocks pixels (N, 2) lie."""
    return compiled.count_macroblocks(np.ascontiguousarray(x, float))
