"""A segment's evidence to one vector for each macroblock, section V-A of [SLAPSE]."""

from math import sqrt

from mv_slapse.changed import replace
from mv_slapse.codec.evidence import Evidence, is_ambiguous, references
from mv_slapse.codec.prior import MotionPrior
from mv_slapse.codec.segments import Segment
from mv_slapse.config import DecoderSettings
from mv_slapse.geometry.blocks import MACROBLOCK
from mv_slapse.kernels.binding import compiled
from mv_slapse.records import Correspondences, SegmentKind
import numpy as np


def existence(kind: SegmentKind, n_b: int, p: float) -> float:
    """Return the probability that a right vector is among the evidence, Lemma 1 of [SLAPSE].

    Of a segment with ``n_b`` B frames, where one vector is right with the probability ``p``.
    """
    none_indirect = (1 - p * p) ** n_b
    return 1 - none_indirect if kind is SegmentKind.PI else 1 - (1 - p) * none_indirect


def merge(segment: Segment, evidence: Evidence, settings: DecoderSettings,
          expect: MotionPrior | None = None, p: float | None = None) -> Correspondences:
    """Return one correspondence for each macroblock of key frame k whose evidence agrees.

    Evidence that neither its own macroblock nor the neighbours support is rejected before
    averaging. Position and vector are averaged with the same weights, so that a motion that is
    linear across the block stays exact although indirect evidence lies beside the centre. ``p`` is
    the probability that one vector is right, if the stream has shown it.
    """
    field = None
    if expect is not None:
        seconds = (segment.current.stamp - segment.previous.stamp) * 1e-9
        field = expect.field(seconds, evidence.x_cur, evidence.vector)
    return average(segment, evidence, settings, field, p)


def average(segment: Segment, evidence: Evidence, settings: DecoderSettings,
            field: np.ndarray | None = None, p: float | None = None) -> Correspondences:
    """Return one correspondence for each macroblock on which the given evidence agrees."""
    frame = segment.current
    # Over several pictures, or to one of several, a vector that nothing supports says nothing.
    direct = not segment.between and not is_ambiguous(segment)
    x, vector, variance, lone = agreed(evidence, (frame.width, frame.height), settings, field)
    # Among nothing but lone vectors none is lone: they are noise.
    n_lone = np.count_nonzero(lone)
    if n_lone and (not (direct and settings.lone_probability) or n_lone == len(lone)):
        keep, n_lone = (~lone).nonzero()[0], 0
        x, vector, variance = (column.take(keep, axis=0) for column in (x, vector, variance))
    chance = existence(segment.kind, len(segment.between), p or settings.match_probability)
    probability = np.full(len(x), chance, np.float32)
    if n_lone:
        probability[lone] = settings.lone_probability * chance
    return Correspondences(
        frame.stamp, segment.previous.stamp, frame.width, frame.height, segment.kind,
        len(segment.between), x_cur=x, x_prev=x + vector,
        sigma=settings.vector_sigma * np.sqrt(variance),
        probability=probability, block=np.full((len(x), 2), MACROBLOCK, np.uint8))


def refined(pair: Correspondences, segment: Segment,
            settings: DecoderSettings) -> Correspondences:
    """Return a pair of an ambiguous segment with its short vectors as the two pictures tell.

    Over two or three pictures a slow turn is hardly longer than over one, so that such vectors
    agree with right ones, and their mean is too long. Of `n` reference pictures those vectors may
    be wrong over which n pictures differ from n - 1 by no more than vectors that agree may. Where
    one of the two pictures is not known the pair stays as it is.
    """
    if not (is_ambiguous(segment) and segment.has_pictures):
        return pair
    n = references(segment)
    left = 1 - n * settings.agreement_tolerance
    longest = n * settings.agreement_slack / left if left > 0 else np.inf
    short = np.linalg.norm(pair.x_prev - pair.x_cur, axis=1) <= longest
    x_prev = pair.x_prev.copy()
    x_prev[short] = compiled.refine(segment.current.luma, segment.previous.luma,
                                    pair.x_cur[short], x_prev[short])
    return replace(pair, x_prev=x_prev)


def seen(pair: Correspondences, segment: Segment) -> Correspondences:
    """Return a pair of a segment with the noise of its matches as the pictures show it.

    A vector is as uncertain as its macroblock has little texture, and as what is left of it in the
    other picture; of a half of a segment one picture is known. See kernels/texture.cpp.
    """
    now, before = segment.current, segment.previous
    return replace(pair, sigma=compiled.match_sigma(
        now.luma if pair.stamp == now.stamp else None,
        before.luma if pair.previous_stamp == before.stamp else None,
        pair.x_cur, pair.x_prev, pair.sigma))


def match_probability(evidence: Evidence, merged: Correspondences,
                      settings: DecoderSettings) -> float:
    """Return the share of a segment's vectors that the merged ones bear out, p of [SLAPSE] III-B.

    Of direct vectors where there are any; indirect evidence is right where both its vectors are,
    with p^2. A vector in a macroblock without a supported one counts as wrong. NaN without any.
    """
    right, direct = compiled.borne_out(
        evidence.columns, (merged.x_cur, merged.x_prev, merged.probability), merged.width,
        merged.height, settings.agreement_slack, settings.agreement_tolerance)
    return right if direct else sqrt(right)


def agreed(evidence: Evidence, size: tuple[int, int], settings: DecoderSettings,
           field: np.ndarray | None = None) -> tuple[np.ndarray, ...]:
    """Return what the evidence of each macroblock of a picture of some width and height agrees on.

    A macroblock's evidence falls into at most two clusters; the one that the eight macroblocks
    around and the pairs before support best is taken. ``field`` (rows, columns, 2) [px] is what
    the pairs before let expect.

    Returns
    -------
    x, vector : (N, 2) float32
        Place and vector [px].
    variance : (N,) float32
        In units of one vector's variance.
    lone : (N,) bool
        Which have too little support.
    """
    return compiled.merge(
        evidence.columns, *size, field, slack=settings.agreement_slack,
        tolerance=settings.agreement_tolerance, min_support=settings.min_support,
        prior_votes=settings.prior_votes, prior_slack=settings.prior_slack,
        prior_tolerance=settings.prior_tolerance,
        direct_weight=sqrt(2) if settings.paper_weights else 2)
