"""Which detection continues which track: overlap of macroblocks and Mahalanobis distance."""

from collections.abc import Callable, Mapping, Sequence
from functools import cache
from math import copysign
from typing import NamedTuple

from mv_slapse.filters import ekf
from mv_slapse.geometry.blocks import MACROBLOCK
from mv_slapse.kernels.binding import compiled
from mv_slapse.obstacles import motion_model as om
from mv_slapse.obstacles.detection import Detection, MOST
import numpy as np

DEPTH_RATIO = (0.6, 1.6)  # between two surfaces of one vehicle,
SIMILAR_RATIO = (0.8, 1.25)  # if their lower edges tell otherwise: one need not be a foot
GAP_SHARE = 0.25  # of a vehicle's smaller side that may have no vectors between two of its parts
MARGIN = 0.5  # share of an obstacle's size by which more of it may come into view


class Costs(NamedTuple):
    """Constants of what it costs that a detection continues a track, beside squared distance."""

    forbidden: float = 1e6
    apart: float = 10.0  # of no overlap at all
    least_overlap: float = 0.1  # that counts
    other_id: float = 2.0
    rescue: float = 4.0  # gates that one which overlaps well may be off, and then counts less
    rescue_same_id: float = 16.0  # the same, if the extractor calls it the same region


COST = Costs()


def overlap(x: np.ndarray, other: np.ndarray) -> float:
    """Return the share of the smaller region's lattice cells that both regions hold.

    ``x`` (N, 2) and ``other`` (M, 2) are block centres [px].
    """
    return compiled.shared_cells(x, other, MACROBLOCK)


def box_overlap(a: np.ndarray, b: np.ndarray) -> float:
    """Return intersection over union of two boxes (4,) as of Detection.box, known to a block.

    Edges that differ by half a block or less are the same.
    """
    one, other = _edges(a), _edges(b)
    other = [e + copysign(max(abs(f - e) - MACROBLOCK / 2, 0.0), f - e)
             for e, f in zip(one, other, strict=True)]
    common = [*map(max, one[:2], other[:2]), *map(min, one[2:], other[2:])]
    area, also, shared = ((max(right - left, 0.0) * max(bottom - top, 0.0))
                          for left, top, right, bottom in (one, other, common))
    return shared / max(area + also - shared, 1e-9)


def _edges(box):
    """Return left, top, right and bottom of a box (4,): plain numbers, which cost less."""
    x, y, width, height = box.tolist()
    return x, y, x + width, y + height


@cache
def observed(has_depth: bool, has_rate: bool, most: int = om.SIZE) -> np.ndarray:
    """Return the elements (M,) int of the state, below ``most``, of which there is evidence."""
    return np.array([row for row in range(most) if (has_depth or row != om.LOG_DEPTH.start)
                     and (has_rate or not om.RATE.start <= row < om.RATE.stop)])


def squared_distance(mu, P, detection: Detection) -> tuple[float, int]:
    """Return the squared Mahalanobis distance of a detection to a state and its dimension.

    The slope is left out: another face of the same vehicle is still the vehicle.
    """
    rows = observed(detection.has_depth, detection.has_rate, om.SLOPE.start)
    return compiled.element_distance(mu, P, detection.z, detection.R, rows), len(rows)


def associate(tracks: Sequence, detections: Sequence[Detection],
              gate: float) -> list[tuple[int, int]]:
    """Return pairs (track, detection) of the cheapest assignment in which none is forbidden.

    Tracks are predicted, with ``mu``, ``P``, ``x`` (predicted block centres) and ``plane_id``;
    ``gate`` is the share of right detections inside the gate.
    """
    if not tracks or not detections:
        return []
    cost = np.array([[_cost(track, detection, gate) for detection in detections]
                     for track in tracks])
    columns = compiled.cheapest_assignment(cost).tolist()
    return [(i, j) for i, j in enumerate(columns) if j >= 0 and cost[i, j] < COST.forbidden]


def _cost(track, detection, gate):
    shared = overlap(track.x, detection.x)
    if shared < COST.least_overlap:
        return COST.forbidden
    distance, dof = squared_distance(track.mu, track.P, detection)
    same_id = detection.called and track.plane_id == detection.id
    rescue = COST.rescue_same_id if same_id else COST.rescue
    if distance > ekf.chi2_bound(gate, dof) * (rescue if shared > MOST else 1.0):
        return COST.forbidden
    return distance + COST.apart * (1 - shared) + COST.other_id * (not same_id)


def groups(detections: Sequence[Detection], gate: float,
           expected: Mapping[int, np.ndarray] | None = None,
           may_be_one: Callable[[list[Detection]], bool] = bool) -> list[list[Detection]]:
    """Return the surfaces of each vehicle, the largest one first.

    Detections come largest first; each joins the first one before it that it touches and whose
    motion it shares, if the group ``may_be_one`` vehicle then. ``expected`` holds, by the region's
    id, the boxes (4,) where obstacles should be: in one pair any two cars may move alike within
    the noise, so that what an obstacle was not before does not join it, be it another obstacle or
    new.
    """
    expected, found = expected or {}, []
    for detection in detections:
        home = next((g for g in found if any(same_body(d, detection, gate) for d in g)
                     and _as_expected((*g, detection), expected)
                     and may_be_one([*g, detection])), None)
        if home is None:
            found.append([detection])
        else:
            home.append(detection)
    return found


def _as_expected(group, expected):
    """Whether a group holds the region of one obstacle at most, and else lies in its place."""
    places = [expected[d.id] for d in group if d.id in expected]
    if len(places) != 1:
        return not places
    x, y, width, height = places[0]
    room = np.array([x - MARGIN * width, y - MARGIN * height, width + 2 * MARGIN * width,
                     height + 2 * MARGIN * height])
    return all(covers(room, d.box) for d in group if d.id not in expected)


def covers(box: np.ndarray, part: np.ndarray) -> bool:
    """Return whether a box (4,) holds most of another one."""
    left, top, right, bottom = _edges(box)
    first, highest, last, lowest = _edges(part)
    held = (max(min(right, last) - max(left, first), 0.0)
            * max(min(bottom, lowest) - max(top, highest), 0.0))
    return held > MOST * (last - first) * (lowest - highest)


def same_body(one: Detection, other: Detection, gate: float) -> bool:
    """Return whether two surfaces touch and move as one body at about one depth."""
    if not _touch(one.box, other.box):
        return False
    ratios = DEPTH_RATIO if _share_depth(one, other) else SIMILAR_RATIO
    return _share_motion((one.z, one.R), (other.z, other.R), ratios, gate)


def is_part(whole: tuple[np.ndarray, np.ndarray], whole_box: np.ndarray,
            part: tuple[np.ndarray, np.ndarray], part_box: np.ndarray, gate: float) -> bool:
    """Return whether what lies inside a vehicle's box, for the most, moves as the vehicle does.

    ``whole`` and ``part`` are states (8,) with their covariances (8, 8).
    """
    return covers(whole_box, part_box) and _share_motion(whole, part, SIMILAR_RATIO, gate)


def _touch(a, b):
    """Whether two boxes lie at most a block, or a share of the larger one, apart."""
    (left, top, right, bottom), (first, highest, last, lowest) = _edges(a), _edges(b)
    gap = max(MACROBLOCK, GAP_SHARE * max(min(right - left, bottom - top),
                                          min(last - first, lowest - highest)))
    return (max(left, first) - min(right, last) <= gap
            and max(top, highest) - min(bottom, lowest) <= gap)


def _share_depth(one, other):
    """Whether depths agree; what lies above another surface has no contact of its own."""
    (left, _, right, _), (first, _, last, _) = _edges(one.box), _edges(other.box)
    if (min(right, last) - max(left, first) > MOST * min(right - left, last - first)
            or not (one.has_depth and other.has_depth)):
        return True
    sigma = np.sqrt(one.R[2, 2] + other.R[2, 2])
    return abs(one.z[2] - other.z[2]) < 2 * sigma + 0.1


def _share_motion(one, other, ratios, gate):
    """Whether one velocity explains both rates, at depths of a ratio that one body allows."""
    (a, A), (b, B) = ((mean[om.RATE], cov[om.RATE, om.RATE]) for mean, cov in (one, other))
    ratio = min(max(a @ b / max(b @ b, 1e-12), ratios[0]), ratios[1])
    return ekf.squared_distance(a - ratio * b, A + ratio**2 * B) < ekf.chi2_bound(gate, 3)
