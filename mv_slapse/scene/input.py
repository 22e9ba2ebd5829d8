"""What an extraction tells the scene filter: correspondences that count, the pose they show."""

from mv_slapse.geometry import two_view
from mv_slapse.kernels.binding import compiled
from mv_slapse.records import CameraMotion, Extraction
from mv_slapse.scene.state import Pose
import numpy as np


def stationary(extraction: Extraction) -> tuple[two_view.Pair, np.ndarray]:
    """Return the stationary correspondences and the plane id of each (N,).

    Off all planes a block counts only where it touches no macroblock of a mover: half of those are
    the mover's own, and one that drives ahead along the camera's way nearly keeps the epipolar
    geometry, so that the turn of each pair would lean by half a standard deviation. Most vectors
    around it must be still, too: a few of a mover's wrong vectors lie on their epipolar lines by
    chance, most often on those of a motion that leans already.
    """
    rays_cur, rays_prev, x_prev, sigma, plane_id = compiled.stationary_blocks(
        extraction.x_cur, extraction.x_prev, extraction.sigma, extraction.label,
        extraction.plane_id, extraction.K)
    return two_view.Pair(rays_cur, rays_prev, x_prev, sigma, extraction.K), plane_id


def shown(previous: Pose, motion: CameraMotion, baseline: float) -> Pose:
    """Return the pose that a pair shows after the previous one, its way so long [map unit]."""
    R_world_from_cam = previous.R @ motion.R_cur_from_prev.T
    return Pose(R_world_from_cam,
                previous.t - R_world_from_cam @ motion.t_cur_from_prev * baseline)
