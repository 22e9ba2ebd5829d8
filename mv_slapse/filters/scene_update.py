"""Corrections of the scene filter: correspondences, ground height, standstill.

Correspondences enter through the joint cost of a pair, (10) of [MVO], as one normal equation: the
update is the maximum of the posterior, found by a few relinearised steps (an iterated EKF), and
each correspondence is used once.
"""

from mv_slapse.config import SceneSettings
from mv_slapse.filters import ekf
from mv_slapse.filters.scene_state import (
    log_baseline,
    observation_jacobian,
    plane_in_camera,
    plane_in_camera_jacobian,
    relative_motion,
    relative_motion_jacobian,
    SceneState,
)
from mv_slapse.geometry import two_view
import numpy as np


def correspondences(state: SceneState, start: np.ndarray, pair: two_view.Pair, index: np.ndarray,
                    ids: list[int], settings: SceneSettings) -> SceneState:
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

    Returns
    -------
    state : SceneState
        Updated values and covariance.
    """
    e, moved = start, state.moved(start)
    for step in range(settings.iterations):
        R, t = relative_motion(moved)
        planes = np.array([plane_in_camera(moved, id) for id in ids]).reshape(-1, 3)
        A, b, _ = two_view.normal_equations(
            pair, R, t, planes, index, settings.relief, width=6.0 if step == 0 else 3.0,
            bias=settings.depth_bias, dependence=settings.dependence)
        G = observation_jacobian(moved, ids)
        information, vector = G.T @ A @ G, G.T @ b
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
    nis = ekf.squared_distance(innovation, H @ state.P @ H.T + noise)
    ekf.update(state.error, innovation, H, noise)
    moved = state.moved(state.error.mu)
    moved.error.mu = np.zeros(state.size)
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


def baseline_ratio(state: SceneState, log_ratio: float, ratio_sigma: float, sigma: float):
    """Update with log(|t| now / |t| of the pair before), see planes.scale.

    The depths of the pair before have a common error, which this ratio holds with the opposite
    sign of the next: such errors must not add up. So the scale of the depths is a state, moved by
    the ratio, and the baseline equals it but for the pair's own common error.

    Parameters
    ----------
    log_ratio, ratio_sigma : float
        The ratio and its sampling error.
    sigma : float
        Common error of the depths of one pair, as a share.
    """
    at = state.at('depth_scale')
    state.depth_scale += log_ratio
    state.error.P[at, at] += ratio_sigma**2
    value, H = log_baseline(state)
    H = -H
    H[at] = 1
    return linear(state, np.array([value - state.depth_scale]), H[None], np.eye(1) * sigma**2)


def level_course(state: SceneState, sigma: float):
    """Update with a vehicle's course lying in the ground: mount . t = 0 but for sigma [rad]."""
    R, t = relative_motion(state)
    length = np.linalg.norm(t)
    by_previous, by_current = relative_motion_jacobian(state)
    direction = t / length
    by_t = (state.mount - (state.mount @ direction) * direction) / length
    H = np.zeros((1, state.size))
    H[0, state.at('previous')] = by_t @ by_previous[3:]
    H[0, state.at('current')] = by_t @ by_current[3:]
    H[0, state.at('mount')] = direction
    return linear(state, np.array([-state.mount @ direction]), H, np.eye(1) * sigma**2)
