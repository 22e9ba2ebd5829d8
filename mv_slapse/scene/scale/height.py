"""When a given camera height tells metres: once successive grounds agree.

One pair's ground may be wrong by half, and so may the next, where few vectors on the road are
right. Metres that the first one told would be put right within some 20 s only; until then poses
would be wrong, and sure.
"""

from dataclasses import dataclass

from mv_slapse.config import SceneSettings
from mv_slapse.records import PlaneObservation
import numpy as np

SOURCE = 'camera height'  # as a source of the scale
ENOUGH = 3  # grounds in succession: two that agreed and were wrong have been met
GROSS = 0.3  # of the log of lengths that are wrong: grounds that agree err by 0.2, as measured
GATE = 5.99  # 95 % of chi-square with two degrees of freedom: departures of three from their mean


@dataclass(frozen=True)
class Grounds:
    """What the last grounds seen, ``ENOUGH`` at most, say of the map's unit of length.

    ``logs``: of the metres that make one unit; ``variances`` of these.
    """

    logs: tuple[float, ...] = ()
    variances: tuple[float, ...] = ()

    def seen(self, ground: PlaneObservation, length: float, settings: SceneSettings) -> 'Grounds':
        """Return it after one more pair that shows the ground; its way is so long [map unit]."""
        plane, square = ground.plane, ground.plane @ ground.plane
        told = settings.depth_dependence * (plane @ ground.covariance @ plane) / square**2
        variance = told + settings.depth_bias**2 + settings.camera_height_sigma**2
        log = np.log(settings.camera_height * np.sqrt(square) / length)
        return Grounds((*self.logs, float(log))[-ENOUGH:],
                       (*self.variances, float(variance))[-ENOUGH:])

    def metres(self, least: float = 0.0) -> float | None:
        """Return how many make a unit, None while grounds are too few or contradict each other.

        None, too, where the log of it is less than ``least``.
        """
        if len(self.logs) < ENOUGH:
            return None
        logs, weights = np.array(self.logs), 1 / np.array(self.variances)
        mean = float(weights @ logs / weights.sum())
        agree = weights @ np.square(logs - mean) < GATE
        return float(np.exp(mean)) if agree and abs(mean) >= least else None
