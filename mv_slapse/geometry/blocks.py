"""The blocks that a codec's pictures are cut into: their sizes, and which one a pixel lies in."""

import numpy as np

MACROBLOCK = 16  # px, of MPEG-1/2/4, H.263 and H.264: vectors of one and of its neighbours agree


def macroblock_of(x: np.ndarray) -> np.ndarray:
    """Return column and row (N, 2) int of the macroblocks in which pixels (N, 2) lie."""
    return np.floor((x + 0.5) / MACROBLOCK).astype(np.intp)


def grid_shape(width: int, height: int) -> tuple[int, int]:
    """Return columns and rows of macroblocks; those cut by the border count."""
    return -(-width // MACROBLOCK), -(-height // MACROBLOCK)


def grid_index(x: np.ndarray, width: int, height: int) -> np.ndarray:
    """Return the number (N,) int of the macroblock that holds each pixel (N, 2), row by row.

    -1 outside the picture.
    """
    columns, rows = grid_shape(width, height)
    column, row = macroblock_of(x).T
    inside = (column >= 0) & (column < columns) & (row >= 0) & (row < rows)
    return np.where(inside, row * columns + column, -1)


def grid_centres(width: int, height: int) -> np.ndarray:
    """Return the centres (M, 2) of the macroblocks [px], row by row."""
    columns, rows = grid_shape(width, height)
    y, x = np.mgrid[:rows, :columns]
    return MACROBLOCK * np.c_[x.ravel(), y.ravel()] + (MACROBLOCK - 1) / 2
