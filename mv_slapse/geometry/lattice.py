"""The lattice of macroblocks: which cell a pixel lies in, and which blocks belong together."""

from mv_slapse.geometry.blocks import CELL
from mv_slapse.kernels.binding import compiled
import numpy as np


def cells(x: np.ndarray, shape: tuple[int, int], size: int = CELL) -> tuple:
    """Return row and column of the cells in which pixels (N, 2) lie, clipped to a shape."""
    column = np.clip(np.floor((x[:, 0] + 0.5) / size).astype(int), 0, shape[1] - 1)
    row = np.clip(np.floor((x[:, 1] + 0.5) / size).astype(int), 0, shape[0] - 1)
    return row, column


def shape_of(width: int, height: int, size: int = CELL) -> tuple[int, int]:
    """Return rows and columns of the lattice of a picture [px]."""
    return -(-height // size), -(-width // size)


def paint(width: int, height: int, x: np.ndarray, block: np.ndarray, values: np.ndarray):
    """Return an int32 grid of cells that holds each block's value, -1 elsewhere.

    Where blocks overlap the later one wins.
    """
    return compiled.paint_cells(width, height, np.ascontiguousarray(x, float),
                                np.ascontiguousarray(block, float),
                                np.ascontiguousarray(values, np.int32))


def lookup(grid: np.ndarray, x: np.ndarray) -> np.ndarray:
    """Return the grid's value at pixels (N, 2), -1 outside."""
    inside = ((x[:, 0] >= -0.5) & (x[:, 0] < grid.shape[1] * CELL - 0.5)
              & (x[:, 1] >= -0.5) & (x[:, 1] < grid.shape[0] * CELL - 0.5))
    return np.where(inside, grid[cells(x, grid.shape)], -1)


def count_macroblocks(x: np.ndarray) -> int:
    """Return in how many macroblocks pixels (N, 2) lie."""
    return compiled.count_macroblocks(np.ascontiguousarray(x, float))


def components(x: np.ndarray, reach: int = 1) -> np.ndarray:
    """Return for each block (N, 2) the number of its connected component, from 0.

    Blocks are connected over gaps of up to ``2 * reach`` macroblocks. Components are numbered in
    the order of their first macroblocks, row by row.
    """
    return compiled.components(np.ascontiguousarray(x, float), reach)


def largest_components(x: np.ndarray, smallest: int, reach: int = 1) -> np.ndarray:
    """Return the mask of blocks in components of at least ``smallest`` macroblocks."""
    return compiled.largest_components(np.ascontiguousarray(x, float), smallest, reach)
