"""Merging and the motion prior in numpy: the formulas that the kernels are compared with."""

from math import sqrt
from typing import NamedTuple

import cv2
from mv_slapse.codec.evidence import Evidence
from mv_slapse.codec.prior import at
from mv_slapse.config import DecoderSettings
from mv_slapse.geometry.blocks import MACROBLOCK, macroblock_of
from mv_slapse.records import Correspondences
import numpy as np

DEPTH = 8  # pieces of evidence looked at for each macroblock
TYPICAL_VOTES = np.float32(5)  # at which a vector is as good as the stream's sigma says
STANDING = 0.5  # share of vectors that are not zero below which the camera may be standing
SLOW = 2.0  # px, median motion below which a far point may have none
ABSENT = 1e6  # px, a vector that agrees with none
AROUND = [(row, column) for row in (-1, 0, 1) for column in (-1, 0, 1) if row or column]
FORGET = 0.5  # share of the older field that stays where there is a newer one
SAMPLE = 600  # vectors that are enough to find the shift
TRIM = (64.0, 24.0, 12.0, 12.0)  # px, about the shift
SPREAD = (3, 7, 15, 31)  # macroblocks, windows that fill holes, the finest that has a value first


def merge(evidence: Evidence, width: int, height: int, settings: DecoderSettings, field):
    """Return place, vector, variance as in consensus, and which have too little support."""
    shape = (-(-height // MACROBLOCK) + 2, -(-width // MACROBLOCK) + 2)
    slots = _slots(evidence, shape, settings)
    clusters = [_cluster(slots, settings)]
    rest = slots._replace(weight=np.where(clusters[0].member, 0, slots.weight))
    clusters.append(_cluster(rest, settings))
    votes = np.stack(_votes([cluster.vector.reshape(*shape, 2) for cluster in clusters],
                            [cluster.mass.reshape(shape) > 0 for cluster in clusters],
                            _skips(evidence.vector), settings))
    votes = votes.reshape(2, -1) + [np.minimum(cluster.company, 1) for cluster in clusters]
    support = votes + [_expectation(cluster.vector, field, shape, settings)
                       for cluster in clusters]
    best = support.argmax(axis=0)
    moved = np.take_along_axis(np.stack([np.any(cluster.vector != 0, axis=1) & (cluster.mass > 0)
                                         for cluster in clusters]), best[None], axis=0)[0]
    supported = np.maximum(*support) >= settings.min_support
    cell = np.flatnonzero(supported | moved)
    best = best[cell]
    x, vector, variance, company = (
        np.stack([getattr(cluster, name) for cluster in clusters])[best, cell]
        for name in ('x', 'vector', 'variance', 'company'))
    return x, vector, variance * _doubt(votes[best, cell], company), ~supported[cell]


def _expectation(vector: np.ndarray, field: np.ndarray | None, shape: tuple[int, int],
                 settings: DecoderSettings) -> np.ndarray:
    """Return how much the pairs before speak for the vector of each cell, in votes."""
    if field is None:
        return np.zeros(len(vector), np.float32)
    expected = np.full((*shape, 2), -ABSENT, np.float32)
    expected[1:-1, 1:-1] = field
    expected = expected.reshape(-1, 2)
    limit = settings.prior_slack + settings.prior_tolerance * np.hypot(*expected.T)
    near = 1 - _square_gap(vector, expected) / limit ** 2
    return np.float32(settings.prior_votes) * np.maximum(near, 0)


def _doubt(votes: np.ndarray, company: np.ndarray) -> np.ndarray:
    """Return how much more (or less) a vector scatters than Lemma 2 says of a right one.

    Lemma 2 takes the used vectors for right and their errors for independent. Measured against
    true epipolar lines (KITTI and a rendered garage, MPEG-2 and H.264), the standard deviation
    halves for each three macroblocks around that agree, and falls with the fourth root of the
    pieces of evidence that agree inside the macroblock, beyond what averaging explains.
    """
    return 4 ** ((TYPICAL_VOTES - votes) / 3) / np.sqrt(1 + company)


class _Slots(NamedTuple):
    """Evidence by macroblock: (cells, depth) each, weight 0 where there is none."""

    x: np.ndarray
    vector: np.ndarray
    weight: np.ndarray
    variance: np.ndarray


class _Cluster(NamedTuple):
    """Weighted mean of the evidence of each cell that agrees with its heaviest piece."""

    x: np.ndarray
    vector: np.ndarray
    variance: np.ndarray
    mass: np.ndarray
    company: np.ndarray
    member: np.ndarray


def _slots(evidence: Evidence, shape: tuple[int, int], settings: DecoderSettings) -> _Slots:
    cell = _cells(evidence.x_cur, shape)
    order = np.argsort(cell, kind='stable')
    cell = cell[order]
    rank = np.arange(len(cell)) - np.searchsorted(cell, cell)
    depth = min(rank.max(initial=0) + 1, DEPTH)
    kept = (rank < depth) & (cell > 0)
    at, order = (cell[kept], rank[kept]), order[kept]

    def packed(values, fill=0):
        """Return values in their slots, and the fill elsewhere."""
        table = np.full((shape[0] * shape[1], depth, *values.shape[1:]), fill, np.float32)
        table[at] = values[order]
        return table

    width, height = evidence.block.astype(np.float32).T
    area = width * height / MACROBLOCK ** 2
    heavy = np.float32(sqrt(2) if settings.paper_weights else 2)
    weight = np.where(evidence.variance < 2, heavy, 1) * area
    return _Slots(packed(evidence.x_cur), packed(evidence.vector, ABSENT), packed(weight),
                  packed(evidence.variance / area))


def _cells(x: np.ndarray, shape: tuple[int, int]) -> np.ndarray:
    """Return the macroblock of each pixel on a grid with a border; 0 (a corner) outside it."""
    column, row = (macroblock_of(x) + 1).T
    inside = (column > 0) & (column < shape[1] - 1) & (row > 0) & (row < shape[0] - 1)
    return np.where(inside, row * shape[1] + column, 0)


def _cluster(slots: _Slots, settings: DecoderSettings) -> _Cluster:
    gap = _square_gap(slots.vector[:, :, None], slots.vector[:, None])
    agree = gap < _limit(slots.vector, settings, 0.25)[:, :, None] ** 2
    mass = (agree @ slots.weight[:, :, None])[:, :, 0] * (slots.weight > 0)
    cell, lead = np.arange(len(mass)), mass.argmax(axis=1)
    member = agree[cell, lead] & (slots.weight > 0)
    weight = slots.weight * member
    whole = np.maximum(weight.sum(axis=1), 1e-9)
    x, vector = ((weight[:, None] @ part)[:, 0] / whole[:, None]
                 for part in (slots.x, slots.vector))
    variance = (weight ** 2 * slots.variance).sum(axis=1) / whole ** 2
    heaviest = np.maximum(slots.weight[cell, lead], 1e-9)
    return _Cluster(x, vector, variance, mass[cell, lead], whole / heaviest - 1, member)


def _square_gap(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    # A sum over an axis of length two would cost numpy ten times as much.
    return (a[..., 0] - b[..., 0]) ** 2 + (a[..., 1] - b[..., 1]) ** 2


def _limit(vector: np.ndarray, settings: DecoderSettings, share: float) -> np.ndarray:
    """Return how far vectors may differ [px] that a given share of a macroblock sets apart."""
    length = np.hypot(vector[..., 0], vector[..., 1])
    return settings.agreement_slack + share * settings.agreement_tolerance * length


def _skips(vector: np.ndarray) -> bool:
    """Tell whether zero vectors (M, 2) are skipped macroblocks rather than measured motion.

    An encoder short of bits skips macroblocks, which are exported with zero vectors: side by side
    they look like a still picture. Where the camera stands most vectors are zero; where it moves
    slowly all are short.
    """
    moved = np.any(vector != 0, axis=1)
    if np.count_nonzero(moved) <= STANDING * len(moved):
        return False
    return float(np.median(np.hypot(*vector[moved].T))) > SLOW


def _votes(fields: list[np.ndarray], present: list[np.ndarray], skips: bool,
           settings: DecoderSettings) -> list[np.ndarray]:
    """Return how many of the eight macroblocks around speak for each vector.

    Each gives at most one vote, that of its vector which agrees best; with ``skips`` a zero
    vector gives none. What comes near grows from block to block, by more than vectors may
    differ: two on opposite sides then speak together for what lies half-way between theirs.
    """
    fields = [np.where(here[..., None], vectors, ABSENT)
              for vectors, here in zip(fields, present, strict=True)]
    voters = [np.where(np.any(vectors != 0, axis=-1, keepdims=True), vectors, ABSENT)
              for vectors in fields] if skips else fields
    votes = []
    for vectors, here in zip(fields, present, strict=True):
        centre = vectors[1:-1, 1:-1]
        scale = 1 / _limit(centre, settings, 1.0) ** 2
        total = np.zeros(here.shape, np.float32)
        for side in AROUND[:4]:
            ends = [[other[_beside(sign * side[0], sign * side[1])] for other in voters]
                    for sign in (1, -1)]
            alone = sum(np.maximum(1 - np.minimum(*(_square_gap(end, centre) for end in both))
                                   * scale, 0) for both in ends)
            middle = _square_gap(0.5 * (ends[0][0] + ends[1][0]), centre)
            total[1:-1, 1:-1] += np.maximum(alone, 2 * np.maximum(1 - middle * scale, 0))
        votes.append(np.where(here, total, -1))
    return votes


def _beside(row: int, column: int) -> tuple[slice, slice]:
    """Return the part of a grid with a border that lies a row and a column beside its inside."""
    return slice(1 + row, row - 1 or None), slice(1 + column, column - 1 or None)


def match_probability(evidence: Evidence, merged: Correspondences,
                      settings: DecoderSettings) -> float:
    """Return the share of a segment's vectors that the merged ones bear out, p of [SLAPSE] III-B.

    Of direct vectors where there are any; indirect evidence is right where both its vectors are,
    with p^2. A vector in a macroblock without a supported one counts as wrong. NaN without any.
    """
    supported, direct = merged.supported(), evidence.variance < 2
    rows = direct if direct.any() else ~direct
    if not rows.any():
        return float('nan')
    vector = evidence.vector[rows]
    gap = _square_gap(vector, at(field_of(supported), evidence.x_cur[rows]))
    area = evidence.block[rows].astype(np.float32).prod(axis=1)
    right = float(area @ (gap < _limit(vector, settings, 0.25) ** 2) / area.sum())
    return right if direct.any() else sqrt(right)


def prior_update(pair: Correspondences, before: np.ndarray | None) -> np.ndarray:
    """Return the velocity for each macroblock after a pair."""
    grid = field_of(pair) / np.float32((pair.stamp - pair.previous_stamp) * 1e-9)
    weight = np.isfinite(grid[..., 0]).astype(np.float32)
    grid = np.where(weight[..., None] > 0, grid, np.float32(0))
    if before is not None:
        grid += FORGET * before * np.where(weight[..., None] > 0, 0.5, 0.1)
        weight += FORGET * np.where(weight > 0, 0.5, 0.1).astype(np.float32)
    return _filled(grid, weight)


def prior_field(velocity: np.ndarray, seconds: float, x: np.ndarray,
                vector: np.ndarray) -> np.ndarray:
    """Return the expected vectors, moved by the shift of those at hand."""
    field = velocity * np.float32(seconds)
    some = slice(None, None, max(len(x) // SAMPLE, 1))
    gap = vector[some] - at(field, x[some])
    shift = np.zeros(2, np.float32)
    for width in TRIM:
        near = (np.abs(gap[:, 0] - shift[0]) < width) & (np.abs(gap[:, 1] - shift[1]) < width)
        if np.count_nonzero(near) < 20:
            break
        shift = np.median(gap[near], axis=0)
    return field + shift


def field_of(pair: Correspondences) -> np.ndarray:
    """Return the vectors (rows, columns, 2) of a merged pair, NaN in macroblocks without one."""
    shape = -(-pair.height // MACROBLOCK), -(-pair.width // MACROBLOCK)
    field = np.full((*shape, 2), np.nan, np.float32)
    column, row = macroblock_of(pair.x_cur).T
    field[row, column] = pair.x_prev - pair.x_cur
    return field


def _filled(grid: np.ndarray, weight: np.ndarray) -> np.ndarray:
    """Return the field with holes filled by the mean of the smallest window that has a value."""
    out, done = np.zeros_like(grid), np.zeros(weight.shape, bool)
    for size in SPREAD:
        total = cv2.blur(weight, (size, size), borderType=cv2.BORDER_CONSTANT)
        mean = cv2.blur(grid, (size, size), borderType=cv2.BORDER_CONSTANT)
        new = ~done & (total * size * size > 0.9)
        out[new] = mean[new] / total[new][:, None]
        done |= new
    return out
