"""The blocks that a codec's pictures are cut into: their sizes, and which one a pixel lies in."""

from mv_slapse.kernels.binding import compiled
import numpy as np

MACROBLOCK = 16  # px, of MPEG-1/2/4, H.263 and H.264: vectors of one and of its neighbours agree
# Share of a block that a vehicle must cover to give it its vector: roads are plain, and vehicles
# are not. On rendered streets the lowest blocks end 5 to 8 px below the vehicle, not 0.
COVERED = 0.1


def macroblock_of(x: np.ndarray) -> np.ndarray:
    """Return column and row (N, 2) int of the macroblocks in which pixels (N, 2) lie."""
    return np.floor((x + 0.5) / MACROBLOCK).astype(np.intp)


def grid_shape(width: int, height: int) -> tuple[int, int]:
    """Return columns and rows of macroblocks; those cut by the border count."""
    return -(-width // MACROBLOCK), -(-height // MACROBLOCK)


def grid_centres(width: int, height: int) -> np.ndarray:
    """Return the centres (M, 2) of the macroblocks [px], row by row."""
    columns, rows = grid_shape(width, height)
    y, x = np.mgrid[:rows, :columns]
    return MACROBLOCK * np.c_[x.ravel(), y.ravel()] + (MACROBLOCK - 1) / 2


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
