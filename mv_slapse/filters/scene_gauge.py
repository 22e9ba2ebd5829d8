"""A new local frame for a camera that has lost its heading.

An error of the heading turns the whole scene. Where it is large that is no longer linear, and
corrections, each linearised elsewhere, would seem to observe it: the covariance would shrink to
nothing. So the scene begins anew at the camera, and what is not known of the camera's pose there
becomes an error that lasts.
"""

from mv_slapse.filters.scene_state import GAUGE, SceneState
from mv_slapse.geometry import rotation
import numpy as np

LINEAR = 0.2  # rad: beyond, a sine departs from its angle by 1 %


def is_vague(state: SceneState) -> bool:
    """Tell whether the heading is too uncertain to be linear."""
    cur = state.at('current').start
    return bool(np.linalg.eigvalsh(state.P[cur:cur + 3, cur:cur + 3])[-1] > LINEAR**2)


def begin_anew(state: SceneState):
    """Let the state's random errors begin at the current pose; there must be no planes.

    The pose's own errors turn and shift all that follows (``lasting``). The velocity in {W} was
    known, but not against the camera.
    """
    total, R, cur = state.error.total, state.current.R, state.at('current')
    T = np.eye(6)
    T[:3, :3] = R
    pose = T @ total[cur, cur] @ T.T
    vel, swing = state.at('velocity'), rotation.skew(state.velocity)
    P = np.zeros_like(total)
    for name in ('velocity', 'omega', 'mount', 'depth_scale', 'heave'):
        at = state.at(name)
        P[at, at] = total[at, at]
    P[vel, vel] += swing @ pose[:3, :3] @ swing.T
    value, vector = np.linalg.eigh(pose)
    columns = T.T @ (vector * np.sqrt(np.maximum(value, 0)))
    lasting = np.zeros_like(state.error.lasting)
    lasting[cur, GAUGE] = columns
    lasting[vel, GAUGE] = -swing @ R @ columns[:3]
    state.error.P, state.error.lasting = P, lasting
