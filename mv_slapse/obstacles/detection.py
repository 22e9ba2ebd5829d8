"""Moving planes of one key frame pair as observations of the obstacle filters, (16) of [MVO]."""

from collections.abc import Sequence
import dataclasses
from dataclasses import dataclass
from functools import cached_property
import math
from typing import NamedTuple

from mv_slapse.changed import replace
from mv_slapse.config import ObstacleSettings
from mv_slapse.geometry.blocks import COVERED, MACROBLOCK
from mv_slapse.geometry.camera import to_rays
from mv_slapse.kernels.binding import compiled
from mv_slapse.obstacles import motion_model as om
from mv_slapse.obstacles.view import View
from mv_slapse.records import Extraction, Label, PlaneHandover, PlaneObservation, ScalePrior
import numpy as np

OUTLINE_SHARE = 0.08  # of a region's size: how well its blocks show its middle
CUT_SHARE = 0.3  # the same, and of its depth, where the picture's edge cuts it off
TURN_SHARE = 0.015  # of its motion by a turn of the camera: 0.010 to 0.021 in six rendered spins
SHAPE_SHARE = 0.03  # of a rate: vehicles are no planes, and their faces move apart
MOST = 0.5  # share of what there is, blocks or a box, beyond which something is most of it
THINNEST = 0.25  # share of the most blocks in a row or column: a cabin has more of a body
SLIVER = 2.0  # px by which neighbouring blocks may overlap, as predicted
SHARES = np.array([MACROBLOCK, OUTLINE_SHARE, CUT_SHARE])


class Edge(NamedTuple):
    """Lower edge of a region, known to a block, from which its depth comes."""

    row: float  # [px]
    half: float  # the true edge lies within this many rows of it [px]
    drop: float  # rows below the horizon, f times the camera's height over the depth [px]

    def log_depth(self, value: float, rows: float) -> float:
        """Return what ln Z is if the edge lies ``rows`` lower, ``value`` if it lies here."""
        return value - math.log(max(1 + rows / self.drop, 0.1))


@dataclass(frozen=True)
class Detection:
    """A moving plane of one key frame pair."""

    id: int  # of the plane observation
    z: np.ndarray  # (8,): observed state as in motion_model
    R: np.ndarray  # (8, 8): its covariance
    has_depth: bool  # the depth is evidence; else a prior that only a new track may use
    x: np.ndarray  # (N, 2): centres [px]
    block: np.ndarray  # (N, 2): sizes of its blocks [px]
    scale_prior: ScalePrior
    edge: Edge  # where it meets the ground; only read where the depth is evidence
    score: float = 0.0  # how much rather its region moves than not, as of PlaneObservation
    # the rate is evidence; else only the place is, and an obstacle with no other coasts
    has_rate: bool = True
    called: bool = True  # moving by the labels; else they are half as sure

    @cached_property
    def box(self) -> np.ndarray:
        """Return x, y of the top left corner, width, height [px]."""
        return box_of(self.x, self.block)


def box_of(x: np.ndarray, block: np.ndarray) -> np.ndarray:
    """Return the box (4,) around blocks: top left corner, width, height [px]."""
    return compiled.region_box(x, block)


def inside(x: np.ndarray, box: np.ndarray) -> np.ndarray:
    """Return which pixels (N, 2) lie in a box (4,), (N,) bool."""
    within = (x >= box[:2]) & (x <= box[:2] + box[2:])
    return within[:, 0] & within[:, 1]


def body_box(x: np.ndarray, block: np.ndarray) -> np.ndarray:
    """Return the box (4,) between the first and last rows and columns that many blocks cover.

    What is behind or beside a vehicle joins it with single blocks, which move every edge of the
    box around them all.
    """
    return compiled.body_box(x, block, THINNEST, SLIVER)


def tiles(box: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return blocks (N, 2), (N, 2) that fill a box (4,), about as large as macroblocks [px]."""
    number = np.maximum(np.round(box[2:] / MACROBLOCK), 1).astype(int)
    size = box[2:] / number
    place = np.indices(number).reshape(2, -1).T
    return box[:2] + (place + 0.5) * size, np.tile(size, (len(place), 1))


def is_cut(box: np.ndarray, view: View) -> np.ndarray:
    """Return whether the picture's edge cuts a box (4,) off across and down, (2,) bool."""
    (x, y, width, height), (across, down), half = box.tolist(), view.size.tolist(), MACROBLOCK / 2
    return np.array([x < half or x + width > across - half, y < half or y + height > down - half])


def detections(extraction: Extraction, view: View, settings: ObstacleSettings) -> list[Detection]:
    """Return the planes of an extraction that move or may move, largest first."""
    found = []
    for plane in extraction.planes:
        if plane.label is Label.STATIONARY or plane.covariance.shape != (6, 6):
            continue
        item = _detection(plane, extraction, view, view.unit, settings)
        if item is not None:
            found.append(_on_ground(blurred(item, view, settings), view))
    return sorted(found, key=lambda item: (-len(item.x), item.id))


def from_handover(handover: PlaneHandover, extraction: Extraction, view: View,
                  settings: ObstacleSettings) -> Detection | None:
    """Return a plane handed over by the scene filter as the first detection of a track.

    Its blocks are those that the extraction counts to the plane, whatever their label; None
    where there are too few.
    """
    plane, by_plane = view.plane_to_cam(handover.plane)
    by_state = np.zeros((6, 6))
    by_state[:3, :3] = by_plane
    by_state[3:, 3:] = -view.dt * view.R_world_from_cam.T
    return _detection(PlaneObservation(
        handover.id, Label.MOVING, plane, by_state @ handover.covariance @ by_state.T,
        by_state[3:, 3:] @ handover.velocity, scale_prior=ScalePrior.GROUND_CONTACT),
        extraction, view, 1.0, settings)


def joined(group: Sequence[Detection], view: View) -> Detection:
    """Return the detection of a vehicle: the motion of its first surface, the blocks of all."""
    first = group[0]
    if len(group) == 1:
        return first
    x, block = (np.concatenate([getattr(item, name) for item in group]) for name in ('x', 'block'))
    return about(first, x, block, view)


def about(surface: Detection, x: np.ndarray, block: np.ndarray, view: View) -> Detection:
    """Return the detection of a motion about the middle of other blocks (N, 2), (N, 2)."""
    box = box_of(x, block)
    # All is made anew: what is kept of a detection is the box of its blocks.
    centre = to_rays(view.K, (box[:2] + box[2:] / 2)[None])[0, :2]
    z, R = compiled.state_about(surface.z, surface.R, centre)
    R[om.BEARING, om.BEARING] = bearing_covariance(box, block, view)
    return _on_ground(dataclasses.replace(surface, z=z, R=R, x=x, block=block), view)


def _detection(plane, extraction, view, unit, settings):
    """Return the Detection of a plane with lengths in a unit [map unit], None if behind it.

    It has the largest connected part of the plane's blocks, None where that is too small. A block
    missing inside a surface does not tear it apart.
    """
    x, block = compiled.largest_part(extraction.x_cur, extraction.block, extraction.plane_id,
                                     plane.id, MACROBLOCK)
    found = None if len(x) < settings.min_macroblocks else compiled.region_state(
        plane.plane, plane.t_d, plane.covariance, x, block,
        (view.K, view.t_cur_from_prev, view.dt, view.size, unit), SHARES, om.SLOPE_LIMIT, COVERED)
    if found is None:
        return None
    z, R, edge = found
    return Detection(plane.id, z, R, plane.scale_prior is ScalePrior.GROUND_CONTACT, x, block,
                     plane.scale_prior, Edge(*edge.tolist()), plane.score,
                     called=plane.label is Label.MOVING)


def bearing_covariance(box, block, view):
    """Return how well a box shows the ray (2,) of the middle of what it surrounds, (2, 2)."""
    return compiled.bearing_covariance(box, block, view.K, view.size, SHARES)


def blurred(detection, view, settings):
    """Return a detection with what all its vectors have in common in the rate's covariance.

    A bias of the encoder, which weighs more on the growth of a small region and grows with the
    camera's turn, the error of that, and the error of the plane.
    """
    return replace(detection, R=compiled.blurred_rate(
        detection.z, detection.R, float(detection.box[2:].min()),
        (view.K, view.R_cur_from_prev, view.rotation_covariance, view.dt),
        np.array([settings.vector_bias, MACROBLOCK, TURN_SHARE, SHAPE_SHARE])))


def _on_ground(detection, view):
    """Take the depth from the map's ground plane, which is steadier than the pair's own."""
    found = None if view.ground is None else compiled.depth_from_ground(
        detection.z, detection.R, detection.x, detection.block, view.K, view.ground,
        np.array([COVERED, MACROBLOCK, view.size[1], CUT_SHARE]))
    if found is None:
        return detection
    z, R, edge = found
    return replace(detection, z=z, R=R, has_depth=True, scale_prior=ScalePrior.GROUND_CONTACT,
                   edge=Edge(*edge.tolist()))
