"""The state of the scene filter written down as a record: estimate."""

from mv_slapse.geometry.rotation import norm
from mv_slapse.records import MapPlane, ScaleStatus, SceneEstimate, TrackingStatus
from mv_slapse.scene import gauge as scene_gauge
from mv_slapse.scene.progress import Progress
from mv_slapse.scene.scale.rest import ABRUPT, DRIVEN
from mv_slapse.scene.state import SceneState, UNIT
import numpy as np


def estimate(state: SceneState, planes: tuple[MapPlane, ...], stamp: int, status: TrackingStatus,
             reason: str, progress: Progress) -> SceneEstimate:
    """Return the record of a state and of its map, and of how it came about."""
    # The state has the rotation first, about the camera's axes; the record about those of {W}.
    turn = np.zeros((6, 6))
    turn[:3, 3:], turn[3:, :3] = UNIT, state.current.R
    pose = turn @ scene_gauge.covariance(state, 'current') @ turn.T
    found = SceneEstimate(
        stamp, status, reason, state.current.R.copy(), state.current.t.copy(), pose,
        state.velocity.copy(), state.omega.copy(),
        scene_gauge.covariance(state, 'velocity', 'omega'),
        ScaleStatus.METRIC if progress.metric else ScaleStatus.UNKNOWN, progress.source, planes,
        norm(state.current.t - state.previous.t), progress.resets, progress.repairs,
        progress.unit)
    return progress.stop.doubted(found) if reason in (ABRUPT, DRIVEN) else found
