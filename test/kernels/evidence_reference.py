"""Evidence of a segment in numpy: the formulas that the kernels are compared with."""

from formulas import CELL, cell_of
from mv_slapse.codec.evidence import Evidence
from mv_slapse.codec.motion_vectors import FrameVectors, FUTURE, PAST
from mv_slapse.codec.prediction import RISE
from mv_slapse.codec.segments import Segment
from mv_slapse.config import DecoderSettings
from mv_slapse.geometry.blocks import MACROBLOCK
from mv_slapse.records import FrameType
import numpy as np

HALVING = 0.25  # px from its prediction, at which the rise of a vector halves


def collect(segment: Segment, settings: DecoderSettings) -> Evidence:
    """Return all evidence of a segment, but B blocks whose two vectors contradict."""
    parts = [_indirect(segment, frame, settings) for frame in segment.between]
    if segment.current.frame_type is FrameType.P:
        parts.insert(0, _direct(segment))
    return _joined(parts)


def _joined(parts: list[Evidence]) -> Evidence:
    parts = parts or [Evidence(np.zeros((0, 2), np.float32), np.zeros((0, 2), np.float32),
                               np.zeros(0, np.float32), np.zeros((0, 2), np.uint8))]
    return Evidence(*(np.concatenate([getattr(part, name) for part in parts])
                      for name in ('x_cur', 'vector', 'variance', 'block')))


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


def halves(segment: Segment, settings: DecoderSettings) -> tuple[Evidence, Evidence]:
    """Return the vectors of the first middle B frame, to the past and to the future."""
    middle = segment.between[(len(segment.between) - 1) // 2]
    wrong = np.zeros(len(middle), bool)
    wrong[np.concatenate(bent(segment, middle, settings)[1])] = True
    x = middle.x + np.maximum(leaning(middle), -MACROBLOCK / 2)
    past = np.flatnonzero((middle.direction == PAST) & ~wrong)
    future = np.flatnonzero((middle.direction == FUTURE) & ~wrong)
    back = middle.displacement[future]
    one, other = np.ones(len(past), np.float32), np.ones(len(future), np.float32)
    return (Evidence(x[past], middle.displacement[past], one, middle.block[past]),
            Evidence(x[future] + back, -back, other, middle.block[future]))


def leaning(frame: FrameVectors) -> np.ndarray:
    """Return the way (N, 2) [px] from the middle of each block to where its vector tells of.

    Zero for partitions, few of which are as predicted, and where a vector may mean one of several
    pictures.
    """
    lean = np.zeros((len(frame), 2), np.float32)
    if not frame.is_predicted or frame.references > 1:
        return lean
    is_whole = (frame.block == MACROBLOCK).all(axis=1)
    for direction in (PAST, FUTURE):
        whole = np.flatnonzero(is_whole & (frame.direction == direction))
        gap = np.abs(frame.displacement[whole] - predicted(frame, whole, direction)).max(axis=1)
        lean[whole, 1] = -RISE[frame.frame_type] * 2 ** (-gap / HALVING)
    return lean


def predicted(frame: FrameVectors, whole: np.ndarray, direction: int) -> np.ndarray:
    """Return the predictions (M, 2) [px] of whole macroblocks, given by their rows (M,).

    ITU-T H.264, 8.4.1.3; for one reference picture in each direction.
    """
    cell = cell_of(frame.x, frame.block) + 1  # the table has a margin
    table = _table(frame, cell, direction)
    column, row = cell[whole].T
    left, above, beside = (table[row + dy, column + dx] for dy, dx in ((0, -1), (-1, 0), (-1, 2)))
    # To the right of the last macroblock there is none: the one above to the left is taken.
    last = column + 2 >= 1 + 2 * -(-frame.width // 16)
    beside[last] = table[row[last] - 1, column[last] - 1]
    around = np.stack([left, above, beside])
    there = np.isfinite(around[..., 0])
    a, b, c = np.where(there[..., None], around, np.float32(0))
    median = np.maximum(np.minimum(a, b), np.minimum(np.maximum(a, b), c))  # fast
    only = np.take_along_axis(around, there.argmax(axis=0)[None, :, None], axis=0)[0]
    return np.where((there.sum(axis=0) == 1)[:, None], only, median)


def _table(frame: FrameVectors, cell: np.ndarray, direction: int) -> np.ndarray:
    """Return the vectors (rows, columns, 2) of cells with a margin; NaN where there is none."""
    table = np.full((frame.height // CELL + 4, frame.width // CELL + 4, 2), np.nan, np.float32)
    for dx, dy in ((0, 0), (CELL, 0), (0, CELL), (CELL, CELL)):
        covers = ((frame.direction == direction) & (frame.block[:, 0] > dx)
                  & (frame.block[:, 1] > dy))
        column, row = cell[covers].T
        table[row + dy // CELL, column + dx // CELL] = frame.displacement[covers]
    return table
