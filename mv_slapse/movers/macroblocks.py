"""Labels of the 16x16 macroblocks of a picture, from those of the blocks that have vectors."""

from mv_slapse.kernels.binding import compiled
from mv_slapse.records import Extraction, Label
import numpy as np


def vote(extraction: Extraction, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return label (M,) int8 and plane (M,) int32 of each macroblock, row by row; -1: none.

    Partitions vote with their area, at pixels x (N, 2) float32 of the picture: an extraction's own
    are undistorted. Wrong vectors (UNKNOWN) do not vote; of equal votes the lower label wins. The
    plane is the one with most of the winners' area.
    """
    return compiled.vote_macroblocks(
        np.ascontiguousarray(x, np.float32), np.ascontiguousarray(extraction.block, np.uint8),
        np.ascontiguousarray(extraction.label, np.int8),
        np.ascontiguousarray(extraction.plane_id, np.int32), extraction.width, extraction.height,
        int(Label.UNKNOWN))
