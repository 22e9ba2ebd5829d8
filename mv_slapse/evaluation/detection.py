"""How well moving obstacles are found, and how often none is there.

A mover is *found* where at least half of its labelled points, or macroblocks, are called moving
in at least half of the key frames in which it has at least MIN_MACROBLOCKS (the first pair does
not count); it is *tracked* where a confirmed obstacle meets its box in at least half of those that
come SETTLING after it became so large. A confirmed obstacle that meets no mover's box is false.
"""

from dataclasses import dataclass
from typing import Any

import cv2
from mv_slapse.evaluation.trajectory import associate
from mv_slapse.evaluation.truth import LabelTable, on_common_blocks
from mv_slapse.records import Label
import numpy as np

MIN_MACROBLOCKS = 6
SETTLING = 500_000_000  # [ns] time to confirm a mover
SAME = 0.3  # smallest IoU of a box and the obstacle it stands for
TOUCHING = 0.05  # an obstacle that meets every mover with less is false
MOVING = 0.3  # [m/s] slower is no mover
FAR_CONTACT = 20.0  # [s] later contacts are not compared
SIZE = 16

Table = dict[str, np.ndarray]


@dataclass(frozen=True)
class PointLabels:
    """Labelled points of a clip.

    Attributes
    ----------
    tracks : (N, F, 2) [px]
    visible : (N, F) bool
    label : (N,) int
        1 stationary, from 2 on a number for each mover.
    fps : float
        [1/s]; the first frame has stamp 0.
    """

    tracks: np.ndarray
    visible: np.ndarray
    label: np.ndarray
    fps: float


def boxes(table: Table) -> np.ndarray:
    """Return the boxes (N, 4) x, y, width, height of a table [px]."""
    return np.c_[table['x'], table['y'], table['width'], table['height']]


def iou(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return intersection over union (N, M) of boxes (N, 4) and (M, 4)."""
    low = np.maximum(a[:, None, :2], b[None, :, :2])
    high = np.minimum((a[:, :2] + a[:, 2:])[:, None], (b[:, :2] + b[:, 2:])[None])
    common = np.prod(np.clip(high - low, 0, None), axis=2)
    union = a[:, 2:].prod(axis=1)[:, None] + b[:, 2:].prod(axis=1)[None] - common
    return common / np.maximum(union, 1e-12)


def confirmed(obstacles: Table) -> Table:
    """Return the rows of confirmed obstacles."""
    return select(obstacles, obstacles['state'] == 'confirmed')


def select(table: Table, mask: np.ndarray) -> Table:
    """Return some rows of a table."""
    return {name: values[mask] for name, values in table.items()}


def obstacle_figures(obstacles: Table, n_key_frames: int) -> dict[str, Any]:
    """Return how many obstacles were confirmed, whatever the truth is."""
    rows = confirmed(obstacles)
    return {'obstacles_confirmed': len(np.unique(rows['id'])),
            'confirmed_obstacles_per_frame': len(rows['id']) / max(n_key_frames, 1)}


def box_figures(obstacles: Table, stamps: np.ndarray, frames: Table, fps: float
                ) -> dict[str, Any]:
    """Return in how many key frames an annotated box meets an obstacle (``boxes.csv``)."""
    rows = select(obstacles, obstacles['state'] != 'tentative')
    frame_stamps = np.round(frames['frame'] / fps * 1e9).astype(np.int64)
    i, j = associate(stamps, frame_stamps)
    truth = boxes(frames)
    met = [_meets(boxes(select(rows, rows['stamp'] == stamps[k])), truth[[at]])
           for k, at in zip(i, j, strict=True)]
    return {'boxes_total': len(met), 'boxes_met': int(np.sum(met)),
            'boxes_met_percent': 100 * float(np.mean(met)) if met else None}


def point_figures(labels: LabelTable, points: PointLabels) -> dict[str, Any]:
    """Return the figures of labelled points (``motion_labels.npz``)."""
    frame_stamps = np.round(np.arange(points.tracks.shape[1]) / points.fps * 1e9)
    i, j = associate(labels.stamps, frame_stamps.astype(np.int64))
    votes: dict[int, list[tuple[float, float]]] = {}
    stationary = np.zeros(2, int)
    for k, frame in zip(i[1:], j[1:], strict=True):
        seen = points.visible[:, frame]
        called = _labels_at(labels, k, points.tracks[:, frame])
        still = called[seen & (points.label == 1)]
        stationary += np.sum(still == Label.MOVING), np.sum(still != Label.UNKNOWN)
        for mover in np.unique(points.label[seen & (points.label > 1)]):
            on_it = seen & (points.label == mover)
            size = _area(points.tracks[on_it, frame]) / SIZE**2
            votes.setdefault(int(mover), []).append(
                (size, float(np.mean(called[on_it] == Label.MOVING))))
    return {**_found(votes), 'stationary_called_moving_percent':
            100 * stationary[0] / stationary[1] if stationary[1] else None}


def truth_figures(obstacles: Table, labels: LabelTable, movers: Table,
                  truth: LabelTable | None, scale: float) -> dict[str, Any]:
    """Return the figures against a rendered street's truth; ``scale`` is m per unit."""
    true_stamps = np.unique(movers['stamp'])
    i, j = associate(labels.stamps, true_stamps)
    matches = [_match(select(obstacles, obstacles['stamp'] == labels.stamps[k]),
                      select(movers, movers['stamp'] == true_stamps[at]))
               for k, at in zip(i, j, strict=True)]
    # where no mover is visible the truth has no row, and whatever is confirmed is false
    alone = ~np.isin(confirmed(obstacles)['stamp'], labels.stamps[i])
    n_false = sum(match.n_false for match in matches) + int(alone.sum())
    result = {**_tracked(matches), **_errors(matches, scale),
              'false_obstacles_per_frame': n_false / max(len(labels.stamps), 1)}
    if truth is not None:
        result |= _block_figures(labels, truth, movers)
    return result


@dataclass(frozen=True)
class _Match:
    """Confirmed obstacles and movers of a key frame: pairs of rows, and obstacles left over."""

    stamp: int
    obstacles: Table
    movers: Table
    pairs: list[tuple[int, int]]
    n_false: int


def _match(obstacles: Table, movers: Table) -> _Match:
    rows = confirmed(obstacles)
    overlap = iou(boxes(rows), boxes(movers))
    pairs = [(int(a), int(b)) for b in range(overlap.shape[1]) if len(overlap)
             for a in [overlap[:, b].argmax()] if overlap[a, b] >= SAME]
    n_false = int(np.sum(overlap.max(axis=1, initial=0) < TOUCHING))
    return _Match(int(movers['stamp'][0]), rows, movers, pairs, n_false)


def _tracked(matches: list[_Match]) -> dict[str, Any]:
    hits: dict[int, list[bool]] = {}
    first: dict[int, int] = {}
    names: dict[int, list[float]] = {}
    for match in matches:
        of_mover = {b: a for a, b in match.pairs}
        for b, id_ in enumerate(match.movers['id'].astype(int)):
            speed = np.linalg.norm([match.movers[name][b] for name in ('vx', 'vy', 'vz')])
            if match.movers['n_macroblocks'][b] < MIN_MACROBLOCKS or speed < MOVING:
                first.pop(id_, None)
                continue
            if match.stamp - first.setdefault(id_, match.stamp) >= SETTLING:
                hits.setdefault(id_, []).append(b in of_mover)
            if b in of_mover:
                names.setdefault(id_, []).append(match.obstacles['id'][of_mover[b]])
    switches = sum(int(np.sum(np.diff(ids) != 0)) for ids in names.values())
    return {'movers_tracked': sum(np.mean(hit) >= 0.5 for hit in hits.values()),
            'movers_trackable': len(hits), 'identity_switches': switches}


def _errors(matches: list[_Match], scale: float) -> dict[str, Any]:
    rows = [_pair_errors(match, a, b, scale) for match in matches for a, b in match.pairs]
    columns = np.array(rows, float).reshape(-1, 3).T
    names = ('obstacle_position_error_m', 'obstacle_velocity_error_m_s',
             'obstacle_ttc_error_percent')
    return {name: float(np.nanmedian(values)) if np.isfinite(values).any() else None
            for name, values in zip(names, columns, strict=True)}


def _pair_errors(match: _Match, a: int, b: int, scale: float) -> tuple[float, float, float]:
    def vector(table: Table, names: str, row: int) -> np.ndarray:
        return np.array([table[name][row] for name in names.split()])

    o, m = match.obstacles, match.movers
    position = scale * vector(o, 'px py pz', a) - vector(m, 'px py pz', b)
    velocity = scale * vector(o, 'vx vy vz', a) - vector(m, 'vx vy vz', b)
    true_ttc, ttc = m['ttc'][b], o['ttc'][a]
    near = np.isfinite(ttc) and 0 < true_ttc < FAR_CONTACT
    return (float(np.linalg.norm(position)), float(np.linalg.norm(velocity)),
            100 * abs(ttc - true_ttc) / true_ttc if near else np.nan)


def _block_figures(labels: LabelTable, truth: LabelTable, movers: Table) -> dict[str, Any]:
    """Return movers found by their macroblocks, and how often labels are confused."""
    labels, truth = on_common_blocks(labels, truth)
    i, j = associate(labels.stamps, truth.stamps)
    votes: dict[int, list[tuple[float, float]]] = {}
    for k, frame in zip(i[1:], j[1:], strict=True):
        for mover in np.unique(movers['id']).astype(int):
            on_it = (truth.plane[frame] == mover) & (truth.label[frame] == Label.MOVING)
            if on_it.any():
                votes.setdefault(mover, []).append(
                    (float(on_it.sum()), float(np.mean(labels.label[k][on_it] == Label.MOVING))))
    called, true = labels.label[i[1:]], truth.label[j[1:]]
    table = [[int(np.sum((true == t) & (called == c))) for c in (-1, 0, 1, 2)] for t in (0, 1, 2)]
    known = sum(table[0][1:])
    return {**_found(votes), 'label_confusion': table, 'stationary_called_moving_percent':
            100 * table[0][2] / known if known else None}


def _found(votes: dict[int, list[tuple[float, float]]]) -> dict[str, Any]:
    """Apply the rule of the module's head to (macroblocks, share called moving) of each mover."""
    large = {mover: [share for size, share in rows if size >= MIN_MACROBLOCKS]
             for mover, rows in votes.items()}
    large = {mover: shares for mover, shares in large.items() if shares}
    found = [mover for mover, shares in large.items()
             if np.mean(np.array(shares) >= 0.5) >= 0.5]
    return {'movers_found': len(found), 'movers_total': len(large),
            'movers_missed': sorted(int(mover) for mover in set(large) - set(found))}


def _labels_at(labels: LabelTable, k: int, x: np.ndarray) -> np.ndarray:
    """Return the label (N,) of the macroblock at each pixel (N, 2) in key frame k."""
    columns = int(labels.x.max() // SIZE) + 1 if len(labels.x) else 0
    grid = labels.label[k].reshape(-1, max(columns, 1))
    column, row = np.floor((np.nan_to_num(x, nan=-1e6) + 0.5) / SIZE).astype(int).T
    inside = (column >= 0) & (column < grid.shape[1]) & (row >= 0) & (row < grid.shape[0])
    result = np.full(len(x), int(Label.UNKNOWN))
    result[inside] = grid[row[inside], column[inside]]
    return result


def _meets(found: np.ndarray, truth: np.ndarray) -> bool:
    return bool(len(found)) and bool(iou(found, truth).max() >= SAME)


def _area(x: np.ndarray) -> float:
    return float(cv2.contourArea(cv2.convexHull(x.astype(np.float32)))) if len(x) > 2 else 0.0
