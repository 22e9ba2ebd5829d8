"""What a given speed tells the scene filter: how far the camera went between two key frames."""

from bisect import bisect_right, insort
from collections.abc import Iterable
from typing import NamedTuple

from mv_slapse.config import SceneSettings
from mv_slapse.records import Speed
from mv_slapse.scene import gating as scene_gate
from mv_slapse.scene import observations as scene_observations
from mv_slapse.scene.observations import Observation
from mv_slapse.scene.progress import Progress
from mv_slapse.scene.state import SceneState
import numpy as np

SOURCE = 'speed'  # as a source of the scale
HOLD = 500_000_000  # ns: a speed stands for no longer; wheels tell theirs 10 to 100 times a second
UNTOLD_SIGMA = 0.5  # of the log of a way that nothing tells: a flight may halve it
SLOWEST = 0.05  # m/s, below which wheels turn too little to tell a speed


class Travelled(NamedTuple):
    """Way [m] between two instants, negative backwards; ``held`` [s] of it no speed is known."""

    way: float
    held: float


class SpeedLog:
    """Keeps the speeds that are still of use."""

    def __init__(self):
        """Start without any."""
        self._speeds: list[Speed] = []

    def feed(self, speeds: Iterable[Speed]):
        """Take speeds in, in any order; values that are no numbers are left out."""
        for speed in speeds:
            if np.isfinite(speed.value):
                insort(self._speeds, speed, key=lambda known: known.stamp)

    def forget(self, start: int):
        """Drop what tells nothing from a stamp [ns] on: all before the last speed up to it."""
        at = bisect_right(self._speeds, start, key=lambda known: known.stamp)
        del self._speeds[:max(at - 1, 0)]

    def travelled(self, start: int, end: int) -> Travelled | None:
        """Return the way from one stamp [ns] to another; forget what is older.

        Speeds after ``end`` do not count: a robot does not have them yet, and a replay shall
        find the same. None where there is no speed for longer than ``HOLD``.
        """
        self.forget(start)
        known = [speed for speed in self._speeds if speed.stamp <= end]
        if not known or end <= start:
            return None
        time = np.array([speed.stamp - start for speed in known])
        limits = np.array([0, end - start])
        first, last = np.clip(time[[0, -1]], *limits)
        if np.diff(np.r_[min(time[0], 0), time, limits[1]]).max() > HOLD:
            return None
        at = np.r_[0, time[(time > 0) & (time < limits[1])], limits[1]]
        value = np.interp(at, time, [speed.value for speed in known])
        return Travelled(float(np.trapezoid(value, at) * 1e-9),
                         float(limits[1] - last + first) * 1e-9)


class Way(NamedTuple):
    """Distance [m] between two poses of the camera, and its standard deviation as a share."""

    length: float
    sigma: float


def way(log: SpeedLog, state: SceneState, progress: Progress, start: int, turn: float,
        settings: SceneSettings) -> Way | None:
    """Return how far the camera went from a stamp [ns] to the key frame.

    None where no speed tells it, or one that cannot be: of wheels that slip or stand, by the way
    predicted. From rest no way is predicted, nor is one of unknown unit to be compared with.
    """
    told = distance(log, start, progress.stamp, turn, settings)
    if told is None or progress.rested:
        return told if progress.metric else None
    foreseen = progress.started and progress.metric and not progress.anew
    sigma = float(np.hypot(told.sigma, settings.speed_bias))
    if foreseen and not scene_gate.holds_length(state, told.length, sigma):
        return None
    return told


def distance(log: SpeedLog, start: int, end: int, turn: float,
             settings: SceneSettings) -> Way | None:
    """Return the distance of the camera's places at two stamps [ns], None where none is told.

    A camera beside the place whose speed is told goes farther, or less far, in a ``turn`` [rad],
    and round a bend the distance is shorter than the way.
    """
    told = log.travelled(start, end)
    if told is None or abs(told.way) < SLOWEST * (end - start) * 1e-9:
        return None
    length = abs(told.way)
    unseen = settings.acceleration * np.sqrt(told.held**3 / 3)
    sigma = np.linalg.norm([settings.speed_sigma, settings.speed_arm * turn / length,
                            turn**2 / 24, unseen / length])
    return Way(length, float(sigma)) if sigma < UNTOLD_SIGMA else None


def observed(way: Way, settings: SceneSettings) -> Observation:
    """Return the observation of a way."""
    return scene_observations.baseline(way.length, way.sigma, settings.speed_bias)
