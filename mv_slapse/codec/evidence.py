"""Direct and indirect evidence of a segment's motion, [SLAPSE] III-A and figure 2(b)."""

from dataclasses import dataclass, replace

from mv_slapse.codec.motion_vectors import FrameVectors, FUTURE, PAST
from mv_slapse.codec.prediction import leaning
from mv_slapse.codec.prior import at
from mv_slapse.codec.segments import Segment
from mv_slapse.config import DecoderSettings
from mv_slapse.geometry.blocks import CELL, cell_of, MACROBLOCK
from mv_slapse.records import FrameType, SegmentKind
import numpy as np


@dataclass(frozen=True)
class Evidence:
    """Vectors from key frame k to key frame k-1, each at its own place in k.

    Attributes
    ----------
    x_cur : (M, 2) float32
        Where the evidence lies in key frame k [px]; no block centre for indirect evidence.
    vector : (M, 2) float32
        From there to the match in key frame k-1 [px].
    variance : (M,) float32
        In units of one vector's variance: 1 for direct, 2 for indirect evidence.
    block : (M, 2) uint8
        Block size [px].
    """

    x_cur: np.ndarray
    vector: np.ndarray
    variance: np.ndarray
    block: np.ndarray

    def __len__(self) -> int:
        """Return the number of vectors."""
        return len(self.x_cur)


def collect(segment: Segment, settings: DecoderSettings) -> Evidence:
    """Return all evidence of a segment, but B blocks whose two vectors contradict."""
    parts = [_indirect(segment, frame, settings) for frame in segment.between]
    if segment.current.frame_type is FrameType.P:
        parts.insert(0, _direct(segment))
    return _joined(parts)


def is_ambiguous(segment: Segment) -> bool:
    """Return whether some vector may point to another picture than the key frames."""
    return max(frame.references for frame in (*segment.between, segment.current)) > 1


def of_one_interval(evidence: Evidence, field: np.ndarray, settings: DecoderSettings) -> Evidence:
    """Drop the vectors that rather point to another picture than key frame k-1.

    FFmpeg tells the direction, not which picture (`FrameVectors.direction`). A vector to another
    picture is longer or shorter than expected by at least a third.

    Parameters
    ----------
    evidence : Evidence
    field : (rows, columns, 2) float32
        What to expect, see `MotionPrior.field` [px].
    settings : DecoderSettings
    """
    expected = at(field, evidence.x_cur)
    gap = np.hypot(*(evidence.vector - expected).T)
    return _take(evidence, gap < settings.reference_slack
                 + settings.reference_tolerance * np.hypot(*expected.T))


def _joined(parts: list[Evidence]) -> Evidence:
    parts = parts or [Evidence(np.zeros((0, 2), np.float32), np.zeros((0, 2), np.float32),
                               np.zeros(0, np.float32), np.zeros((0, 2), np.uint8))]
    return Evidence(*(np.concatenate([getattr(part, name) for part in parts])
                      for name in ('x_cur', 'vector', 'variance', 'block')))


def _take(evidence: Evidence, rows: np.ndarray) -> Evidence:
    return Evidence(evidence.x_cur[rows], evidence.vector[rows], evidence.variance[rows],
                    evidence.block[rows])


def _direct(segment: Segment) -> Evidence:
    frame = segment.current
    past = frame.direction == PAST
    return Evidence((frame.x + leaning(frame))[past], frame.displacement[past],
                    np.ones(np.count_nonzero(past), np.float32), frame.block[past])


def _indirect(segment: Segment, frame: FrameVectors, settings: DecoderSettings) -> Evidence:
    """Join the two vectors of each block of a B frame; the later end is where it lies in k."""
    past, future = bent(segment, frame, settings)[0]
    to_future, lean = frame.displacement[future], leaning(frame)
    place = frame.x[past] + 0.5 * (lean[past] + lean[future])
    return Evidence(place + to_future, frame.displacement[past] - to_future,
                    np.full(len(past), 2, np.float32), frame.block[past])


def bent(segment: Segment, frame: FrameVectors, settings: DecoderSettings):
    """Split the blocks of a B frame with two vectors into good ones and bent ones.

    Over the tenth of a second of a segment the motion is nearly uniform, so the two vectors are
    opposite and as long as the two times. If not, one of them is wrong: H.264 also exports
    vectors of lists that a block does not use.

    Returns
    -------
    good, bad : tuple of (past, future)
        Rows of the vectors of each block.
    """
    past, future = _pairs(frame)
    to_past, to_future = frame.displacement[past], frame.displacement[future]
    share = np.float32((frame.stamp - segment.previous.stamp)
                       / (segment.current.stamp - segment.previous.stamp))
    vector = to_past - to_future
    bend = np.hypot(*(to_past - share * vector).T)
    good = bend < settings.bend_slack + settings.bend_tolerance * np.hypot(*vector.T)
    return (past[good], future[good]), (past[~good], future[~good])


def _pairs(frame: FrameVectors) -> tuple[np.ndarray, np.ndarray]:
    """Return the rows of the past and of the future vectors of the blocks that have both."""
    column, row = cell_of(frame.x, frame.block).T
    stride = frame.width // CELL + 4
    key = row * stride + column
    rows = np.full((2, stride * (frame.height // CELL + 4)), -1)
    for side, direction in enumerate((PAST, FUTURE)):
        index = np.flatnonzero(frame.direction == direction)
        rows[side, key[index]] = index
    past, future = rows[:, (rows >= 0).all(axis=0)]
    width, height = (frame.block[past] == frame.block[future]).T
    same = width & height
    return past[same], future[same]


def halves(segment: Segment, settings: DecoderSettings) -> tuple[Segment, Segment]:
    """Return a segment as two, with its middle B frame as a pose between its key frames.

    Where key frames lie so far apart that most of the direct vectors fail, the B frame's own
    vectors, over half the distance, are good. The half
    after it holds the B frame's backward vectors, turned round.
    """
    # Of two B frames the first: in a pyramid it is the one that the other refers to.
    middle = segment.between[(len(segment.between) - 1) // 2]
    wrong = np.zeros(len(middle), bool)
    wrong[np.concatenate(bent(segment, middle, settings)[1])] = True
    # Each block is all that its macroblock has, and stays in it.
    x = middle.x + np.maximum(leaning(middle), -MACROBLOCK / 2)
    past = np.flatnonzero((middle.direction == PAST) & ~wrong)
    future = np.flatnonzero((middle.direction == FUTURE) & ~wrong)
    first = replace(middle, frame_type=FrameType.P, is_predicted=False, x=x[past],
                    displacement=middle.displacement[past], direction=middle.direction[past],
                    block=middle.block[past])
    back = middle.displacement[future]
    second = replace(segment.current, frame_type=FrameType.P, x=x[future] + back,
                     displacement=-back, direction=-middle.direction[future],
                     is_predicted=False, block=middle.block[future], references=middle.references)
    return (Segment(segment.previous, first, (), _first_kind(segment)),
            Segment(first, second, (), SegmentKind.PP))


def _first_kind(segment: Segment) -> SegmentKind:
    return SegmentKind.IP if segment.previous.frame_type is FrameType.I else SegmentKind.PP
