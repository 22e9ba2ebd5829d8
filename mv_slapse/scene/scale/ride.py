"""Whether a camera whose height nobody gave keeps to the ground, and at which height.

Such a height says nothing of metres, but it stays, and so does the scale after it: a pair's ground
tells the length of its way, as with a height that is given.
"""

from dataclasses import dataclass, field
from typing import NamedTuple

from mv_slapse.changed import replace, unchecked
from mv_slapse.config import SceneSettings
from mv_slapse.filters import ekf
from mv_slapse.geometry.rotation import norm
from mv_slapse.records import CameraMotion
from mv_slapse.scene import observations as scene_observations
from mv_slapse.scene.observations import Observation
from mv_slapse.scene.state import HEIGHT, N_LASTING, plane_in_camera, relative_motion, SceneState
import numpy as np


class Rules(NamedTuple):
    """Constants of keeping to the ground.

    RMS over the way: cars showed at most 0.012, 0.027 and 0.05, a walk and flights 0.1 and more.
    """

    way: float = 10.0  # heights over which the camera must keep to the ground: 15 m of a car
    least: int = 10  # pairs in which it does
    off: float = 0.02  # rad, RMS of the course's angle with the ground,
    swing: float = 0.03  # rad, of the normal's about its mean,
    change: float = 0.05  # and of the log of the height
    release: float = 2.0  # times the angles: the camera leaves the ground
    leap: float = 0.08  # rad: or by one course, so far off; vehicles showed 0.02 at most


RULES = Rules()


class Sight(NamedTuple):
    """What a pair shows: way [map unit], log of the height, normal, angle of the course to it."""

    way: float
    height: float
    normal: np.ndarray
    off: float


@dataclass(frozen=True)
class Ride:
    """Height [map unit] at which the camera has been seen to ride, 0 where it has not."""

    height: float = 0.0
    # (N_LASTING,): what errors that last have done to it, as shares of it; its own is one of them
    error: np.ndarray = field(default_factory=lambda: np.zeros(N_LASTING))
    sights: tuple[Sight, ...] = ()  # what the last pairs have shown

    def released(self, state: SceneState) -> 'Ride':
        """Return the beginning anew; what was not known of the height is the state's again."""
        if self.height:
            ekf.estimate_again(state.error, HEIGHT.start)
        return Ride()

    def observations(self, ground: int, settings: SceneSettings) -> list[Observation]:
        """Return what is known of a camera that rides above a plane of the map, if it does.

        Of a height that is given how wrong it was measured lasts; of another what is in ``error``.
        """
        height, lasting = settings.camera_height or self.height, self.error.copy()
        if not height:
            return []
        if settings.camera_height:
            lasting[HEIGHT] = settings.camera_height_bias
        return scene_observations.mounted(
            ground, unchecked(settings, camera_height=height), lasting)

    def kept(self, state: SceneState, motion: CameraMotion) -> 'Ride':
        """Return it before an update by a pair, whose course may leave the ground."""
        if not self.height:
            return self
        normal = np.mean([sight.normal for sight in self.sights], axis=0)
        off = abs(normal @ motion.t_cur_from_prev)
        sigma = np.sqrt(normal @ motion.covariance[3:, 3:] @ normal)
        return self.released(state) if off > RULES.leap + 3 * sigma else self

    def seen(self, state: SceneState, ground: int) -> 'Ride':
        """Return it after an update by one more pair, whose ``ground`` is a plane of the map.

        Whether the camera still, or at last, keeps to the ground. What the state does not know of
        a height that is taken becomes an error that lasts.
        """
        depth, H = scene_observations.height_above(state, ground)
        sights = _last((*self.sights, _sight(state, ground, depth)), RULES.way * depth)
        off, swing, change = _departures(sights)
        if self.height:
            left = off > RULES.release * RULES.off or swing > RULES.release * RULES.swing
            return self.released(state) if left else replace(self, sights=sights)
        long = sum(sight.way for sight in sights) >= RULES.way * depth
        if len(sights) >= RULES.least and long and off < RULES.off and (
                swing < RULES.swing and change < RULES.change):
            error = ekf.consider(state.error, H, HEIGHT.start)
            return replace(self, height=depth, error=error, sights=sights)
        return replace(self, sights=sights)


def _sight(state: SceneState, ground: int, depth: float) -> Sight:
    """Return what the state after an update says of the last pair."""
    normal, (_, t) = plane_in_camera(state, ground) * depth, relative_motion(state)
    way = norm(t)
    return Sight(way, float(np.log(depth)), normal, float(np.arcsin(normal @ t / max(way, 1e-9))))


def _last(sights: tuple[Sight, ...], way: float) -> tuple[Sight, ...]:
    """Return the newest ones, as many as a way [map unit] takes."""
    behind = np.cumsum([sight.way for sight in sights[::-1]])
    return sights[-1 - int(np.searchsorted(behind, way)):]


def _departures(sights: tuple[Sight, ...]) -> tuple[float, float, float]:
    """Return the RMS of the course off the ground, of the normal's and the height's departures."""
    normals = np.array([sight.normal for sight in sights])
    swing = np.sqrt(np.mean(np.sum(np.square(normals - normals.mean(axis=0)), axis=1)))
    off = np.sqrt(np.mean(np.square([sight.off for sight in sights])))
    return float(off), float(swing), float(np.std([sight.height for sight in sights]))
