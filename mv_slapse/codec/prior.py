"""The motion field of the pairs before, as the expectation for the next one."""

import cv2
from mv_slapse.geometry.blocks import MACROBLOCK, macroblock_of
from mv_slapse.records import Correspondences
import numpy as np

FORGET = 0.5  # share of the older field that stays where there is a newer one
SAMPLE = 600  # vectors that are enough to find the shift
TRIM = (64.0, 24.0, 12.0, 12.0)  # px, about the shift
SPREAD = (3, 7, 15, 31)  # macroblocks, windows that fill holes, the finest that has a value first


class MotionPrior:
    """Velocity in the picture for each macroblock.

    A surface that the camera moves along, such as the road, keeps its motion at its place in the
    picture, so the last pair tells what to expect.
    """

    def __init__(self):
        """Expect nothing yet."""
        self._velocity: np.ndarray | None = None

    def add(self, pair: Correspondences):
        """Take in a merged pair; one without vectors changes nothing."""
        if not len(pair):
            return
        seconds = (pair.stamp - pair.previous_stamp) * 1e-9
        grid = field_of(pair) / np.float32(seconds)
        weight = np.isfinite(grid[..., 0]).astype(np.float32)
        grid = np.where(weight[..., None] > 0, grid, np.float32(0))
        if self._velocity is not None and self._velocity.shape == grid.shape:
            grid += FORGET * self._velocity * np.where(weight[..., None] > 0, 0.5, 0.1)
            weight += FORGET * np.where(weight > 0, 0.5, 0.1).astype(np.float32)
        self._velocity = _filled(grid, weight)

    def reset(self):
        """Forget, after a cut or a change of size."""
        self._velocity = None

    def field(self, seconds: float, x: np.ndarray, vector: np.ndarray) -> np.ndarray | None:
        """Return the expected vectors (rows, columns, 2) [px] over a time [s]; None: unknown.

        A turn of the camera moves the whole picture: the shift between the expected and the
        vectors at hand, most of which may be wrong, is found as a trimmed median and added.

        Parameters
        ----------
        seconds : float
        x, vector : (N, 2) float32
            Vectors at hand, unfiltered [px].
        """
        if self._velocity is None:
            return None
        field = self._velocity * np.float32(seconds)
        some = slice(None, None, max(len(x) // SAMPLE, 1))
        gap = vector[some] - at(field, x[some])
        shift = np.zeros(2, np.float32)
        for width in TRIM:
            near = (np.abs(gap[:, 0] - shift[0]) < width) & (np.abs(gap[:, 1] - shift[1]) < width)
            if np.count_nonzero(near) < 20:
                break
            shift = np.median(gap[near], axis=0)
        return field + shift


def field_of(pair: Correspondences) -> np.ndarray:
    """Return the vectors (rows, columns, 2) of a merged pair, NaN in macroblocks without one."""
    shape = -(-pair.height // MACROBLOCK), -(-pair.width // MACROBLOCK)
    field = np.full((*shape, 2), np.nan, np.float32)
    column, row = macroblock_of(pair.x_cur).T
    field[row, column] = pair.x_prev - pair.x_cur
    return field


def at(field: np.ndarray, x: np.ndarray) -> np.ndarray:
    """Return the values (N, 2) of a field at pixels (N, 2), those of their macroblocks."""
    column, row = np.clip(macroblock_of(x), 0, (field.shape[1] - 1, field.shape[0] - 1)).T
    return field[row, column]


def _filled(grid: np.ndarray, weight: np.ndarray) -> np.ndarray:
    """Return the field with holes filled by the mean of the smallest window that has a value."""
    out, done = np.zeros_like(grid), np.zeros(weight.shape, bool)
    for size in SPREAD:
        total = cv2.blur(weight, (size, size), borderType=cv2.BORDER_CONSTANT)
        mean = cv2.blur(grid, (size, size), borderType=cv2.BORDER_CONSTANT)
        new = ~done & (total * size * size > 0.9)
        out[new] = mean[new] / total[new][:, None]
        done |= new
    return out
