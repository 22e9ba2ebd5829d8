"""Correction of the scene filter by all that a key frame pair tells at once.

Correspondences enter through the joint cost of a pair, (10) of [MVO], as one normal equation, and
direct observations beside them: the update is the maximum of the posterior, found by a few
relinearised steps (an iterated EKF). One after another they would each be linearised where the
ones before have led, and lengths, which a pair alone leaves open, would contradict each other.
"""

from collections.abc import Callable, Sequence
from typing import NamedTuple

from mv_slapse.config import SceneSettings
from mv_slapse.geometry import rotation, two_view
from mv_slapse.scene.observations import Observation, Observe
from mv_slapse.scene.state import (
    FOCAL,
    N_LASTING,
    observation_jacobian,
    PLACE,
    plane_in_camera,
    relative_motion,
    SceneState,
    stretched,
    TURN,
)
import numpy as np


class Information(NamedTuple):
    """Normal equations: matrix (n, n), vector (n,), and what lasting errors add to the vector."""

    matrix: np.ndarray
    vector: np.ndarray
    lasting: np.ndarray

    def joined(self, observation: Observation) -> 'Information':
        """Return it with one more observation."""
        weighted = np.linalg.solve(observation.noise, observation.H).T
        lasting = self.lasting
        if observation.lasting is not None:
            lasting = lasting + weighted @ observation.lasting
        return Information(self.matrix + weighted @ observation.H,
                           self.vector + weighted @ observation.innovation, lasting)


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
    def told(moved: SceneState, step: int) -> Information:
        """Return what the pair and the observations tell, linearised at a state."""
        return _joined(_of_pair(moved, pair, index, ids, settings, step == 0), moved, observations)

    return _settled(state, start, told, settings.iterations)


def observe(state: SceneState, observations: Sequence[Observe], iterations: int) -> SceneState:
    """Update with direct observations alone, where there are no correspondences."""
    nothing = Information(np.zeros((state.size, state.size)), np.zeros(state.size),
                          np.zeros((state.size, N_LASTING)))
    return _settled(state, np.zeros(state.size),
                    lambda moved, _: _joined(nothing, moved, observations), iterations)


def _joined(told: Information, state: SceneState, observations: Sequence[Observe]) -> Information:
    """Return it with direct observations of a state."""
    for observation in observations:
        told = told.joined(observation(state))
    return told


def _settled(state: SceneState, start: np.ndarray,
             tell: Callable[[SceneState, int], Information], iterations: int) -> SceneState:
    """Return the maximum of the posterior, found from an error at which to linearise first."""
    e, moved = start, state.moved(start)
    for step in range(iterations):
        told = tell(moved, step)
        of, gain = _gain(state.P, told)
        e_new = gain @ (told.vector + told.matrix @ e)[of]
        moved = state.moved(e_new)
        done, e = np.max(np.abs(e_new - e)) < 1e-6, e_new
        if done:
            break
    matrix, lasting = told.matrix[np.ix_(of, of)], moved.error.lasting
    # L P L^T + gain matrix gain^T with L = I - gain matrix: Joseph's form.
    P = state.P - gain @ (matrix @ state.P[of])
    P -= (P[:, of] - gain) @ matrix @ gain.T
    moved.error.P = 0.5 * (P + P.T)
    moved.error.lasting = lasting + gain @ (told.lasting[of] - matrix @ lasting[of])
    return moved


def _gain(P: np.ndarray, told: Information) -> tuple[np.ndarray, np.ndarray]:
    """Return which m elements of the state are told of, and the gain (n, m) of their information.

    The planes out of view are many, and nothing is told of them.
    """
    of = np.flatnonzero(told.matrix.any(axis=0))
    seen = np.eye(len(of)) + told.matrix[np.ix_(of, of)] @ P[np.ix_(of, of)]
    return of, np.linalg.solve(seen.T, P[of]).T


def _of_pair(state: SceneState, pair, index, ids, settings: SceneSettings, first: bool):
    """Return the Information of the correspondences at a state."""
    R, t = relative_motion(state)
    planes = np.array([plane_in_camera(state, id) for id in ids]).reshape(-1, 3)
    A, b, _ = two_view.normal_equations(
        pair, R, t, planes, index, settings.relief, width=6.0 if first else 3.0,
        bias=settings.depth_bias, offset=settings.vector_bias,
        dependence=(settings.dependence, settings.depth_dependence))
    G, focal = observation_jacobian(state, ids), pair.focal.mean()
    lasting = np.zeros((state.size, N_LASTING))
    lasting[:, TURN] = G.T @ A[:, :3] * settings.vector_bias / focal
    longer = np.r_[rotation.log(R), t, -planes.ravel()].reshape(-1, 3)
    lasting[:, FOCAL] = G.T @ (A @ stretched(longer).ravel()) * settings.focal_sigma
    lasting[:, PLACE] = G.T @ (A @ _displaced(R, t, planes)) * settings.place_bias / focal
    return Information(G.T @ A @ G, G.T @ b, lasting)


def _displaced(R, t, planes) -> np.ndarray:
    """Return what (w, t, planes) become where vectors tell of a point beside their block's middle.

    By one focal length to the right, or down. All of the picture is then displaced, but for what
    its size makes of second order, as if the camera looked the other way by that angle.
    """
    angles = np.array([[0.0, -1.0], [1.0, 0.0], [0.0, 0.0]])
    return np.vstack([R - np.eye(3), *map(rotation.skew, (t, *planes))]) @ angles
