"""Motion vectors of one picture, as exact displacements of block centres."""

from dataclasses import dataclass, field

from mv_slapse.kernels.binding import compiled
from mv_slapse.records import FrameType
import numpy as np

PAST, FUTURE = -1, 1


@dataclass(frozen=True)
class FrameVectors:
    """Motion vectors of one picture."""

    stamp: int  # presentation time [ns]
    frame_type: FrameType
    width: int  # of the picture [px]
    height: int  # the same [px]
    # (N, 2) float32: block centres, pixels centred at integers [px]
    x: np.ndarray = field(default_factory=lambda: np.zeros((0, 2), np.float32))
    # (N, 2) float32: from the block to its match in the reference picture [px]
    displacement: np.ndarray = field(default_factory=lambda: np.zeros((0, 2), np.float32))
    # (N,) int8: PAST or FUTURE: the list of references, never which of them
    direction: np.ndarray = field(default_factory=lambda: np.zeros(0, np.int8))
    # (N, 2) uint8: block width and height [px]
    block: np.ndarray = field(default_factory=lambda: np.zeros((0, 2), np.uint8))
    # most pictures that a direction may mean; 1: the reference picture before, or the one after
    references: int = 1
    is_reference: bool = True  # whether others may be predicted from it
    # whether vectors are coded against the median of those around, as in H.264
    is_predicted: bool = False
    damage: str = ''  # why the vectors cannot be joined to the pictures before, else empty
    # (height, width) uint8: grey picture, kept only where pixels may be asked
    luma: np.ndarray | None = None
    is_blank: bool = False  # whether a key picture that was looked at shows nothing

    def __len__(self) -> int:
        """Return the number of vectors."""
        return len(self.x)


def columns(exported: np.ndarray | None) -> dict[str, np.ndarray]:
    """Return the columns x, displacement, direction, block of FrameVectors from FFmpeg's table.

    That is ``exported`` (40 N,) uint8, the bytes of AVMotionVector rows; None: there are none. The
    match lies at dst + motion / motion_scale: FFmpeg's own src_x and src_y are rounded to whole
    pixels. Half a pixel is taken off because FFmpeg counts from the picture's corner.
    """
    if exported is None or not len(exported):
        return {}
    return dict(zip(('x', 'displacement', 'direction', 'block'),
                    compiled.motion_vectors(exported), strict=True))
