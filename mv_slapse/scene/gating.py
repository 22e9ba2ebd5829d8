"""Which planes of the map a new extraction may correct."""

from mv_slapse.config import SceneSettings
from mv_slapse.filters import ekf
from mv_slapse.records import Extraction, Label, PlaneObservation
from mv_slapse.scene.state import (
    log_baseline,
    plane_in_camera,
    plane_in_camera_jacobian,
    relative_motion,
    relative_motion_jacobian,
    SceneState,
)
import numpy as np

RATIO_GATE = 10.8  # 99.9 % of chi-square with one degree of freedom


def ground_of(extraction: Extraction, trusted: set[int]) -> int | None:
    """Return the id of the ground, None where none of the trusted planes is it."""
    return next((plane.id for plane in extraction.planes
                 if plane.is_ground and plane.id in trusted), None)


def ground_plane(extraction: Extraction) -> np.ndarray | None:
    """Return the ground (3,) in camera k [1/baseline], None where it is not seen."""
    return next((plane.plane for plane in extraction.planes if plane.is_ground), None)


def distances(state: SceneState, extraction: Extraction,
              settings: SceneSettings) -> dict[int, float]:
    """Return the squared distance of each known plane from the predicted state, by its id."""
    return {plane.id: squared_distance(state, plane, settings) for plane in extraction.planes
            if plane.label == Label.STATIONARY and plane.id in state.planes}


def holds_length(state: SceneState, length: float, sigma: float) -> bool:
    """Tell whether a length of the way [map unit] agrees with the predicted one.

    ``sigma`` is its standard deviation as a share. Wheels that slip or stand contradict it.
    """
    value, H = log_baseline(state)
    variance = H @ state.error.total @ H + sigma**2
    return bool((value - np.log(length))**2 < RATIO_GATE * variance)


def squared_distance(state: SceneState, plane: PlaneObservation,
                     settings: SceneSettings) -> float:
    """Squared Mahalanobis distance between a plane seen and the map's, in baseline units.

    The observation is plane_in_camera * |t|: two views know a plane only up to their baseline.
    """
    in_camera = plane_in_camera(state, plane.id)
    by_pose, by_plane = plane_in_camera_jacobian(state, plane.id)
    _, t = relative_motion(state)
    length = np.linalg.norm(t)
    if length < 1e-9:
        return np.inf
    by_previous, by_current = relative_motion_jacobian(state)
    H = np.zeros((3, state.size))
    H[:, state.at(plane.id)] = by_plane * length
    direction = np.outer(in_camera, t / length)
    H[:, state.at('previous')] = direction @ by_previous[3:]
    H[:, state.at('current')] = by_pose * length + direction @ by_current[3:]
    biased = settings.depth_bias * plane.plane
    S = H @ state.P @ H.T + plane.covariance * settings.depth_dependence + np.outer(biased, biased)
    innovation = plane.plane - in_camera * length
    return ekf.squared_distance(innovation, S)
