"""Plane management of [MVO] 5: what confirms an obstacle, and which planes change their label.

Pure functions of the evidence; the filters act on what they return.
"""

from collections.abc import Sequence
from typing import NamedTuple

from mv_slapse.config import ObstacleSettings
from mv_slapse.filters import ekf

STILL_CONFIDENCE = 0.99  # "it stands still" is given up beyond this
# Mean normalised innovation above which evidence contradicts itself: of cars on rendered streets
# 93 % are below when they are confirmed, of regions of wrong vectors half are above.
CONSISTENT_NIS = 1.5
STILL_SHARE = 0.6  # of an obstacle's blocks that the labels call stationary


class Evidence(NamedTuple):
    """What one key frame pair says of a track.

    Attributes
    ----------
    start, stamp : int, int
        Of the pair [ns].
    statistic : float
        Of "it stands still" after the update, chi2 of 3 where that is so.
    nis, dof : float, int
        Squared Mahalanobis distance of the innovation and its dimension; 0, 0 at the start.
    speed : float
        [map unit/s].
    """

    start: int
    stamp: int
    statistic: float
    nis: float
    dof: int
    speed: float


def confirms(evidence: Sequence[Evidence], is_metric: bool, settings: ObstacleSettings) -> bool:
    """Return whether a track's evidence makes it an obstacle that a planner may brake for.

    Enough pairs, over enough time, in which the velocity differs from zero, the newest among
    them, and detections that move as their vectors say: the outline of wrong vectors stays.
    """
    recent = within(evidence, settings.confirm_window)
    level = ekf.chi2_bound(settings.moving_confidence, 3)
    slowest = settings.min_speed if is_metric else 0.0
    moving = [e for e in recent if e.statistic > level and e.speed >= slowest]
    if len(moving) < settings.confirm_pairs or moving[-1] is not recent[-1]:
        return False
    lasted = 1e-9 * (moving[-1].stamp - moving[0].start)
    dof = sum(e.dof for e in recent)
    return (lasted >= settings.confirm_time - 1e-6
            and sum(e.nis for e in recent) <= CONSISTENT_NIS * max(dof, 1))


def stands_still(evidence: Sequence[Evidence], unit: float, settings: ObstacleSettings) -> bool:
    """Return whether an obstacle's velocity has been statistically zero for long enough.

    Small speed is asked for as well, since a velocity of which nothing is known is statistically
    zero, too. ``unit`` is what to take for 1 m/s [map unit/s].
    """
    if not evidence:
        return False
    recent = within(evidence, settings.still_time)
    lasted = 1e-9 * (recent[-1].stamp - recent[0].start)
    level = ekf.chi2_bound(STILL_CONFIDENCE, 3)
    return lasted >= settings.still_time - 1e-6 and all(
        e.statistic < level and e.speed < settings.still_speed * unit for e in recent)


def melts_into_scene(speed: float, sigma: float, still_share: float, unit: float,
                     settings: ObstacleSettings) -> bool:
    """Return whether an obstacle without detection has stopped rather than vanished.

    Parameters
    ----------
    speed, sigma : float, float
        Of the track and its standard deviation [map unit/s].
    still_share : float
        Share of the labelled blocks where it should be that are labelled stationary.
    unit : float
        What to take for 1 m/s [map unit/s].
    settings : ObstacleSettings
    """
    return still_share >= STILL_SHARE and speed - 2 * sigma < settings.still_speed * unit


def within(evidence: Sequence[Evidence], seconds: float) -> list[Evidence]:
    """Return the evidence whose pair ended in the last seconds before the newest."""
    if not evidence:
        return []
    return [e for e in evidence if 1e-9 * (evidence[-1].stamp - e.stamp) <= seconds]
