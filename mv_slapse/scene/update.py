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
from mv_slapse.scene import observations as scene_observations
from mv_slapse.scene.observations import Observation
from mv_slapse.scene.state import SceneState
import numpy as np


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

