"""How well the labels show what moves, and how often an annotated box meets an obstacle.

A mover is *found* where at least half of its labelled points, or macroblocks, are called moving
in at least half of the key frames in which it has at least MIN_MACROBLOCKS (the first pair does
not count).
"""

from dataclasses import dataclass
from typing import Any

import cv2
from mv_slapse.evaluation.trajectory import associate
from mv_slapse.evaluation.truth import LabelTable, on_common_blocks
from mv_slapse.geometry.blocks import grid_shape, MACROBLOCK, macroblock_of
from mv_slapse.records import Label
import numpy as np

MIN_MACROBLOCKS = 6
SAME = 0.3  # smallest IoU of a box and the obstacle it stands for

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


def common_area(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return the area (N, M) that boxes (N, 4) and (M, 4) share."""
    low = np.maximum(a[:, None, :2], b[None, :, :2])
    high = np.minimum((a[:, :2] + a[:, 2:])[:, None], (b[:, :2] + b[:, 2:])[None])
    return np.prod(np.clip(high - low, 0, None), axis=2)


def iou(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return intersection over union (N, M) of boxes (N, 4) and (M, 4)."""
    common = common_area(a, b)
    union = a[:, 2:].prod(axis=1)[:, None] + b[:, 2:].prod(axis=1)[None] - common
    return common / np.maximum(union, 1e-12)


def confirmed(obstacles: Table) -> Table:
    """Return the rows of confirmed obstacles."""
    return select(obstacles, obstacles['state'] == 'confirmed')


def published(obstacles: Table) -> Table:
    """Return the rows of obstacles that planners use: confirmed, seen or coasting."""
    return select(obstacles, obstacles['state'] != 'tentative')


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
    rows = published(obstacles)
    frame_stamps = np.round(frames['frame'] / fps * 1e9).astype(np.int64)
    i, j = associate(stamps, frame_stamps)
    truth = boxes(frames)
    met = [_meets(boxes(select(rows, rows['stamp'] == stamps[k])), truth[[at]])
           for k, at in zip(i, j, strict=True)]
    return {'boxes_total': len(met), 'boxes_met': int(np.sum(met)),
            'boxes_met_percent': 100 * float(np.mean(met)) if met else None}


def point_boxes(points: PointLabels) -> Table:
    """Return the boxes around the visible points of each mover, as columns of a table."""
    rows = []
    for frame in range(points.tracks.shape[1]):
        for mover in np.unique(points.label[points.label > 1]):
            x = points.tracks[points.visible[:, frame] & (points.label == mover), frame]
            if len(x):
                rows.append([round(1e9 * frame / points.fps), mover, *x.min(axis=0),
                             *np.ptp(x, axis=0)])
    columns = np.array(rows, float).reshape(-1, 6).T
    names = ('stamp', 'id', 'x', 'y', 'width', 'height')
    return dict(zip(names, (columns[0].astype(np.int64), *columns[1:]), strict=True))


def hold_movers(rows: Table, points: PointLabels) -> np.ndarray:
    """Return which boxes (N,) bool hold more visible points of movers than of what stands.

    Points seldom cover all of a mover: the box around them may be a small part of it.
    """
    found = np.zeros(len(rows['stamp']), bool)
    frames = np.round(1e-9 * rows['stamp'] * points.fps).astype(int)
    low, size = np.split(boxes(rows), 2, axis=1)
    for i in np.flatnonzero((frames >= 0) & (frames < points.tracks.shape[1])):
        x, visible = points.tracks[:, frames[i]], points.visible[:, frames[i]]
        inside = visible & np.all((x >= low[i]) & (x <= low[i] + size[i]), axis=1)
        found[i] = np.sum(points.label[inside] > 1) > np.sum(points.label[inside] == 1)
    return found


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
            size = _area(points.tracks[on_it, frame]) / MACROBLOCK**2
            votes.setdefault(int(mover), []).append(
                (size, float(np.mean(called[on_it] == Label.MOVING))))
    return {**_found(votes), 'stationary_called_moving_percent':
            100 * stationary[0] / stationary[1] if stationary[1] else None}


def block_figures(labels: LabelTable, truth: LabelTable, movers: Table) -> dict[str, Any]:
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


def grid_index(x: np.ndarray, width: int, height: int) -> np.ndarray:
    """Return the number (N,) int of the macroblock that holds each pixel (N, 2), row by row.

    -1 outside the picture.
    """
    columns, rows = grid_shape(width, height)
    column, row = macroblock_of(x).T
    inside = (column >= 0) & (column < columns) & (row >= 0) & (row < rows)
    return np.where(inside, row * columns + column, -1)


def _labels_at(labels: LabelTable, k: int, x: np.ndarray) -> np.ndarray:
    """Return the label (N,) of the macroblock at each pixel (N, 2) in key frame k."""
    width, height = labels.x.max(initial=-1) + 1, labels.y.max(initial=-1) + 1
    at = grid_index(np.nan_to_num(x, nan=-1e6), int(width), int(height))
    return np.append(labels.label[k], int(Label.UNKNOWN))[at]


def _meets(found: np.ndarray, truth: np.ndarray) -> bool:
    return bool(len(found)) and bool(iou(found, truth).max() >= SAME)


def _area(x: np.ndarray) -> float:
    return float(cv2.contourArea(cv2.convexHull(x.astype(np.float32)))) if len(x) > 2 else 0.0
