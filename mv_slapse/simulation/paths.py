"""Lines on the ground and how fast they are driven.

Ground coordinates are (x right, z forward) [m] in {S}, the street: ground at y = 0, y down.
A heading h [rad] points along (sin h, cos h), so positive turns right.
"""

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Place:
    """A point of a path: position (2,) [m], heading [rad], curvature [1/m]."""

    position: np.ndarray
    heading: float
    curvature: float = 0.0

    @property
    def ahead(self) -> np.ndarray:
        """Return the unit vector along the path, (x, z)."""
        return np.array([np.sin(self.heading), np.cos(self.heading)])

    @property
    def right(self) -> np.ndarray:
        """Return the unit vector to the right of the path, (x, z)."""
        return np.array([np.cos(self.heading), -np.sin(self.heading)])

    def beside(self, lateral: float) -> np.ndarray:
        """Return the point (x, z) that lies ``lateral`` [m] to the right."""
        return self.position + lateral * self.right

    def onward(self, length: float) -> 'Place':
        """Return the place ``length`` [m] farther at constant curvature."""
        k, h = self.curvature, self.heading
        if k == 0:
            return Place(self.position + length * self.ahead, h)
        h_end = h + k * length
        step = np.array([np.cos(h) - np.cos(h_end), np.sin(h_end) - np.sin(h)]) / k
        return Place(self.position + step, h_end, k)


@dataclass(frozen=True)
class Path:
    """Straights and arcs, straight on before the first and after the last.

    Attributes
    ----------
    pieces : tuple of (float, float)
        Length [m] and curvature [1/m] of each.
    origin, heading : tuple, float
        Place at s = 0: (x, z) [m] and [rad].
    """

    pieces: tuple[tuple[float, float], ...] = ()
    origin: tuple[float, float] = (0.0, 0.0)
    heading: float = 0.0

    def at(self, s: float) -> Place:
        """Return the place at arc length s [m]."""
        place = Place(np.array(self.origin, float), self.heading)
        if s <= 0:
            return place.onward(s)
        for length, curvature in self.pieces:
            place = Place(place.position, place.heading, curvature)
            if s <= length:
                return place.onward(s)
            place, s = place.onward(length), s - length
        return Place(place.position, place.heading).onward(s)

    def stations(self, s0: float, s1: float, step: float = 4.0) -> np.ndarray:
        """Return arc lengths from s0 to s1 [m]: ends of straights, every ``step`` in arcs."""
        found, start = [s0, s1], 0.0
        for length, curvature in self.pieces:
            n = max(1, int(np.ceil(length / step))) if curvature else 1
            found += [s for s in start + length * np.arange(n + 1) / n if s0 < s < s1]
            start += length
        return np.unique(found)


@dataclass(frozen=True)
class SpeedProfile:
    """A speed that is linear in time between knots and constant outside.

    Attributes
    ----------
    times, speeds : tuple of float
        Knots [s], [m/s].
    """

    times: tuple[float, ...]
    speeds: tuple[float, ...]

    def speed(self, time: float) -> float:
        """Return the speed [m/s]."""
        return float(np.interp(time, self.times, self.speeds))

    def distance(self, time: float) -> float:
        """Return the exact integral of the speed from time 0 [m]."""
        low, high = min(0.0, time), max(0.0, time)
        knots = [low, *(t for t in self.times if low < t < high), high]
        speeds = np.interp(knots, self.times, self.speeds)
        return float(np.sign(time) * np.sum(np.diff(knots) * (speeds[1:] + speeds[:-1]) / 2))


def steady(speed: float) -> SpeedProfile:
    """Return a constant speed [m/s]."""
    return SpeedProfile((0.0,), (speed,))


def with_stop(speed: float, start: float, end: float, ramp: float = 1.5) -> SpeedProfile:
    """Return a speed that is zero from start to end [s], with ramps [s] before and after.

    A start at or before time 0 begins at rest.
    """
    if start <= 0:
        return SpeedProfile((0.0, end, end + ramp), (0.0, 0.0, speed))
    first = max(0.0, start - ramp)
    return SpeedProfile((first, start, end, end + ramp), (speed, 0.0, 0.0, speed))
