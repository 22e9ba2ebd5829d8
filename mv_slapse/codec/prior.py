"""The motion field of the pairs before, as the expectation for the next one."""

from mv_slapse.geometry.blocks import macroblock_of
from mv_slapse.kernels.binding import compiled
from mv_slapse.records import Correspondences
import numpy as np


class MotionPrior:
    """Velocity in the picture for each macroblock.

    A surface that the camera moves along, such as the road, keeps its motion at its place in the
    picture, so the last pair tells what to expect.
    """

    def __init__(self):
        """Expect nothing yet."""
        self._velocity: np.ndarray | None = None

    def add(self, pair: Correspondences):
        """Take in the supported vectors of a merged pair; one without any changes nothing.

        Where the pair has none the older ones stay, with little weight, and holes are filled with
        the mean of the smallest window around that has any.
        """
        if not len(pair):
            return
        seconds = (pair.stamp - pair.previous_stamp) * 1e-9
        self._velocity = compiled.prior_update((pair.x_cur, pair.x_prev, pair.probability),
                                               self._velocity, pair.width, pair.height, seconds)

    def reset(self):
        """Forget, after a cut or a change of size."""
        self._velocity = None

    def field(self, seconds: float, x: np.ndarray, vector: np.ndarray) -> np.ndarray | None:
        """Return the expected vectors (rows, columns, 2) [px] over a time [s]; None: unknown.

        A turn of the camera moves the whole picture: the shift between the expected and the
        vectors at hand, x and vector (N, 2) [px], most of which may be wrong, is found as a
        trimmed median and added.
        """
        if self._velocity is None:
            return None
        return compiled.prior_field(self._velocity, seconds, x, vector)


def at(field: np.ndarray, x: np.ndarray) -> np.ndarray:
    """Return the values (N, 2) of a field at pixels (N, 2), those of their macroblocks."""
    column, row = np.clip(macroblock_of(x), 0, (field.shape[1] - 1, field.shape[0] - 1)).T
    return field[row, column]
