"""Where the labels miss an obstacle that is followed: its vectors, looked for where it must be.

Labels of one pair cannot tell a car that drives as fast as the camera from what is far off, nor a
slow one from noise. A track knows where the obstacle is and how it moves: blocks there that move
so are its own. They correct the rate and, weakly, the place; the depth is left to the labels.
"""

from mv_slapse.config import ObstacleSettings
from mv_slapse.filters import ekf
from mv_slapse.geometry.camera import to_rays
from mv_slapse.kernels.binding import compiled
from mv_slapse.obstacles import detection
from mv_slapse.obstacles import motion_model as om
from mv_slapse.obstacles.detection import Detection, Edge
from mv_slapse.obstacles.view import View
from mv_slapse.records import Extraction, Label, MotionStatus, ScalePrior
import numpy as np

LEAST_COVERED = 0.3  # share of its box, and of the lower half of that, that these must cover
ITERATIONS, COARSE = 8, 3  # of the reweighting, and of these with a wider kernel
FOLLOW = 0.3  # share by which the outline follows what is found
WEAK = 1e-6  # share of the prediction's information that counts as seen
FREE_SLOPE = 1.0  # standard deviation: vectors inside a box tell little of the slope


def found(mu: np.ndarray, P: np.ndarray, box: np.ndarray, extraction: Extraction, view: View,
          settings: ObstacleSettings) -> Detection | None:
    """Return a predicted obstacle's own blocks as a detection without depth, or None.

    ``mu`` (8,) and ``P`` (8, 8) are its predicted state, ``box`` (4,) that of its body in the
    picture [px]. The extraction's planes keep their blocks.
    """
    at = _free(extraction, box)
    if len(at) < settings.min_macroblocks:
        return None

    rays = to_rays(view.K, extraction.x_cur[at].astype(float))
    # Near are the blocks that move as predicted, as far as that is known, own those of them that
    # move as one. What lies behind an obstacle, or before it, may pass for its own by a prediction
    # that lags, as where it brakes; it does not agree with the rest.
    theta, covariance, near, own = compiled.redetect_rate(
        mu, view.dt**2 * P[om.RATE, om.RATE], rays, extraction.x_prev[at].astype(float),
        extraction.sigma[at].astype(float)**2 + settings.vector_bias**2, view.dt,
        (view.K, view.R_cur_from_prev),
        (ekf.chi2_bound(ekf.CONFIDENCE, 2), WEAK, ITERATIONS, COARSE))
    least = max(settings.min_macroblocks, detection.MOST * len(at))
    if not _fill(extraction, at[near], box, least):
        return None
    # What of the blocks is its own, and so how it moves, is not to be told where they disagree.
    agree = _fill(extraction, at[own], box, least)
    own = own if agree else near
    seen = detection.box_of(extraction.x_cur[at[own]].astype(float),
                            extraction.block[at[own]].astype(float))
    z, R = mu.copy(), np.diag(np.r_[0.0, 0.0, P[2, 2], np.zeros(3), np.full(2, FREE_SLOPE**2)])
    z[om.RATE], R[om.RATE, om.RATE] = theta / view.dt, covariance / view.dt**2
    z[om.BEARING] = to_rays(view.K, (seen[:2] + seen[2:] / 2)[None])[0, :2]
    x, block = detection.tiles(box + FOLLOW * (seen - box))
    R[om.BEARING, om.BEARING] = 4 * detection.bearing_covariance(seen, block, view)
    return detection.blurred(
        Detection(-1, z, R, False, x, block, ScalePrior.NONE, Edge(0.0, 0.0, 1.0),
                  has_rate=agree), view, settings)


def _free(extraction, box):
    """Return the blocks (M,) int inside a box that are on no plane and may be an obstacle's.

    To a camera that drives all may: what goes as fast looks stationary, and far off.
    """
    rests = (extraction.label == Label.STATIONARY.value) & (
        extraction.motion.status is MotionStatus.STANDSTILL)
    return np.flatnonzero(
        detection.inside(extraction.x_cur, box) & (extraction.plane_id < 0) & ~rests)


def _fill(extraction, own, box, number):
    """Tell whether blocks (M,) int are that many, and cover enough of a box and its lower half.

    What is far behind a car ahead moves as it does, but not where the car hides the road.
    """
    area = extraction.block[own].astype(float).prod(axis=1)
    low = extraction.x_cur[own, 1] > box[1] + box[3] / 2
    least = LEAST_COVERED * np.prod(box[2:])
    return bool(len(own) >= number and area.sum() >= least and area[low].sum() >= least / 2)
