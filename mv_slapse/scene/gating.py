"""Which planes of the map a new extraction may correct."""

from collections import Counter

from mv_slapse.config import SceneSettings
from mv_slapse.kernels.binding import compiled
from mv_slapse.records import Extraction, Label, PlaneObservation
from mv_slapse.scene.progress import PATIENCE
from mv_slapse.scene.state import log_baseline, SceneState
import numpy as np

CONTRADICTED = 'all known planes in view contradict the map'
SCALELESS = ('no known plane is in view: the direction of the way is observed, its length is '
             'predicted')
RATIO_GATE = 10.8  # 99.9 % of chi-square with one degree of freedom


def trusted(state: SceneState, extraction: Extraction, known: set[int],
            misses: Counter[int]) -> set[int]:
    """Return the planes seen that the update may use, and count what contradicts the map.

    One pair's plane is wrong far more often than the map's, so one that contradicts the map must
    do so for a while before it takes the other's place. ``known`` are those that do not, and
    ``misses`` counts how often in a row each plane has.
    """
    shown = {plane.id for plane in extraction.planes if plane.label == Label.STATIONARY}
    contradicting = shown & state.planes.keys() - known
    found = {id for id in shown if id not in contradicting or outlasts(misses, id)}
    misses.update(contradicting)
    for id in found:
        del misses[id]
    return found


def outlasts(misses: Counter[int], id: int) -> bool:
    """Tell whether a plane has contradicted the map for so long that it is believed next time."""
    return misses[id] >= PATIENCE


def ground_of(extraction: Extraction, trusted: set[int]) -> int | None:
    """Return the id of the ground, None where none of the trusted planes is it."""
    return next((plane.id for plane in extraction.planes
                 if plane.is_ground and plane.id in trusted), None)


def ground_seen(extraction: Extraction) -> PlaneObservation | None:
    """Return the ground, None where a pair does not show it."""
    return next((plane for plane in extraction.planes if plane.is_ground), None)


def distances(state: SceneState, extraction: Extraction,
              settings: SceneSettings) -> dict[int, float]:
    """Return the squared Mahalanobis distance of each known plane seen to the map's, by its id.

    The observation is plane_in_camera * |t|: two views know a plane only up to their baseline.
    Infinite where there is no baseline.
    """
    seen = [plane for plane in extraction.planes
            if plane.label == Label.STATIONARY and plane.id in state.planes]
    ids = [plane.id for plane in seen]
    shown = np.array([plane.plane for plane in seen]).reshape(-1, 3)
    biased = settings.depth_bias * shown
    noise = settings.depth_dependence * np.array([plane.covariance for plane in seen]).reshape(
        -1, 3, 3) + biased[:, :, None] * biased[:, None]
    found = compiled.scene_distances(*state.arrays, state.error.P, state.positions(ids), shown,
                                     noise.reshape(-1, 9))
    return dict(zip(ids, found.tolist(), strict=True))


def holds_length(state: SceneState, length: float, sigma: float) -> bool:
    """Tell whether a length of the way [map unit] agrees with the predicted one.

    ``sigma`` is its standard deviation as a share. Wheels that slip or stand contradict it.
    """
    value, H = log_baseline(state)
    variance = H @ state.error.total @ H + sigma**2
    return bool((value - np.log(length))**2 < RATIO_GATE * variance)
