"""Direct and indirect evidence of a segment's motion, [SLAPSE] III-A and figure 2(b)."""

from dataclasses import dataclass

from mv_slapse.changed import replace
from mv_slapse.codec.motion_vectors import FrameVectors, PAST
from mv_slapse.codec.prediction import kernel_frame
from mv_slapse.codec.segments import kind_of, Segment
from mv_slapse.config import DecoderSettings
from mv_slapse.kernels.binding import compiled
from mv_slapse.records import FrameType, SegmentKind
import numpy as np


@dataclass(frozen=True)
class Evidence:
    """Vectors from key frame k to key frame k-1, each at its own place in k."""

    x_cur: np.ndarray  # (M, 2) float32: place in key frame k [px]; no block centre if indirect
    vector: np.ndarray  # (M, 2) float32: from there to the match in key frame k-1 [px]
    variance: np.ndarray  # (M,) float32: in that of one vector: 1 if direct, 2 if indirect
    block: np.ndarray  # (M, 2) uint8: block size [px]

    def __len__(self) -> int:
        """Return the number of vectors."""
        return len(self.x_cur)

    @property
    def columns(self) -> tuple[np.ndarray, ...]:
        """Return the columns as the kernels take them."""
        return self.x_cur, self.vector, self.variance, self.block


def collect(segment: Segment, settings: DecoderSettings) -> Evidence:
    """Return all evidence of a segment, but B blocks whose two vectors contradict.

    The vectors of a P frame are direct evidence. The two vectors of a block of a B frame are
    joined to indirect evidence; the later end is where it lies in key frame k.
    """
    parts = [compiled.indirect(kernel_frame(frame), *_bend(segment, frame, settings))
             for frame in _joining(segment)]
    if segment.current.frame_type is FrameType.P:
        parts.insert(0, compiled.direct(kernel_frame(segment.current)))
    return Evidence(*map(np.concatenate, zip(*parts, strict=True)))


def _joining(segment: Segment) -> tuple[FrameVectors, ...]:
    """Return the B frames whose two vectors join the key frames: in a pyramid its top alone.

    The others join one key frame and the top, half as far; with several reference pictures they
    may mean both, which agreement tells. Where headers tell nothing all pass for references.
    """
    tops = tuple(frame for frame in segment.between if frame.is_reference)
    is_pyramid = 0 < len(tops) < len(segment.between) and not is_ambiguous(segment)
    return tops[(len(tops) - 1) // 2:][:1] if is_pyramid else segment.between


def is_ambiguous(segment: Segment) -> bool:
    """Return whether some vector may point to another picture than the key frames."""
    return references(segment) > 1


def references(segment: Segment) -> int:
    """Return how many pictures a vector may point to, at most."""
    return max(frame.references for frame in (*segment.between, segment.current))


def _bend(segment: Segment, frame: FrameVectors, settings: DecoderSettings) -> tuple:
    """Return what tells whether the two vectors of a block contradict: share, slack, tolerance.

    Over the tenth of a second of a segment the motion is nearly uniform, so the two vectors are
    opposite and as long as the two times. If not, one of them is wrong: H.264 also exports
    vectors of lists that a block does not use.
    """
    share = ((frame.stamp - segment.previous.stamp)
             / (segment.current.stamp - segment.previous.stamp))
    return share, settings.bend_slack, settings.bend_tolerance


def halves(segment: Segment, settings: DecoderSettings) -> tuple[Segment, Segment]:
    """Return a segment as two, with its middle B frame as a pose between its key frames.

    Where key frames lie so far apart that most of the direct vectors fail, the B frame's own
    vectors, over half the distance, are good. The half after it holds the backward ones, turned.
    """
    # Of two B frames the first: in a pyramid it is the one that the other refers to.
    middle = segment.between[(len(segment.between) - 1) // 2]
    to_past, to_future = compiled.halves(kernel_frame(middle), *_bend(segment, middle, settings))
    first = _half(middle, to_past)
    second = replace(_half(segment.current, to_future), references=middle.references)
    return (Segment(segment.previous, first, (), kind_of(segment.previous, first)),
            Segment(first, second, (), SegmentKind.PP))


def _half(frame: FrameVectors, columns: tuple) -> FrameVectors:
    x, displacement, _, block = columns
    return replace(frame, frame_type=FrameType.P, is_predicted=False, x=x, block=block,
                   displacement=displacement, direction=np.full(len(x), PAST, np.int8))
