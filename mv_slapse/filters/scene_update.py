"""Corrections of the scene filter: correspondences, ground height, standstill.

Correspondences enter through the joint cost of a pair, (10) of [MVO], as one normal equation: the
update is the maximum of the posterior, found by a few relinearised steps (an iterated EKF), and
each correspondence is used once.
"""

from mv_slapse.filters.scene_state import (
    observation_jacobian,
    plane_in_camera,
    plane_in_camera_jacobian,
    relative_motion,
    SceneState,
)
from mv_slapse.geometry import two_view
import numpy as np


def correspondences(state: SceneState, start: np.ndarray, pair: two_view.Pair, index: np.ndarray,
                    ids: list[int], relief: float, dependence: float, steps: int) -> SceneState:
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
    relief : float
        See two_view.plane_terms.
    dependence : float
        Correspondences that together tell as much as one independent one does.
    steps : int
        Relinearisations.

    Returns
    -------
    state : SceneState
        Updated values and covariance.
    """
    e, moved = start, state.moved(start)
    for step in range(steps):
        R, t = relative_motion(moved)
        planes = np.array([plane_in_camera(moved, id) for id in ids]).reshape(-1, 3)
        A, b, _ = two_view.normal_equations(pair, R, t, planes, index, relief,
                                            width=6.0 if step == 0 else 3.0)
        G = observation_jacobian(moved, ids)
        information, vector = G.T @ A @ G / dependence, G.T @ b / dependence
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


def linear(state: SceneState, innovation: np.ndarray, H: np.ndarray, noise: np.ndarray):
    """Update with a direct observation, Joseph form; returns the state and its NIS."""
    S = H @ state.P @ H.T + noise
    K = np.linalg.solve(S, H @ state.P).T
    nis = float(innovation @ np.linalg.solve(S, innovation))
    moved = state.moved(K @ innovation)
    I_KH = np.eye(state.size) - K @ H
    P = I_KH @ state.P @ I_KH.T + K @ noise @ K.T
    moved.error.P = 0.5 * (P + P.T)
    return moved, nis


def camera_height(state: SceneState, ground: int, height: float, sigma: float):
    """Update with the camera's height [m] above the ground plane, which sets the scale."""
    plane = plane_in_camera(state, ground)
    by_pose, by_plane = plane_in_camera_jacobian(state, ground)
    depth = 1 / np.linalg.norm(plane)
    by_camera_plane = -depth**3 * plane
    H = np.zeros((1, state.size))
    H[0, state.at('current')] = by_camera_plane @ by_pose
    H[0, state.at(ground)] = by_camera_plane @ by_plane
    return linear(state, np.array([height - depth]), H, np.eye(1) * sigma**2)


def mounting(state: SceneState, ground: int, sigma: float):
    """Update with the rigid mounting: the ground's normal in the camera stays as it is [rad]."""
    plane = plane_in_camera(state, ground)
    by_pose, by_plane = plane_in_camera_jacobian(state, ground)
    length = np.linalg.norm(plane)
    normal = plane / length
    by_camera_plane = (np.eye(3) - np.outer(normal, normal)) / length
    H = np.zeros((3, state.size))
    H[:, state.at('current')] = by_camera_plane @ by_pose
    H[:, state.at(ground)] = by_camera_plane @ by_plane
    H[:, state.at('mount')] = -np.eye(3)
    return linear(state, state.mount - normal, H, np.eye(3) * sigma**2)


def unit_baseline(state: SceneState, sigma: float):
    """Update with a distance of one between the two poses: the gauge where scale is free."""
    offset = state.current.t - state.previous.t
    length = np.linalg.norm(offset)
    H = np.zeros((1, state.size))
    H[0, state.at('current').start + 3:state.at('current').stop] = offset / length
    H[0, state.at('previous').start + 3:state.at('previous').stop] = -offset / length
    return linear(state, np.array([1 - length]), H, np.eye(1) * sigma**2)
