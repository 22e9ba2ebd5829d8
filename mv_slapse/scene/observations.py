"""What the scene filter observes beside correspondences: lengths, mounting, course.

Each function takes a state and returns an Observation of it, linearised there.
"""

from collections.abc import Callable
from functools import partial
from typing import NamedTuple

from mv_slapse.config import SceneSettings
from mv_slapse.scene.state import (
    HEIGHT,
    log_baseline,
    N_LASTING,
    plane_in_camera,
    plane_in_camera_jacobian,
    relative_motion,
    relative_motion_jacobian,
    SceneState,
    SPEED,
)
import numpy as np

PAIR_HEIGHT = 1e-3  # share of the height by which a pair errs besides: crown and ruts


class Observation(NamedTuple):
    """Innovation z - h (m,), derivative H of h (m, n) by the error state, noise (m, m).

    ``lasting`` (m, N_LASTING) is what one standard deviation of each lasting error does to z.
    """

    innovation: np.ndarray
    H: np.ndarray
    noise: np.ndarray
    lasting: np.ndarray | None = None


Observe = Callable[[SceneState], Observation]


def mounted(ground: int, settings: SceneSettings, lasting: np.ndarray) -> list[Observe]:
    """Return what is known of a camera that is mounted on a ground vehicle.

    ``ground`` is the plane it drives on, ``lasting`` (N_LASTING,) what errors that last do to its
    height, as shares of it.
    """
    height = settings.camera_height
    return [partial(camera_height, ground=ground, height=height, sigma=PAIR_HEIGHT * height,
                    lasting=lasting * height),
            partial(mounting, ground=ground, sigma=settings.mounting_sigma),
            partial(level_course, sigma=settings.course_sigma)]


def camera_height(state: SceneState, ground: int, height: float, sigma: float,
                  lasting: np.ndarray | float = 0.0) -> Observation:
    """Observe the camera's height [m] above the ground plane, which sets the scale.

    The height swings about its mean (see SceneState.heave).

    Parameters
    ----------
    state, ground : SceneState, int
    height, sigma : float
        The mean height and the error of one pair [m].
    lasting : (N_LASTING,) array or float
        What each lasting error does to the height [m]; a float: what of it is wrong for good.
    """
    depth, relative = height_above(state, ground)
    H = depth * relative[None]
    H[0, state.at('heave')] = -height
    error = np.zeros((1, N_LASTING))
    error[0, slice(None) if np.ndim(lasting) else HEIGHT] = lasting
    innovation = np.array([height * (1 + state.heave) - depth])
    return Observation(innovation, H, np.eye(1) * sigma**2, error)


def height_above(state: SceneState, ground: int) -> tuple[float, np.ndarray]:
    """Return the camera's height above a plane of the map, and the derivative (n,) of its log."""
    plane = plane_in_camera(state, ground)
    by_pose, by_plane = plane_in_camera_jacobian(state, ground)
    upward, H = -plane / (plane @ plane), np.zeros(state.size)
    H[state.at('current')], H[state.at(ground)] = upward @ by_pose, upward @ by_plane
    return float(1 / np.linalg.norm(plane)), H


def mounting(state: SceneState, ground: int, sigma: float) -> Observation:
    """Observe the rigid mounting: the ground's normal in the camera stays as it is [rad]."""
    plane = plane_in_camera(state, ground)
    by_pose, by_plane = plane_in_camera_jacobian(state, ground)
    length = np.linalg.norm(plane)
    normal = plane / length
    by_camera_plane = (np.eye(3) - np.outer(normal, normal)) / length
    H = np.zeros((3, state.size))
    H[:, state.at('current')] = by_camera_plane @ by_pose
    H[:, state.at(ground)] = by_camera_plane @ by_plane
    H[:, state.at('mount')] = -np.eye(3)
    return Observation(state.mount - normal, H, np.eye(3) * sigma**2)


def baseline(state: SceneState, length: float, sigma: float,
             lasting: float = 0.0) -> Observation:
    """Observe the distance between the two poses [map unit] but for sigma, a share of it.

    Where the scale is free the first one is the gauge: 1. ``lasting`` is the share by which a
    speed that tells it is wrong for good.
    """
    value, H = log_baseline(state)
    error = np.zeros((1, N_LASTING))
    error[0, SPEED] = lasting
    return Observation(np.array([np.log(length) - value]), H[None], np.eye(1) * sigma**2, error)


def level_course(state: SceneState, sigma: float) -> Observation:
    """Observe that a vehicle's course lies in the ground: mount . t = 0 but for sigma [rad]."""
    R, t = relative_motion(state)
    length = np.linalg.norm(t)
    by_previous, by_current = relative_motion_jacobian(state)
    direction = t / length
    by_t = (state.mount - (state.mount @ direction) * direction) / length
    H = np.zeros((1, state.size))
    H[0, state.at('previous')] = by_t @ by_previous[3:]
    H[0, state.at('current')] = by_t @ by_current[3:]
    H[0, state.at('mount')] = direction
    return Observation(np.array([-state.mount @ direction]), H, np.eye(1) * sigma**2)
