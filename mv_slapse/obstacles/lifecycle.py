"""Plane management of [MVO] 5: what confirms an obstacle, and which planes change their label.

Pure functions of the evidence; the filters act on what they return.
"""

from collections.abc import Sequence
import math
from typing import NamedTuple

from mv_slapse.config import ExtractionSettings, ObstacleSettings
from mv_slapse.filters import ekf

STILL_SHARE = 0.6  # of an obstacle's blocks that the labels call stationary


class Rules(NamedTuple):
    """Constants of the log-likelihood that successive detections are one body, no wrong vectors.

    As measured (496 detections of both kinds): normalised innovation / dof in the median 0.2
    (rendered) and 0.7 (real) against 2.3, overlap with the predicted box 0.76 against 0.43.
    """

    nis_gain: float = 1.1  # of the log of the normalised innovation / dof
    even_nis: float = 0.95  # at which it tells nothing,
    least_nis: float = 0.1  # and between which it tells more and more
    most_nis: float = 6.0
    overlap_gain: float = 9.0
    even_overlap: float = 0.78
    least_overlap: float = 0.5
    believed: float = 0.6  # at which a body is: 1.8 to 1; with less more false ones are confirmed
    even_score: float = ExtractionSettings.moving_score  # chi-square: labels call it moving
    # Beyond it for a unit: wrong vectors do not last, of 37 regions in kitti00, parking and
    # crossings the highest but one came to 26, which tells half of what is believed.
    per_score: float = 20.0
    independent: float = 0.1  # [s] after which an outline of wrong vectors is another one


RULES = Rules()


class Evidence(NamedTuple):
    """What one key frame pair says of a track."""

    start: int  # of the pair [ns]
    stamp: int  # and its end [ns]
    statistic: float  # of "it stands still" after the update, chi2 of 3 where that is so
    nis: float  # squared Mahalanobis distance of the innovation
    dof: int  # and its dimension; 0, 0 at the start
    speed: float  # [map unit/s]
    overlap: float = 1.0  # intersection over union of the detection's box and the predicted one
    score: float = 0.0  # of its region, that it moves, chi-square over pairs; 0: not known
    called: bool = True  # moving by the labels


def confirms(evidence: Sequence[Evidence], is_metric: bool, settings: ObstacleSettings,
             alone: bool = True) -> bool:
    """Return whether a track's evidence makes it an obstacle that a planner may brake for.

    Detections of one body that moves, in enough pairs over enough time; the labels must call the
    newest moving. A region's score tells once: that it moves, where the velocity after all
    detections does not differ from zero yet, as of a leader whose speed hangs on one row of
    blocks; else that it lasts, as a body's does, where the track is ``alone``: no other
    obstacle's outline meets its own.
    """
    recent = within(evidence, settings.confirm_window)
    if len(recent) < settings.confirm_pairs or not recent[-1].called:
        return False
    newest, slowest = recent[-1], settings.min_speed if is_metric else 0.0
    bound = ekf.chi2_bound(settings.moving_confidence, 3)
    moves, lasts = newest.statistic + newest.score > bound, newest.statistic > bound and alone
    lasted = 1e-9 * (newest.stamp - recent[0].start)
    first_only = len(evidence) == 1  # which only the settings can let suffice
    # A vehicle whose outline jumps, as where another one hides a part of it, moves all the same.
    lasting = max(newest.score - RULES.even_score, 0.0) / RULES.per_score
    body = one_body(evidence) + lasts * lasting
    return (moves and newest.speed >= slowest and lasted >= settings.confirm_time - 1e-6
            and (first_only or body >= RULES.believed))


def one_body(evidence: Sequence[Evidence]) -> float:
    """Return the log-likelihood ratio that a track's detections are one body, from 0 up.

    A body goes where its vectors say and keeps its outline; wrong vectors do neither. What spoke
    against it before it began to hold is forgotten (a sequential test, as Page's).
    """
    total = 0.0
    for e in evidence:
        if e.dof:
            weight = min(1e-9 * (e.stamp - e.start) / RULES.independent, 1.0)
            nis = min(max(e.nis / e.dof, RULES.least_nis), RULES.most_nis)
            outline = max(e.overlap, RULES.least_overlap) - RULES.even_overlap
            favour = RULES.nis_gain * math.log(RULES.even_nis / nis) + RULES.overlap_gain * outline
            total = max(total + weight * favour, 0.0)
    return total


def stands_still(evidence: Sequence[Evidence], unit: float, settings: ObstacleSettings) -> bool:
    """Return whether an obstacle's velocity has been statistically zero for long enough.

    Small speed is asked for as well, since a velocity of which nothing is known is statistically
    zero, too. ``unit`` is what to take for 1 m/s [map unit/s].
    """
    if not evidence:
        return False
    recent = within(evidence, settings.still_time)
    lasted = 1e-9 * (recent[-1].stamp - recent[0].start)
    level = ekf.chi2_bound(ekf.CONFIDENCE, 3)
    return lasted >= settings.still_time - 1e-6 and all(
        e.statistic < level and e.speed < settings.still_speed * unit for e in recent)


def melts_into_scene(speed: float, sigma: float, still_share: float, unit: float,
                     settings: ObstacleSettings) -> bool:
    """Return whether an obstacle without detection has stopped rather than vanished.

    By its speed and the standard deviation of that [map unit/s], the share of the labelled blocks
    where it should be that are labelled stationary, and what to take for 1 m/s [map unit/s].
    """
    return still_share >= STILL_SHARE and speed - 2 * sigma < settings.still_speed * unit


def within(evidence: Sequence[Evidence], seconds: float) -> list[Evidence]:
    """Return the evidence whose pair ended in the last seconds before the newest."""
    return [e for e in evidence if 1e-9 * (evidence[-1].stamp - e.stamp) <= seconds]
