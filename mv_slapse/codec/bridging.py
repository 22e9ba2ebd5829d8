"""A search of macroblocks across an I frame that no vector joins to the past.

Streams without B frames have a dead segment at every I frame. Decoding gives the pictures for
free, so the macroblocks of the I frame are looked for in the picture before it, which takes the
place of the vectors that the encoder did not send. The few B frames before an I frame often tell
little as well: H.264 codes most of their blocks in one direction.
"""

import cv2
from mv_slapse.codec.evidence import Evidence
from mv_slapse.codec.prior import at, MotionPrior
from mv_slapse.codec.segments import LONGEST, Segment
from mv_slapse.config import DecoderSettings
from mv_slapse.geometry.blocks import MACROBLOCK
from mv_slapse.records import FrameType
import numpy as np

RETURN = 0.5  # px, how near the search back must end to where the search began
LEVELS = 3
SPARSE, LEAST = 7, 10  # every so many macroblocks; so many tell whether the pictures changed
EXCUSED = 1.0  # px of motion that an encoder may leave out to save bits
FLAT = 1e-4  # smallest eigenvalue of a macroblock that has texture in two directions


def can_bridge(segment: Segment) -> bool:
    """Return whether both pictures are there and near, and only the vectors are missing."""
    return segment.current.frame_type is FrameType.I and can_search(segment)


def can_search(segment: Segment) -> bool:
    """Return whether both pictures are there, near, whole, of one size, and show something."""
    return (segment.has_pictures and not segment.current.damage
            and not (segment.previous.is_blank or segment.current.is_blank)
            and 0 < segment.current.stamp - segment.previous.stamp <= LONGEST)


def is_untrue(segment: Segment) -> bool:
    """Return whether all vectors say that nothing moves, but the pictures do not.

    An encoder that does not search codes all vectors as zero, whatever moves. Half of what is
    found of a sparse grid must have gone farther than the bits of a vector excuse.
    """
    frames = (segment.current, *segment.between)
    if any(frame.displacement.any() for frame in frames) or not can_search(segment):
        return False
    x = _centres(segment.current.width, segment.current.height)[::SPARSE]
    there, found = _follow(segment.current.luma, segment.previous.luma, x, x)
    way = np.abs(there - x).max(axis=1)[found]
    return bool(len(way) >= LEAST and np.median(way) > EXCUSED)


def search(segment: Segment, expect: MotionPrior, settings: DecoderSettings) -> Evidence:
    """Return the macroblocks of key frame k found in key frame k-1, as direct evidence.

    Of a segment that `can_bridge`: Lucas-Kanade steps from the expected motion, there and back.
    """
    current, previous = segment.current.luma, segment.previous.luma
    x = _centres(segment.current.width, segment.current.height)
    seconds = (segment.current.stamp - segment.previous.stamp) * 1e-9
    field = expect.field(seconds, x[:0], x[:0])
    start = x if field is None else x + at(field, x)
    there, found = _follow(current, previous, x, start)
    inside = ((there >= 0) & (there < (segment.current.width, segment.current.height))).all(axis=1)
    x, there = x[found & inside], there[found & inside]
    back, returned = _follow(previous, current, there, x, levels=0)  # begins where it must end
    good = returned & (np.abs(back - x).max(axis=1) < RETURN)
    n = np.count_nonzero(good)
    return Evidence(x[good], there[good] - x[good],
                    np.full(n, settings.bridge_variance, np.float32),
                    np.full((n, 2), MACROBLOCK, np.uint8))


def _centres(width: int, height: int) -> np.ndarray:
    grid = np.mgrid[0:height // MACROBLOCK, 0:width // MACROBLOCK][::-1].reshape(2, -1).T
    return (MACROBLOCK * grid + (MACROBLOCK - 1) / 2).astype(np.float32)


def _follow(a: np.ndarray, b: np.ndarray, x: np.ndarray, start: np.ndarray, levels: int = LEVELS):
    """Return where in b the macroblocks at x (N, 2) of a are, and which (N,) bool were found."""
    if not len(x):
        return x, np.zeros(0, bool)
    there, found, _ = cv2.calcOpticalFlowPyrLK(
        a, b, x[:, None], start[:, None].copy(), winSize=(MACROBLOCK + 1, MACROBLOCK + 1),
        maxLevel=levels, flags=cv2.OPTFLOW_USE_INITIAL_FLOW, minEigThreshold=FLAT)
    return there[:, 0], found[:, 0] > 0
