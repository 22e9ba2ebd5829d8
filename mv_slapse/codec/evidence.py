"""Direct and indirect evidence of a segment's motion, [SLAPSE] III-A and figure 2(b)."""

from dataclasses import dataclass

from mv_slapse.codec.motion_vectors import FrameVectors, FUTURE, PAST
from mv_slapse.codec.segments import Segment
from mv_slapse.records import FrameType
import numpy as np

CELL = 8  # px, the smallest block that FFmpeg tells


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


def collect(segment: Segment, slack: float, tolerance: float) -> Evidence:
    """Return all evidence of a segment.

    Parameters
    ----------
    segment : Segment
    slack, tolerance : float
        A forward and a backward vector may depart from constant velocity by
        slack [px] + tolerance * length of the motion (ALGORITHM 2, trap 3).
    """
    parts = [_indirect(segment, frame, slack, tolerance) for frame in segment.between]
    if segment.current.frame_type is FrameType.P:
        parts.insert(0, _direct(segment.current))
    if not parts:
        return _empty()
    return Evidence(*(np.concatenate([getattr(part, name) for part in parts])
                      for name in ('x_cur', 'vector', 'variance', 'block')))


def _empty() -> Evidence:
    none = np.zeros((0, 2), np.float32)
    return Evidence(none, none, np.zeros(0, np.float32), np.zeros((0, 2), np.uint8))


def _direct(frame: FrameVectors) -> Evidence:
    past = frame.direction == PAST
    return Evidence(frame.x[past], frame.displacement[past],
                    np.ones(np.count_nonzero(past), np.float32), frame.block[past])


def _indirect(segment: Segment, frame: FrameVectors, slack: float,
              tolerance: float) -> Evidence:
    """Join the two vectors of each block of a B frame; the later end is where it lies in k."""
    past, future = _pairs(frame)
    to_past, to_future = frame.displacement[past], frame.displacement[future]
    share = np.float32((frame.stamp - segment.previous.stamp)
                       / (segment.current.stamp - segment.previous.stamp))
    vector = to_past - to_future
    bend = np.hypot(*(to_past + share * -vector).T)
    good = bend < slack + tolerance * np.hypot(*vector.T)
    x = frame.x[past] + to_future
    return Evidence(x[good], vector[good], np.full(np.count_nonzero(good), 2, np.float32),
                    frame.block[past][good])


def _pairs(frame: FrameVectors) -> tuple[np.ndarray, np.ndarray]:
    """Return the rows of the past and of the future vectors of the blocks that have both."""
    column, row = ((frame.x + np.float32(0.5) - frame.block / np.float32(2)) / CELL).astype(
        np.intp).T
    stride = frame.width // CELL + 4
    key = row * stride + column
    rows = np.full((2, stride * (frame.height // CELL + 4)), -1)
    for side, direction in enumerate((PAST, FUTURE)):
        index = np.flatnonzero(frame.direction == direction)
        rows[side, key[index]] = index
    past, future = rows[:, (rows >= 0).all(axis=0)]
    same = (frame.block[past] == frame.block[future]).all(axis=1)
    return past[same], future[same]
