"""Silhouettes of movers: which macroblocks a moving obstacle covers, with or without vectors.

A vehicle that comes near outruns the encoder's search, dark bodywork has no texture, and blocks
coded anew have no vector at all. What lies inside the outline of a mover's blocks, or where its
last outline has moved on to, is part of it unless a vector there says otherwise.
"""

from dataclasses import dataclass
from typing import NamedTuple

import cv2
from mv_slapse.changed import replace
from mv_slapse.geometry.blocks import grid_centres, grid_index, grid_shape
from mv_slapse.kernels.binding import compiled
from mv_slapse.movers.identity import LIFETIME
from mv_slapse.movers.moving_plane import MIN_BLOCKS
from mv_slapse.records import Correspondences, Extraction, Label
import numpy as np

STRAY = 3.0  # times the median: a vector so far from the middle one is a wrong one
WEAK = 20.0  # px: a vector errs by 1 px, a mover grows by 0.05 in a pair
NEVER = -1


class _Motion(NamedTuple):
    """Motion of a mover in the picture over the pair, back in time [px]."""

    centre: np.ndarray
    shift: np.ndarray
    growth: float

    def back(self, x: np.ndarray) -> np.ndarray:
        """Return where pixels (N, 2) of key frame k were in the one before."""
        return x + self.shift + self.growth * (x - self.centre)

    def on(self) -> '_Motion':
        """Return the same motion over one more pair."""
        return self._replace(centre=self.centre - self.shift)


@dataclass(frozen=True)
class _Silhouette:
    """Macroblocks of one mover."""

    # (M,) int64: when each was last inside the outline of the mover's blocks [ns]; NEVER: it is
    # not its
    seen: np.ndarray
    motion: _Motion


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
            own = (plane == id_) & (label == Label.MOVING)
            seen[_outline(own, size)] = stamp
            # What has a label of its own is none of the mover's.
            seen[~own & (label != Label.UNKNOWN)] = NEVER
            if np.any(seen != NEVER):
                known[id_] = _Silhouette(seen, motion)
                label[seen != NEVER], plane[seen != NEVER] = Label.MOVING, id_
        self._known = known
        return replace(extraction, macroblock_label=label, macroblock_plane=plane)

    def _motions(self, extraction, correspondences) -> dict[int, _Motion]:
        """Return the motion of each mover in view, and of those that were, as it was."""
        motions = {plane.id: _motion(extraction, correspondences, plane.id)
                   for plane in extraction.planes if plane.label is Label.MOVING}
        before = {id_: known.motion.on() for id_, known in self._known.items()}
        return before | {id_: motion for id_, motion in motions.items() if motion is not None}

    def _carried(self, id_, motion, size, stamp) -> np.ndarray:
        """Return when each macroblock was last in the outline of a mover that moved on."""
        columns, rows = grid_shape(*size)
        seen = np.full(columns * rows, NEVER, np.int64)
        before = self._known.get(id_)
        if before is None or len(before.seen) != len(seen):
            return seen
        origin = grid_index(motion.back(grid_centres(*size)), *size)
        seen[origin >= 0] = before.seen[origin[origin >= 0]]
        seen[(seen > stamp) | (stamp - seen >= LIFETIME)] = NEVER
        return seen


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


def _motion(extraction, correspondences, id_) -> _Motion | None:
    """Return the motion of a mover's blocks in the picture, lens and all; None: too few."""
    member = (extraction.plane_id == id_) & (extraction.label == Label.MOVING)
    if member.sum() < MIN_BLOCKS:
        return None
    x = correspondences.x_cur[member].astype(float)
    vector = correspondences.x_prev[member] - x
    shift, centre = np.median(vector, axis=0), x.mean(axis=0)
    off, left = x - centre, vector - shift
    length = np.linalg.norm(left, axis=1)
    good = length <= STRAY * np.median(length) + 1.0
    growth = np.sum((off * left)[good]) / (np.sum(off[good]**2) + WEAK**2)
    return _Motion(centre, shift, float(np.clip(growth, -0.5, 0.5)))


def _outline(own: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    """Return the macroblocks (M,) inside the convex outline of some."""
    columns, rows = grid_shape(*size)
    image = np.zeros((rows, columns), np.uint8)
    at = np.flatnonzero(own)
    if len(at):
        corners = np.stack([at % columns, at // columns], axis=1).astype(np.int32)
        cv2.fillConvexPoly(image, cv2.convexHull(corners), 1)
    return image.ravel() > 0
