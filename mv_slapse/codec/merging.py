"""A segment's evidence to one vector for each macroblock, section V-A of [SLAPSE]."""

from math import comb, sqrt

from mv_slapse.codec.evidence import collect, Evidence
from mv_slapse.codec.segments import Segment
from mv_slapse.config import DecoderSettings
from mv_slapse.records import Correspondences, SegmentKind
import numpy as np

MACROBLOCK = 16  # px
DEPTH = 6  # pieces of evidence looked at for each macroblock


def existence(kind: SegmentKind, n_b: int, p: float) -> float:
    """Return the probability that a right vector is among the evidence, Lemma 1 of [SLAPSE].

    Parameters
    ----------
    kind : SegmentKind
        IP, PP or PI.
    n_b : int
        B frames between the two key frames.
    p : float
        Probability that one vector is right.
    """
    none_indirect = (1 - p * p) ** n_b
    return 1 - none_indirect if kind is SegmentKind.PI else 1 - (1 - p) * none_indirect


def merged_variance(n_indirect, has_direct, direct_weight: float):
    """Return the variance of a merged vector in units of one vector's variance.

    The average of a direct vector (variance 1, weight w) and n indirect ones (variance 2, weight
    1) has variance (w^2 + 2 n) / (w + n)^2; [SLAPSE] (5) takes w = sqrt 2, inverse variances
    give w = 2. Works on arrays.
    """
    w = direct_weight * has_direct
    return (w ** 2 + 2 * n_indirect) / (w + n_indirect) ** 2


def expected_variance(kind: SegmentKind, n_b: int, p: float, direct_weight: float) -> float:
    """Return the variance of a merged vector, given that it exists: Lemma 2 of [SLAPSE], (8), (9).

    The mixture over which of the evidence is right, of `merged_variance`, divided by Lemma 1.
    """
    q = p * p
    directs = ((0, 1.0),) if kind is SegmentKind.PI else ((0, 1 - p), (1, p))
    total = sum(chance * comb(n_b, n) * q ** n * (1 - q) ** (n_b - n)
                * merged_variance(n, direct, direct_weight)
                for direct, chance in directs for n in range(n_b + 1) if n + direct)
    return total / existence(kind, n_b, p)


def merge(segment: Segment, settings: DecoderSettings) -> Correspondences:
    """Return one correspondence for each macroblock of key frame k whose evidence agrees.

    Evidence that neither its own macroblock nor the neighbours support is rejected before
    averaging. Position and vector are averaged with the same weights, so that a motion that is
    linear across the block stays exact although indirect evidence lies beside the centre.

    Parameters
    ----------
    segment : Segment
        Not BROKEN.
    settings : DecoderSettings
    """
    evidence = collect(segment, settings.bend_slack, settings.bend_tolerance)
    frame = segment.current
    cell, stride = _cells(evidence, frame.width, frame.height)
    score = _support(evidence, cell, stride, settings)
    columns = _average(evidence, cell, score, settings)
    n = len(columns['sigma'])
    chance = existence(segment.kind, len(segment.between), settings.match_probability)
    return Correspondences(
        frame.stamp, segment.previous.stamp, frame.width, frame.height, segment.kind,
        len(segment.between), probability=np.full(n, chance, np.float32),
        block=np.full((n, 2), MACROBLOCK, np.uint8), **columns)


def _cells(evidence: Evidence, width: int, height: int) -> tuple[np.ndarray, int]:
    """Return the macroblock of each piece (0: outside) on a grid with a border, its width."""
    stride, rows = -(-width // MACROBLOCK) + 2, -(-height // MACROBLOCK) + 2
    column, row = (np.floor((evidence.x_cur + 0.5) / MACROBLOCK).astype(np.intp) + 1).T
    inside = (column > 0) & (column < stride - 1) & (row > 0) & (row < rows - 1)
    return np.where(inside, row * stride + column, 0), stride


def _table(cell: np.ndarray) -> np.ndarray:
    """Return the evidence of each cell, (cells, DEPTH) rows; len(cell) where there is no more."""
    order = np.argsort(cell, kind='stable')
    ordered = cell[order]
    rank = np.arange(len(cell)) - np.searchsorted(ordered, ordered)
    table = np.full((cell.max(initial=0) + 1, DEPTH), len(cell))
    kept = (rank < DEPTH) & (ordered > 0)
    table[ordered[kept], rank[kept]] = order[kept]
    return table


def _support(evidence: Evidence, cell: np.ndarray, stride: int,
             settings: DecoderSettings) -> np.ndarray:
    """Return how much the own and the eight macroblocks around speak for each vector, 0 to 9.

    Each of the nine gives at most one vote, that of its vector which agrees best.
    """
    table = _table(cell)
    vectors = np.r_[evidence.vector, np.full((1, 2), 1e9, np.float32)]
    length = np.hypot(*evidence.vector.T)
    around = settings.agreement_slack + settings.agreement_tolerance * length
    within = settings.agreement_slack + settings.agreement_tolerance / 4 * length
    votes = np.zeros(len(evidence), np.float32)
    own = np.arange(len(evidence))[:, None]
    for step in (-stride - 1, -stride, -stride + 1, -1, 0, 1, stride - 1, stride, stride + 1):
        other = table[np.clip(cell + step, 0, len(table) - 1)]
        gap = vectors[other] - evidence.vector[:, None]
        near = 1 - (gap ** 2).sum(axis=2) / ((around if step else within) ** 2)[:, None]
        if not step:
            near[other == own] = 0
        votes += near.max(axis=1, initial=0)
    return np.where(cell > 0, votes, 0)


def _average(evidence: Evidence, cell: np.ndarray, score: np.ndarray,
             settings: DecoderSettings) -> dict[str, np.ndarray]:
    """Average what agrees with the best supported vector of each macroblock, (5) and (6)."""
    order = np.lexsort((-score, cell))
    leads = order[np.r_[True, np.diff(cell[order]) > 0]] if len(order) else order
    leads = leads[(score[leads] >= settings.min_support) & (cell[leads] > 0)]
    lead = np.full(cell.max(initial=0) + 1, -1)
    lead[cell[leads]] = leads
    mine = lead[cell]
    gap = np.hypot(*(evidence.vector - evidence.vector[mine]).T)
    limit = settings.agreement_slack + settings.agreement_tolerance / 4 * np.hypot(
        *evidence.vector.T)
    member = np.flatnonzero((mine >= 0) & (gap < limit))
    return _weighted(evidence, member, np.searchsorted(np.sort(cell[leads]), cell[member]),
                     len(leads), settings)


def _weighted(evidence: Evidence, member: np.ndarray, group: np.ndarray, n: int,
              settings: DecoderSettings) -> dict[str, np.ndarray]:
    direct = evidence.variance[member] == 1
    area = evidence.block[member].astype(np.float32).prod(axis=1) / MACROBLOCK ** 2
    heavy = sqrt(2) if settings.paper_weights else 2.0
    weight = np.where(direct, heavy, 1.0) * area

    def total(values):
        return np.bincount(group, values, n)

    whole = total(weight)
    x = np.stack([total(weight * evidence.x_cur[member, i]) for i in (0, 1)], axis=1)
    v = np.stack([total(weight * evidence.vector[member, i]) for i in (0, 1)], axis=1)
    x, v = x / whole[:, None], v / whole[:, None]
    variance = merged_variance(total(~direct * area), total(direct * area), heavy)
    sigma = settings.vector_sigma * np.sqrt(np.maximum(variance, 0.2))
    return {'x_cur': x.astype(np.float32), 'x_prev': (x + v).astype(np.float32),
            'sigma': sigma.astype(np.float32)}
