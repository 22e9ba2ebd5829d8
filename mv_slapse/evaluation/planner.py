"""What a planner needs: what lies ahead is confirmed in time, and nothing else is.

A *hazard* is a mover that the camera would meet if both went on as they do, seen to come within
ASIDE of its way. It must be a confirmed obstacle by the time to contact BRAKES, or PROMPT after it
covers LARGE macroblocks where that is later. Any *other* mover must be one PROMPT after it covers
SEEN macroblocks. *False braking* is a key frame with a confirmed obstacle on the camera's way, its
time to contact below BRAKES_FOR, where no mover is.
"""

from typing import Any, NamedTuple

from mv_slapse.evaluation import tracking
from mv_slapse.evaluation.detection import (
    confirmed,
    hold_movers,
    MIN_MACROBLOCKS,
    PointLabels,
    published,
    select,
    Table,
)
from mv_slapse.storage.tum import Trajectory
import numpy as np

ASIDE = 1.2  # [m] between the camera's way and the nearest side of what it meets
HALF_WIDTH = 0.9  # [m] of a vehicle: from its middle, where an obstacle's position is, to its side
LARGE, SEEN = 12, 9  # macroblocks
BRAKES, LATEST = 2.0, 1.0  # [s] to contact by which it is in time, and late: later it is missed
BRAKES_FOR = 3.0  # [s]
SLOWEST = 0.5  # [m/s] slower, a camera's way has no direction


class Course(NamedTuple):
    """The estimated way of the camera.

    Attributes
    ----------
    path : Trajectory
        [map unit].
    scale : float or None
        Metres for a map unit; None: not known, and nothing is too far aside to brake for.
    """

    path: Trajectory
    scale: float | None


class Hazard(NamedTuple):
    """A mover on the camera's way: by when [ns] it must be confirmed, and when it is too late."""

    mover: int
    start: int
    due: int
    end: int


def figures(obstacles: Table, stamps: np.ndarray, movers: Table | None, course: Course,
            points: PointLabels | None = None) -> dict[str, Any]:
    """Return how many movers are confirmed in time, and in how many key frames none is ahead.

    Parameters
    ----------
    obstacles, movers : dict
        Columns of obstacles.csv and movers.csv; None: nothing moves; only boxes: no hazard is
        known, but what is none.
    stamps : (F,) int
        Of all key frames [ns].
    course : Course
    points : PointLabels or None
        Where ``movers`` are the boxes around these: they tell better what an obstacle is on.
    """
    rows = published(obstacles)
    found: dict[str, Any] = {}
    if movers is not None:
        frames = tracking.key_frames(stamps, movers)
        if 'aside' in movers:
            ahead = hazards(movers)
            met = tracking.matched(confirmed(obstacles), movers, frames)
            found = _hazards_met(ahead, movers, met) | _others_met(ahead, movers, met)
        rows = select(rows, tracking.are_false(rows, movers, frames))
    if points is not None:
        rows = select(rows, ~hold_movers(rows, points))
    brakes = rows['stamp'][braked_for(rows, course)]
    return found | {'false_braking_frames': len(np.unique(brakes)), 'frames_judged': len(stamps)}


def _hazards_met(ahead: list[Hazard], movers: Table, met: list[tracking.Match]
                 ) -> dict[str, Any]:
    first = [(hazard, _first(hazard, met)) for hazard in ahead]
    contact = [_contact(movers, hazard.mover, stamp) for hazard, stamp in first
               if stamp is not None]
    return {'hazards': len(first),
            'hazards_in_time': sum(stamp is not None and stamp <= hazard.due
                                   for hazard, stamp in first),
            'hazards_missed': sum(stamp is None for _, stamp in first),
            'contact_at_confirmation_s': float(np.median(contact)) if contact else None}


def _others_met(ahead: list[Hazard], movers: Table, met: list[tracking.Match]) -> dict[str, Any]:
    seen = ((movers['n_macroblocks'] >= SEEN) & (tracking.speed(movers) >= tracking.MOVING)
            & ~np.isin(movers['id'], [hazard.mover for hazard in ahead]))
    prompt = tracking.met_in_time(tracking.passages(movers, seen), met)
    return {'others': len(prompt), 'others_in_time': sum(prompt)}


def hazards(movers: Table) -> list[Hazard]:
    """Return what the camera would meet, of a table of movers; what is never urgent is none."""
    ahead = ((movers['aside'] <= ASIDE) & (movers['n_macroblocks'] >= MIN_MACROBLOCKS)
             & (tracking.speed(movers) >= tracking.MOVING))
    found = []
    for mover, start, end in tracking.passages(movers, ahead):
        own = select(movers, (movers['id'] == mover) & (movers['stamp'] >= start)
                     & (movers['stamp'] <= end))
        early, large = own['ttc'] >= BRAKES, own['n_macroblocks'] >= LARGE
        if early.all():
            continue
        due = max(own['stamp'][early].max(initial=start),
                  (own['stamp'][large].min() if large.any() else end) + tracking.PROMPT)
        last = own['stamp'][own['ttc'] >= LATEST].max(initial=start)
        found.append(Hazard(mover, start, int(due), int(max(last, min(due, end)))))
    return found


def braked_for(rows: Table, course: Course) -> np.ndarray:
    """Return which rows (N,) bool of obstacles are about to be met on the camera's way."""
    path, at = course.path, np.searchsorted(course.path.stamps, rows['stamp'])
    soon = (rows['ttc'] > 0) & (rows['ttc'] < BRAKES_FOR)
    if course.scale is None:
        return soon
    soon &= (at > 0) & (at < len(path))
    found = np.zeros(len(soon), bool)
    for i in np.flatnonzero(soon):
        k = at[i]
        own = 1e9 * (path.positions[k] - path.positions[k - 1]) / (
            path.stamps[k] - path.stamps[k - 1])
        position, velocity = (np.array([rows[f'{letter}{axis}'][i] for axis in 'xyz'])
                              for letter in 'pv')
        met = position - path.positions[k] + (velocity - own) * rows['ttc'][i]
        speed = float(np.hypot(own[0], own[2]))
        beside = abs(met[0] * own[2] - met[2] * own[0]) / max(speed, 1e-12)
        found[i] = (course.scale * speed >= SLOWEST
                    and course.scale * beside <= ASIDE + HALF_WIDTH)
    return found


def _first(hazard: Hazard, met: list[tracking.Match]) -> int | None:
    """Return when a hazard is met first [ns], None: not before it is too late."""
    return min((match.stamp for match in met if match.mover == hazard.mover
                and hazard.start <= match.stamp <= hazard.end), default=None)


def _contact(movers: Table, mover: int, stamp: int) -> float:
    """Return the time to contact [s] of a mover at a time [ns]."""
    own = select(movers, movers['id'] == mover)
    return float(own['ttc'][np.abs(own['stamp'] - stamp).argmin()])
