"""Silhouettes of movers: which macroblocks a moving obstacle covers, with or without vectors.

A vehicle that comes near outruns the encoder's search, dark bodywork has no texture, and blocks
coded anew have no vector at all. What lies inside the outline of a mover's blocks, or where its
last outline has moved on to, is part of it unless a vector there says otherwise.
"""

from dataclasses import dataclass
import math

import cv2
from mv_slapse.changed import replace
from mv_slapse.geometry.blocks import grid_shape
from mv_slapse.kernels.binding import compiled
from mv_slapse.movers.moving_plane import MIN_BLOCKS
from mv_slapse.records import Correspondences, Extraction, Label
import numpy as np

STRAY = 3.0  # times the median: a vector so far from the middle one is a wrong one
WEAK = 20.0  # px: a vector errs by 1 px, a mover grows by 0.05 in a pair
NEVER = -1
LIFETIME = 350_000_000  # [ns] for which an outline moves on: as many movers are found as at 0.5 s
BESIDE = 2  # of the eight macroblocks around that one of an outline has; a wrong vector has fewer
AMID = 4  # of the eight that one beside the outline has, to stay; with fewer 40 % are the road's


@dataclass(frozen=True)
class _Silhouette:
    """Macroblocks of one mover."""

    # (M,) int64: when each was last inside the outline of the mover's blocks [ns]; NEVER: it is
    # not its
    seen: np.ndarray
    # (5,): how it moves in the picture over the pair, back in time: centre, shift [px], growth
    motion: np.ndarray


class Silhouettes:
    """Fills the macroblocks of movers from key frame to key frame."""

    def __init__(self):
        """Know no mover yet."""
        self._known: dict[int, _Silhouette] = {}

    def fill(self, extraction: Extraction, correspondences: Correspondences) -> Extraction:
        """Return an extraction with its macroblocks labelled, by the same blocks' pixels.

        Movers hold the macroblocks without a vector that they cover.
        """
        size, stamp = (extraction.width, extraction.height), extraction.stamp
        label, plane = vote(extraction, correspondences.x_cur)
        known = {}
        for id_, motion in self._motions(extraction, correspondences).items():
            seen = self._carried(id_, motion, size, stamp)
            own = (plane == id_) & (label == Label.MOVING.value)
            outline = _outline(own, size)
            seen[outline] = stamp
            # What has a label of its own is none of the mover's.
            seen[~own & (label != Label.UNKNOWN.value)] = NEVER
            held = seen != NEVER
            # One beside the outline with few of the mover around it is the road's again.
            held &= outline | (_crowd(outline, size) == 0) | (_crowd(held, size) > AMID)
            if held.any():
                known[id_] = _Silhouette(seen, motion)
                label[held], plane[held] = Label.MOVING, id_
        self._known = known
        return replace(extraction, macroblock_label=label, macroblock_plane=plane)

    def _motions(self, extraction, correspondences) -> dict[int, np.ndarray]:
        """Return the motion of each mover in view, and of those that were, as it was."""
        motions = {id_: known.motion - np.array([*known.motion[2:4], 0, 0, 0])
                   for id_, known in self._known.items()}
        for plane in extraction.planes:
            if plane.label is Label.MOVING:
                member = ((extraction.plane_id == plane.id)
                          & (extraction.label == Label.MOVING.value))
                motion = compiled.motion_in_picture(
                    correspondences.x_cur, correspondences.x_prev, member, MIN_BLOCKS, STRAY,
                    WEAK)
                if motion is not None:
                    motions[plane.id] = motion
        return motions

    def _carried(self, id_, motion, size, stamp) -> np.ndarray:
        """Return when each macroblock was last in the outline of a mover that moved on."""
        n, before = math.prod(grid_shape(*size)), self._known.get(id_)
        if before is None or len(before.seen) != n:
            return np.full(n, NEVER, np.int64)
        return compiled.carry_cells(before.seen, motion, *size, stamp, LIFETIME)


def vote(extraction: Extraction, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return label (M,) int8 and plane (M,) int32 of each macroblock, row by row; -1: none.

    Partitions vote with their area, at pixels x (N, 2) float32 of the picture: an extraction's own
    are undistorted. Wrong vectors (UNKNOWN) do not vote; of equal votes the lower label wins. The
    plane is the one with most of the winners' area.
    """
    return compiled.vote_macroblocks(
        np.ascontiguousarray(x, np.float32), np.ascontiguousarray(extraction.block, np.uint8),
        np.ascontiguousarray(extraction.label, np.int8),
        np.maximum(extraction.plane_id, -1, dtype=np.int32), extraction.width, extraction.height,
        int(Label.UNKNOWN))


def _crowd(cells: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    """Return how many of the nine macroblocks around and with each (M,) are among some."""
    columns, rows = grid_shape(*size)
    return cv2.boxFilter(cells.reshape(rows, columns).astype(np.uint8), -1, (3, 3),
                         normalize=False, borderType=cv2.BORDER_CONSTANT).ravel()


def _outline(own: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    """Return the macroblocks (M,) inside the convex outline of some, stray ones left out."""
    if not own.any():
        return own
    columns, rows = grid_shape(*size)
    firm = own & (_crowd(own, size) > BESIDE)
    at, = (firm if np.count_nonzero(firm) >= MIN_BLOCKS else own).nonzero()
    corners = np.empty((len(at), 2), np.int32)
    np.divmod(at, columns, out=(corners[:, 1], corners[:, 0]), casting='unsafe')
    image = np.zeros((rows, columns), np.uint8)
    cv2.fillConvexPoly(image, cv2.convexHull(corners), 1)
    return image.ravel() > 0
