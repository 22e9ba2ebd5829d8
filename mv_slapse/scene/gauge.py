"""A new local frame for a camera that has lost its heading.

An error of the heading turns the whole scene. Where it is large that is no longer linear, and
corrections, each linearised elsewhere, would seem to observe it: the covariance would shrink to
nothing. So the scene begins anew at the camera, and what is not known of the camera's pose there
turns and shifts all of it, for good: pairs relate cameras to each other, not to {W}.
"""

from mv_slapse.geometry import rotation
from mv_slapse.kernels.binding import compiled
from mv_slapse.scene.state import Gauge, SceneState, THETA, UNIT
import numpy as np

UNKNOWN_SCALE = 1.0  # of the log of lengths of which one is guessed: a speed may be any
LINEAR = 0.2  # rad: beyond, a sine departs from its angle by 1 %


def is_vague(state: SceneState) -> bool:
    """Tell whether the heading is too uncertain to be linear."""
    P = np.ascontiguousarray(state.P[THETA, THETA])
    return bool(P.trace() > LINEAR**2 and compiled.eigen_symmetric(P)[0][-1] > LINEAR**2)


def begin_anew(state: SceneState, is_metric: bool):
    """Let the state's errors begin at the current pose; there must be no planes.

    What is not known of the pose is the gauge's from now on, and where nothing else tells the
    scale, what is not known of the speed. The velocity in {W} was known, but not against the
    camera.
    """
    vel = state.at('velocity')
    swing, T = rotation.skew(state.velocity), np.eye(6)
    T[:3, :3] = state.current.R
    pose = T @ covariance(state, 'current') @ T.T
    v = state.velocity
    speed_sigma = float(np.sqrt(v @ state.error.covariance('velocity') @ v) / max(v @ v, 1e-9))
    scale = 0.0 if is_metric else min(speed_sigma, UNKNOWN_SCALE)  # of their logarithm
    known = state.gauge.covariance[-1, -1]  # of the unit so far, in which the speed is known
    P = np.zeros_like(state.P)
    for name in ('velocity', 'omega', 'mount', 'depth_scale', 'heave'):
        P[state.at(name), state.at(name)] = state.error.covariance(name)
    P[vel, vel] += swing @ pose[:3, :3] @ swing.T
    state.error.P, state.error.lasting = P, np.zeros_like(state.error.lasting)
    state.gauge = Gauge(state.current.t.copy(), np.pad(pose, (0, 1)))
    state.gauge.covariance[-1, -1] = known + scale**2


def doubt_scale(state: SceneState, sigma: float):
    """Let all lengths be unsure by a share of them, from where the scene has begun."""
    covariance = state.gauge.covariance
    covariance[6], covariance[:, 6] = 0, 0
    covariance[6, 6] = sigma**2


def covariance(state: SceneState, *names) -> np.ndarray:
    """Return the covariance of adjacent blocks of the state in {W}: of errors and of the gauge."""
    at = slice(state.at(names[0]).start, state.at(names[-1]).stop)
    J = np.concatenate([jacobian(state, name) for name in names])
    lasting = state.error.lasting[at]
    return state.P[at, at] + lasting @ lasting.T + J @ state.gauge.covariance @ J.T


def jacobian(state: SceneState, name) -> np.ndarray:
    """Return what the gauge's turn, shift and growth do to a block of the error state (., 7)."""
    if name in state.planes:
        known = state.planes[name]
        # The anchor stays where it is, and the plane moves against it.
        J = np.outer(known.plane, known.plane @ _moves(state, known.anchor))
        J[:, :3] -= rotation.skew(known.plane)
        J[:, 6] -= known.plane
        return J
    if name in ('previous', 'current'):
        pose = getattr(state, name)
        J = np.zeros((6, 7))
        J[:3, :3], J[3:] = pose.R.T, _moves(state, pose.t)
        return J
    J = np.zeros((state.at(name).stop - state.at(name).start, 7))
    if name == 'velocity':
        J[:, :3], J[:, 6] = -rotation.skew(state.velocity), state.velocity
    return J


def _moves(state: SceneState, X: np.ndarray) -> np.ndarray:
    """Return what they do to a point (3,) of {W}: (3, 7)."""
    offset = X - state.gauge.place
    moves = np.zeros((3, 7))
    moves[:, :3], moves[:, 3:6], moves[:, 6] = -rotation.skew(offset), UNIT, offset
    return moves
