"""How far the motion vectors of a stream err together, measured while running."""

from collections.abc import Iterable
from dataclasses import dataclass
import math

from mv_slapse.changed import unchecked
from mv_slapse.config import SceneSettings
from mv_slapse.geometry import two_view
from mv_slapse.kernels.binding import compiled
from mv_slapse.records import Label
import numpy as np

LEAST = 50  # correspondences whose errors can tell
SLOW = 0.1  # weight of the newest pair in the running mean: some 10 pairs
TENTH = 6.25  # chi-square of 3 degrees of freedom is larger once in ten
AGREEMENT_STEP = 0.3  # of the log of the scale: some 60 planes seen make it a sixth
LEAST_SCALE = 0.1  # a tenfold conservative covariance; a lower one was not met on real streams
# Vectors that are copied from those around tell of another place. Its error is this share of
# theirs, times what the dependence exceeds 1 by: with it NEES, 6 if the covariance is right, is 10
# with x264's superfast at crf 28, and 39 without.
COPIED = 1.5
BOUNDS = (1.2, 30.0)  # no stream showed less; beyond, too few blocks remain independent


@dataclass(frozen=True)
class Dependence:
    """Correspondences that tell as much as one independent one, over the last pairs.

    ``pairs`` were seen; one tells the logarithm to 0.2, so the value before any is given up.
    ``sigma`` is that of the newest one's vectors [px].
    """

    value: float
    pairs: int = 0
    sigma: float = 0.0

    def seen(self, pair: two_view.Pair, R, t) -> 'Dependence':
        """Return it after one more pair, whose motion is R_cur_from_prev, t_cur_from_prev.

        The mean is one of logarithms: a pair in which a mover passes for the scene has a value
        many times too large.
        """
        if len(pair) < LEAST:
            return self
        weight = max(SLOW, 1 / (self.pairs + 1))
        newest, sigma = measured(pair, R, t)
        newest, before = math.log(min(max(newest, BOUNDS[0]), BOUNDS[1])), math.log(self.value)
        return Dependence(math.exp(before + weight * (newest - before)), self.pairs + 1, sigma)

    def settings(self, before: SceneSettings, label: np.ndarray) -> SceneSettings:
        """Return the settings with what the stream has shown of its noise, labels (N,) of a pair.

        Of the vectors that have no label as many may be movers' as of the others. No first pair
        has labels of movers, as it takes two to tell them: the second one's lean counts for both.
        """
        told = np.count_nonzero(label != Label.UNKNOWN.value)
        share = np.count_nonzero(label == Label.MOVING.value) / max(told, 1)
        share *= math.sqrt(1 + (self.pairs == 2))
        copied = COPIED * (self.value - 1) * self.sigma
        return unchecked(before, dependence=self.value, mover_bias=before.mover_bias * share,
                         place_bias=max(before.place_bias, copied))


@dataclass(frozen=True)
class Agreement:
    """How well planes seen again agree with what was predicted of them.

    ``scale`` is the square of their errors over what their covariances say: what the prediction
    allows for, such as braking hard, seldom comes, and a gate for it lets in what is wrong.
    """

    scale: float = 1.0

    def seen(self, distances: Iterable[float]) -> 'Agreement':
        """Return it after one more pair's squared distances, three degrees of freedom each.

        Follows the distance that one in ten exceeds, which outliers hardly move. Never above 1:
        a map that is wrong must not widen the gate.
        """
        scale = self.scale
        for distance in distances:
            beyond = float(distance > TENTH * scale)
            scale *= np.exp(AGREEMENT_STEP * (beyond - 0.1))
        return Agreement(float(min(max(scale, LEAST_SCALE), 1.0)))


def measured(pair: two_view.Pair, R, t) -> tuple[float, float]:
    """Return the variance of a mean of errors over that of independent ones, and a median sigma.

    Errors are those across epipolar lines, which no plane has to explain. Each is weighed as the
    update weighs it; products with all errors in the window around add up to the variance.
    """
    return compiled.error_dependence(pair.rays_cur, pair.rays_prev, pair.sigma, pair.x_prev,
                                     pair.focal, R, t, two_view.KERNEL_WIDTH)
