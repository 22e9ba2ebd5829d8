"""How far the motion vectors of a stream err together, measured while running."""

from dataclasses import dataclass

from mv_slapse.geometry import epipolar, two_view
import numpy as np
from scipy import ndimage

CELL = 16  # px, a macroblock: vectors of one and of its neighbours err together
REACH = 5  # macroblocks across the window in which errors are compared
WIDTH = 3.0  # of the kernel, as in the update
LEAST = 50  # correspondences whose errors can tell
SLOW = 0.1  # weight of the newest pair in the running mean: some 10 pairs
BOUNDS = (1.0, 30.0)  # a pair says little beyond: too few blocks remain independent


@dataclass(frozen=True)
class Dependence:
    """Correspondences that tell as much as one independent one, over the last pairs.

    ``pairs`` were seen; the value before any counts as one.
    """

    value: float
    pairs: int = 1

    def seen(self, pair: two_view.Pair, R, t) -> 'Dependence':
        """Return it after one more pair, whose motion is R_cur_from_prev, t_cur_from_prev.

        The mean is one of logarithms: a pair in which a mover passes for the scene has a value
        many times too large.
        """
        if len(pair) < LEAST:
            return self
        weight = max(SLOW, 1 / (self.pairs + 1))
        newest = np.log(np.clip(measured(pair, R, t), *BOUNDS))
        mean = np.log(self.value) + weight * (newest - np.log(self.value))
        return Dependence(float(np.exp(mean)), self.pairs + 1)


def measured(pair: two_view.Pair, R, t) -> float:
    """Return the variance of a mean of errors, over what independent ones would have.

    Errors are those across epipolar lines, which no plane has to explain. Each is weighed as the
    update weighs it; products with all errors in the window around add up to the variance.
    """
    error = epipolar.epipolar_error(pair.rays_cur, pair.rays_prev, pair.focal, R, t) / pair.sigma
    bounded = 1 / (1 + np.square(error / WIDTH))
    weight = np.square(bounded)
    influence = weight * error
    slope = weight - 4 * np.square(error / WIDTH) * bounded**3
    cell = np.floor(pair.x_prev / CELL).astype(int)
    cell -= cell.min(axis=0)
    total = np.zeros(cell.max(axis=0) + 1)
    np.add.at(total, tuple(cell.T), influence)
    around = ndimage.uniform_filter(total, REACH, mode='constant') * REACH**2
    variance = np.sum(total * around) / len(error)
    return float(variance * weight.mean() / max(slope.mean(), 0.1) ** 2)
