"""The state of the scene filter written down as a record: estimate."""

from mv_slapse.filters.scene_state import SceneState
from mv_slapse.records import MapPlane, ScaleStatus, SceneEstimate, TrackingStatus
import numpy as np


def estimate(state: SceneState, planes: tuple[MapPlane, ...], stamp: int, status: TrackingStatus,
             reason: str, metric: bool) -> SceneEstimate:
    """Return the record of a state and of its map; ``metric``: whether lengths are metres."""
    P, cur = state.error.total, state.at('current')
    order = np.r_[cur.start + 3:cur.stop, cur.start:cur.start + 3]
    # Errors turn about the camera's axes in the state, about those of {W} in the record.
    turn = np.eye(6)
    turn[3:, 3:] = state.current.R
    rates = np.r_[state.at('velocity'), state.at('omega')]
    return SceneEstimate(
        stamp, status, reason, state.current.R.copy(), state.current.t.copy(),
        turn @ P[np.ix_(order, order)] @ turn.T, state.velocity.copy(), state.omega.copy(),
        P[np.ix_(rates, rates)], ScaleStatus.METRIC if metric else ScaleStatus.UNKNOWN,
        'camera height' if metric else 'first translation', planes,
        float(np.linalg.norm(state.current.t - state.previous.t)))
