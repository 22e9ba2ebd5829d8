"""Correction of the scene filter by all that a key frame pair tells at once.

Correspondences enter through the joint cost of a pair, (10) of [MVO], as one normal equation, and
direct observations beside them: the update is the maximum of the posterior, found by a few
relinearised steps (an iterated EKF). One after another they would each be linearised where the
ones before have led, and lengths, which a pair alone leaves open, would contradict each other.
"""

from collections.abc import Sequence

from mv_slapse.config import SceneSettings
from mv_slapse.geometry import two_view
from mv_slapse.kernels.binding import compiled
from mv_slapse.records import CameraMotion, Extraction
from mv_slapse.scene import observations as scene_observations
from mv_slapse.scene.observations import Observation
from mv_slapse.scene.state import Pose, SceneState
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


def update(state: SceneState, start: np.ndarray, pair: two_view.Pair | None,
           planes: tuple[np.ndarray, list[int]], settings: SceneSettings,
           observations: Sequence[Observation] = ()) -> SceneState:
    """Update with the correspondences of one key frame pair, (19) of [SLAPSE].

    ``start`` (n,) is the error at which to linearise first, see SceneState.error_to. ``planes``
    are an index (N,) and ids, all in the predicted state: the position in the ids of the plane of
    each stationary correspondence of the pair, if there is one, -1 for none. ``observations`` are
    what else is known.
    """
    index, ids = planes
    given = None if pair is None else (pair.rays_cur, pair.rays_prev, pair.sigma, index,
                                       pair.focal)
    leaning = settings.mover_bias * np.array([1.0, 1.0 if pair is None else pair.roll_arm])
    options = np.array([settings.relief, settings.dependence, settings.depth_dependence,
                        settings.depth_bias, *np.hypot(settings.vector_bias, leaning),
                        settings.focal_sigma, settings.place_bias, settings.iterations], float)
    e, P, lasting = compiled.scene_update(
        *state.arrays, state.error.P, state.error.lasting, start, given, state.positions(ids),
        scene_observations.rows(observations, state), options)
    moved = state.moved(e)
    moved.error.P, moved.error.lasting = P, lasting
    return moved


def observe(state: SceneState, observations: Sequence[Observation],
            settings: SceneSettings) -> SceneState:
    """Update with direct observations alone, where there are no correspondences."""
    return update(state, np.zeros(state.size), None, (np.zeros(0, np.int64), []), settings,
                  observations)

