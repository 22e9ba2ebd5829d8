"""Which planes may correct the map, against a distance worked out numerically."""

from dataclasses import replace
from types import SimpleNamespace

import made_up
from mv_slapse.config import SceneSettings
from mv_slapse.geometry import rotation
from mv_slapse.records import Label, PlaneObservation
from mv_slapse.scene import gating as scene_gate
from mv_slapse.scene import state as scene_state
from mv_slapse.scene.state import AnchoredPlane, Pose
from numeric import jacobian
import numpy as np
import pytest

SETTINGS = SceneSettings()


@pytest.fixture
def state(rng):
    state = scene_state.start(np.array([0, -1.0, 0]), 1.0, 0.1, 0.05)
    state.current = Pose(rotation.exp([0, 0.02, 0.01]), np.array([0.1, 0, 1.2]))
    state.add_plane(4, AnchoredPlane(np.array([0.2, 0.01, -0.03]), np.zeros(3)), np.eye(3))
    A = rng.normal(size=(state.size, state.size))
    state.error.P = 1e-4 * A @ A.T
    return state


def in_baselines(state):
    """Return what two views would see of plane 4: n / d times their baseline."""
    return scene_state.plane_in_camera(state, 4) * np.linalg.norm(
        state.current.t - state.previous.t)


def seen(state, offset=0.0, **changed):
    return PlaneObservation(**{'id': 4, 'label': Label.STATIONARY,
                               'plane': in_baselines(state) + offset,
                               'covariance': 1e-6 * np.eye(3), **changed})


def distance_of(state, plane):
    return scene_gate.distances(state, SimpleNamespace(planes=[plane]), SETTINGS)[plane.id]


def test_what_is_predicted_is_at_no_distance(state):
    assert distance_of(state, seen(state)) == pytest.approx(0, abs=1e-9)


def test_distance_is_that_of_the_numerical_derivative(rng, state):
    plane = seen(state, rng.normal(0, 0.02, 3))
    H = jacobian(lambda e: in_baselines(state.moved(e)), np.zeros(state.size))
    bias = SETTINGS.depth_bias * plane.plane
    S = (H @ state.P @ H.T + SETTINGS.depth_dependence * plane.covariance + np.outer(bias, bias))
    innovation = plane.plane - in_baselines(state)
    assert distance_of(state, plane) == pytest.approx(
        innovation @ np.linalg.solve(S, innovation), rel=1e-5)


def test_without_a_baseline_nothing_can_be_compared(state):
    state.current.t = state.previous.t.copy()
    assert distance_of(state, seen(state)) == np.inf


def test_only_known_stationary_planes_have_a_distance(rng, state):
    far = seen(state, 50.0)
    extraction = made_up.extraction(rng)
    for plane, expected in ((seen(state), [4]), (far, [4]), (replace(seen(state), id=5), []),
                            (seen(state, label=Label.MOVING), [])):
        found = scene_gate.distances(state, replace(extraction, planes=(plane,)), SETTINGS)
        assert list(found) == expected
        assert all(found[id_] == distance_of(state, plane)
                   for id_ in expected)
    assert distance_of(state, far) > SETTINGS.gate


def test_the_ground_is_named_where_it_is_seen(rng, state):
    wall, floor = seen(state), replace(seen(state), id=8, is_ground=True)
    extraction = replace(made_up.extraction(rng), planes=(wall, floor))
    assert scene_gate.ground_of(extraction, {8}) == 8
    assert scene_gate.ground_of(extraction, {wall.id}) is None
    assert scene_gate.ground_seen(extraction) is floor
    without = replace(extraction, planes=(wall,))
    assert scene_gate.ground_of(without, {8}) is None
    assert scene_gate.ground_seen(without) is None
