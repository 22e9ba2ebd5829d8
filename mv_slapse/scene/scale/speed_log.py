"""Speeds of the vehicle as they were told, and the way between two instants: SpeedLog."""

from bisect import bisect_right, insort
from collections.abc import Iterable
from typing import NamedTuple

from mv_slapse.records import Speed
import numpy as np

HOLD = 500_000_000  # ns: a speed stands for no longer; wheels tell theirs 10 to 100 times a second


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

    def travelled(self, start: int, end: int) -> Travelled | None:
        """Return the way from one stamp [ns] to another; forget what is older.

        Speeds after ``end`` do not count: a robot does not have them yet, and a replay shall
        find the same. None where there is no speed for longer than ``HOLD``.
        """
        stamps = [speed.stamp for speed in self._speeds]
        del self._speeds[:max(bisect_right(stamps, start) - 1, 0)]
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
