"""Correction of the scene filter by all that a key frame pair tells at once.

Correspondences enter through the joint cost of a pair, (10) of [MVO], as one normal equation, and
direct observations beside them: the update is the maximum of the posterior, found by a few
relinearised steps (an iterated EKF). One after another they would each be linearised where the
ones before have led, and lengths, which a pair alone leaves open, would contradict each other.
"""

from collections.abc import Sequence

from mv_slapse.config import SceneSettings
from mv_slapse.filters.scene_observations import Observe
from mv_slapse.filters.scene_state import (
    observation_jacobian,
    plane_in_camera,
    relative_motion,
    SceneState,
)
from mv_slapse.geometry import two_view
import numpy as np


def update(state: SceneState, start: np.ndarray, pair: two_view.Pair, index: np.ndarray,
           ids: list[int], settings: SceneSettings,
           observations: Sequence[Observe] = ()) -> SceneState:
    """Update with the correspondences of one key frame pair, (19) of [SLAPSE].

    Parameters
    ----------
    state : SceneState
        Predicted state, with every plane of ``ids``.
    start : (n,) array
        Error at which to linearise first, see SceneState.error_to.
    pair : Pair
        Stationary correspondences.
    index : (N,) int array
        Position in ``ids`` of the plane of each correspondence, -1 for none.
    settings : SceneSettings
    observations : sequence of functions
        What else is known, see filters.scene_observations.

    Returns
    -------
    state : SceneState
        Updated values and covariance.
    """
    e, moved = start, state.moved(start)
    for step in range(settings.iterations):
        information, vector = _of_pair(moved, pair, index, ids, settings, step == 0)
        for observe in observations:
            innovation, H, noise = observe(moved)
            weighted = np.linalg.solve(noise, H).T
            information, vector = information + weighted @ H, vector + weighted @ innovation
        L = np.linalg.inv(np.eye(state.size) + state.P @ information)
        e_new = L @ state.P @ (vector + information @ e)
        moved = state.moved(e_new)
        done, e = np.max(np.abs(e_new - e)) < 1e-6, e_new
        if done:
            break
    gain = L @ state.P
    P = gain @ L.T + gain @ information @ gain.T
    moved.error.P = 0.5 * (P + P.T)
    return moved


def _of_pair(state: SceneState, pair, index, ids, settings: SceneSettings, first: bool):
    """Return information (n, n) and vector (n,) of the correspondences at a state."""
    R, t = relative_motion(state)
    planes = np.array([plane_in_camera(state, id) for id in ids]).reshape(-1, 3)
    A, b, _ = two_view.normal_equations(
        pair, R, t, planes, index, settings.relief, width=6.0 if first else 3.0,
        bias=settings.depth_bias, dependence=settings.dependence)
    G = observation_jacobian(state, ids)
    return G.T @ A @ G, G.T @ b
