"""What the steps of one key frame pair's extraction hand on."""

from dataclasses import dataclass

from mv_slapse.geometry.blocks import count_macroblocks
from mv_slapse.motion.estimate import MotionFit
from mv_slapse.motion.observations import BlockObservations
from mv_slapse.records import Extraction, Label, PlaneObservation
from mv_slapse.surfaces.plane_search import PlaneFit
import numpy as np


@dataclass(frozen=True)
class Found:
    """What a key frame pair shows: motion, evidence of its blocks, planes, moving planes.

    ``doubtful`` blocks (N,) bool may belong to these.
    """

    fit: MotionFit
    evidence: BlockObservations
    planes: list[PlaneFit]
    moving: Extraction | None = None
    doubtful: np.ndarray | None = None


def labels(found: Found):
    """Return the label (N,) and the plane id (N,) of each block."""
    evidence = found.evidence
    label = np.full(len(evidence.rho), Label.UNKNOWN.value, np.int8)
    label[evidence.epipolar_inlier & ~evidence.backward] = Label.STATIONARY
    label[evidence.at_infinity] = Label.INFINITY
    plane_id = np.full(len(label), -1, np.int32)
    for plane in found.planes:
        plane_id[plane.member] = plane.id
    if found.moving is not None:
        moving = found.moving.label == Label.MOVING.value
        label[found.doubtful] = Label.UNKNOWN
        label[moving] = Label.MOVING
        own = moving | (found.moving.plane_id < -1) & (plane_id == -1)
        plane_id[own] = found.moving.plane_id[own]
    return label, plane_id


def observations(x_cur, found: Found):
    """Yield the stationary planes as records."""
    for plane in found.planes:
        yield PlaneObservation(plane.id, Label.STATIONARY, plane.plane, plane.covariance,
                               is_ground=plane.is_ground,
                               n_macroblocks=count_macroblocks(x_cur[plane.member]))
