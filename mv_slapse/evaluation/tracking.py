"""How soon and how well confirmed obstacles follow the movers of a rendered street.

A mover is *due* while it has at least MIN_MACROBLOCKS and moves. Each such *passage* must be met
by a confirmed obstacle within PROMPT of its beginning, under one id from then on. A car that
starts must become an obstacle, and one that stops must cease to be one, within RELABELLED.
"""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

from mv_slapse.evaluation.detection import (
    boxes,
    common_area,
    confirmed,
    iou,
    MIN_MACROBLOCKS,
    published,
    SAME,
    select,
    Table,
)
from mv_slapse.evaluation.trajectory import associate
from mv_slapse.geometry.blocks import MACROBLOCK
from mv_slapse.storage.tum import Trajectory
import numpy as np

PROMPT = 500_000_000  # [ns] from when a mover is due
RELABELLED = 1_000_000_000  # [ns] from when it starts or stops
FLICKER = 200_000_000  # [ns] for which a mover may be smaller and its passage go on
ON_MOVER = 0.3  # share of an obstacle's box that a mover's must cover, or it is false
MOVING = 0.3  # [m/s] slower is no mover
FAR_CONTACT = 20.0  # [s] later contacts are not compared

Covariances = Mapping[tuple[int, int], np.ndarray]


class Passage(NamedTuple):
    """An uninterrupted time [ns] for which something holds of a mover."""

    mover: int
    start: int
    end: int


class Match(NamedTuple):
    """A mover of a key frame and the confirmed obstacle that meets it: rows of their tables."""

    stamp: int
    mover: int
    obstacle_row: int
    mover_row: int


def figures(obstacles: Table, stamps: np.ndarray, movers: Table, path: Trajectory | None = None,
            scale: float = 1.0, covariances: Covariances | None = None) -> dict[str, Any]:
    """Return the figures of confirmed obstacles.

    Parameters
    ----------
    obstacles, movers : dict
        Columns of obstacles.csv and movers.csv.
    stamps : (F,) int
        Of all key frames [ns].
    path : Trajectory or None
        True poses, from which ranges are measured.
    scale : float
        Metres for a unit of the obstacles.
    covariances : dict or None
        (6, 6) of (position, velocity) [unit] by stamp and id.
    """
    rows = confirmed(obstacles)
    frames = key_frames(stamps, movers)
    matches = matched(rows, movers, frames)
    large = movers['n_macroblocks'] >= MIN_MACROBLOCKS
    due = passages(movers, large & (speed(movers) >= MOVING))
    return {**_tracked(due, matches, frames),
            'identity_switches': _switches(rows, due, matches), **_relabelled(movers, matches),
            **_errors(rows, movers, matches, path, scale),
            'obstacle_nees': _nees(rows, movers, matches, scale, covariances or {}),
            'false_obstacles_per_frame':
                float(np.sum(are_false(published(obstacles), movers, frames)))
                / max(len(stamps), 1)}


def passages(movers: Table, holds: np.ndarray) -> list[Passage]:
    """Return the times for which rows (N,) bool of a table of movers hold, mover by mover."""
    found = []
    for mover in np.unique(movers['id']).astype(int):
        times = np.sort(movers['stamp'][holds & (movers['id'] == mover)])
        for part in np.split(times, 1 + np.flatnonzero(np.diff(times) > FLICKER)):
            if len(part):
                found.append(Passage(mover, int(part[0]), int(part[-1])))
    return found


def speed(movers: Table) -> np.ndarray:
    """Return the speed (N,) of each row of a table of movers [m/s]."""
    return np.linalg.norm(_vectors(movers, 'v'), axis=1)


def key_frames(stamps: np.ndarray, movers: Table) -> dict[int, int]:
    """Return the true stamp of each key frame for which the truth has a mover."""
    true = np.unique(movers['stamp'])
    i, j = associate(stamps, true)
    return {int(stamps[a]): int(true[b]) for a, b in zip(i, j, strict=True)}


def matched(rows: Table, movers: Table, frames: dict[int, int]) -> list[Match]:
    """Return which obstacle meets each mover; one before another car is not that car, too."""
    found = []
    for stamp, true in frames.items():
        mine, there = (np.flatnonzero(table['stamp'] == at)
                       for table, at in ((rows, stamp), (movers, true)))
        if not len(mine):
            continue
        overlap = iou(boxes(select(rows, mine)), boxes(select(movers, there)))
        found += [Match(stamp, int(movers['id'][b]), int(mine[overlap[:, k].argmax()]), int(b))
                  for k, b in enumerate(there) if overlap[:, k].max() >= SAME
                  and overlap[overlap[:, k].argmax()].argmax() == k]
    return found


def met_in_time(due: Sequence[Passage], matches: Sequence[Match]) -> list[bool]:
    """Return of each passage that lasts PROMPT whether it is met within that of its beginning."""
    return [any(m.mover == mover and start <= m.stamp <= start + PROMPT for m in matches)
            for mover, start, end in due if end - start >= PROMPT]


def _tracked(due: list[Passage], matches: list[Match], frames: dict[int, int]) -> dict[str, Any]:
    """Return how many movers are tracked, and how many passages are met in time."""
    rows: dict[int, list[bool]] = {}
    for mover, start, end in due:
        if end - start < PROMPT:
            continue
        met = {m.stamp for m in matches if m.mover == mover and start <= m.stamp <= end}
        rows.setdefault(mover, []).extend(
            stamp in met for stamp in frames if start + PROMPT <= stamp <= end)
    hits = [np.mean(row) for row in rows.values() if row]
    prompt = met_in_time(due, matches)
    return {'movers_tracked': sum(hit >= 0.5 for hit in hits), 'movers_trackable': len(hits),
            'movers_confirmed_in_time': sum(prompt), 'movers_due': len(prompt)}


def _switches(rows: Table, due: list[Passage], matches: list[Match]) -> int:
    """Return how often the obstacle of a mover gets another id within a passage."""
    found = 0
    for mover, start, end in due:
        ids = [rows['id'][m.obstacle_row] for m in matches
               if m.mover == mover and start <= m.stamp <= end]
        found += int(np.sum(np.diff(ids) != 0))
    return found


def _relabelled(movers: Table, matches: list[Match]) -> dict[str, Any]:
    """Return how long visible movers that start or stop keep the other label."""
    large = movers['n_macroblocks'] >= MIN_MACROBLOCKS
    delays = []
    for mover, start, end in passages(movers, large):
        own = large & (movers['id'] == mover) & (movers['stamp'] >= start) & (
            movers['stamp'] <= end)
        moves, times = speed(movers)[own] >= MOVING, movers['stamp'][own]
        met = np.array([m.stamp for m in matches if m.mover == mover], float)
        for k in 1 + np.flatnonzero(np.diff(moves.astype(int))):
            if end - times[k] >= RELABELLED:
                delays.append(_delay(bool(moves[k]), times[k], end, met))
    return {'relabelled_in_time': sum(delay <= RELABELLED for delay in delays),
            'relabels': len(delays),
            'relabel_time_s': max(delays) * 1e-9 if delays else None}


def _delay(starts: bool, at: int, end: int, met: np.ndarray) -> float:
    """Return how long a mover lacks (starts), or keeps, an obstacle after a time [ns]."""
    later = met[(met >= at) & (met <= end)]
    if starts:
        return float(later.min() if len(later) else max(end, at + RELABELLED + 1)) - at
    return float(later.max() - at) if len(later) else 0.0


def _errors(rows: Table, movers: Table, matches: list[Match], path: Trajectory | None,
            scale: float) -> dict[str, Any]:
    """Return median errors of position, velocity and time to contact."""
    a, b = _rows(matches)
    position = np.linalg.norm(scale * _vectors(rows, 'p')[a] - _vectors(movers, 'p')[b], axis=1)
    velocity = np.linalg.norm(scale * _vectors(rows, 'v')[a] - _vectors(movers, 'v')[b], axis=1)
    true, found = movers['ttc'][b], rows['ttc'][a]
    near = (true > 0) & (true < FAR_CONTACT)  # one that is told as never is infinitely wrong
    contact = 100 * np.abs(found[near] - true[near]) / true[near]
    result = {'obstacle_position_error_m': _median(position),
              'obstacle_velocity_error_m_s': _median(velocity),
              'obstacle_ttc_error_percent': _median(contact)}
    if path is not None and len(path):
        eye = path.positions[np.clip(np.searchsorted(path.stamps, movers['stamp'][b] - 1), 0,
                                     len(path) - 1)]
        range_ = np.linalg.norm(_vectors(movers, 'p')[b] - eye, axis=1)
        result['obstacle_position_error_percent'] = _median(100 * position / range_)
    return result


def _nees(rows: Table, movers: Table, matches: list[Match], scale: float,
          covariances: Covariances) -> float | None:
    """Return the mean normalised squared error of position and velocity; 6 if all is right."""
    found = []
    for match in matches:
        a, b = match.obstacle_row, match.mover_row
        P = covariances.get((match.stamp, int(rows['id'][a])))
        if P is not None:
            error = np.r_[_vectors(rows, 'p')[a] - _vectors(movers, 'p')[b] / scale,
                          _vectors(rows, 'v')[a] - _vectors(movers, 'v')[b] / scale]
            found.append(float(error @ np.linalg.solve(P, error)))
    return float(np.mean(found)) if found else None


def are_false(rows: Table, movers: Table, frames: dict[int, int]) -> np.ndarray:
    """Return which rows (N,) bool of obstacles lie on no mover.

    One that coasts is none where the mover on which it was seen last is hidden, as it should be.
    """
    false = ~on_movers(rows, movers, frames)
    for i in np.flatnonzero(false & (rows['state'] == 'coasting')):
        seen = np.flatnonzero((rows['id'] == rows['id'][i]) & (rows['state'] == 'confirmed')
                              & (rows['stamp'] < rows['stamp'][i]))
        if len(seen):
            last = seen[rows['stamp'][seen].argmax()]
            there = select(movers, movers['stamp'] == frames.get(int(rows['stamp'][last]), -1))
            covered = _on(boxes(select(rows, [last])), there)[0]
            visible = movers['id'][movers['stamp'] == frames.get(int(rows['stamp'][i]), -1)]
            own = covered.argmax() if covered.max(initial=0) >= ON_MOVER else None
            false[i] = own is None or there['id'][own] in visible
    return false


def on_movers(rows: Table, movers: Table, frames: dict[int, int]) -> np.ndarray:
    """Return which rows (N,) bool of obstacles lie on a mover, seen to a macroblock.

    Where none is visible the truth has no row at all.
    """
    found = np.zeros(len(rows['stamp']), bool)
    for stamp in np.unique(rows['stamp']):
        mine = rows['stamp'] == stamp
        there = select(movers, movers['stamp'] == frames.get(int(stamp), -1))
        found[mine] = _on(boxes(select(rows, mine)), there).max(axis=1, initial=0) >= ON_MOVER
    return found


def _on(parts: np.ndarray, there: Table) -> np.ndarray:
    """Return the share (N, M) of boxes (N, 4) that lies on each of some movers."""
    return _covered(parts, boxes(there) + MACROBLOCK * np.array([-0.5, -0.5, 1.0, 1.0]))


def _covered(parts: np.ndarray, wholes: np.ndarray) -> np.ndarray:
    """Return the share (N, M) of boxes (N, 4) that lies in each of others (M, 4)."""
    return common_area(parts, wholes) / np.maximum(parts[:, 2:].prod(axis=1), 1e-12)[:, None]


def _rows(matches: list[Match]) -> tuple[np.ndarray, np.ndarray]:
    return (np.array([m.obstacle_row for m in matches], int),
            np.array([m.mover_row for m in matches], int))


def _vectors(table: Table, letter: str) -> np.ndarray:
    return np.c_[table[f'{letter}x'], table[f'{letter}y'], table[f'{letter}z']]


def _median(values: np.ndarray) -> float | None:
    return float(np.median(values)) if len(values) else None
