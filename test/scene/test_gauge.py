"""A state that has lost its heading begins anew, and says as much."""

from copy import deepcopy

from mv_slapse.geometry import rotation
from mv_slapse.scene import gauge as scene_gauge
from mv_slapse.scene import state as scene_state
from mv_slapse.scene.state import AnchoredPlane, Gauge, Pose
from numeric import jacobian
import numpy as np
import pytest
from scene_drive import between_two_poses


@pytest.fixture
def state(rng):
    state = between_two_poses(rng)
    state.velocity = rng.normal(0, 5, 3)
    A = rng.normal(size=(state.size, state.size))
    state.error.P = 0.01 * A @ A.T
    state.error.lasting = 0.1 * rng.normal(size=state.error.lasting.shape)
    return state


def test_a_heading_is_vague_beyond_a_fifth_of_a_radian(state):
    at = state.at('current').start
    for sigma, vague in ((0.19, False), (0.21, True)):
        state.error.P[at:at + 3, at:at + 3] = np.diag([0.01, sigma, 0.01])**2
        assert scene_gauge.is_vague(state) is vague


def without_planes(state):
    for id_ in list(state.planes):
        state.remove_plane(id_)
    return state


def test_the_pose_is_as_uncertain_as_before_and_nothing_random_is_left_of_it(state):
    without_planes(state)
    before, omega = (scene_gauge.covariance(state, name) for name in ('current', 'omega'))
    scene_gauge.begin_anew(state, is_metric=True)
    np.testing.assert_allclose(scene_gauge.covariance(state, 'current'), before, atol=1e-12)
    assert not state.P[state.at('current')].any()
    np.testing.assert_array_equal(scene_gauge.covariance(state, 'omega'), omega)


def test_a_second_loss_adds_to_the_first(state):
    without_planes(state)
    scene_gauge.begin_anew(state, is_metric=True)
    first = scene_gauge.covariance(state, 'current')
    for _ in range(2):
        scene_state.propagate(state, 1.0, 0.5, 0.5, 0.5)
    before = scene_gauge.covariance(state, 'current')
    scene_gauge.begin_anew(state, is_metric=True)
    np.testing.assert_allclose(scene_gauge.covariance(state, 'current'), before, atol=1e-9)
    assert np.trace(before) > np.trace(first)


@pytest.mark.parametrize(('speed_sigma', 'scale'), [(1.0, 0.2), (50.0, 1.0)])
def test_a_free_scale_is_known_as_well_as_the_speed_but_a_metric_one_is_kept(
        state, speed_sigma, scale):
    without_planes(state)
    state.velocity, vel = np.array([0, 0, 5.0]), state.at('velocity')
    state.error.P[vel, vel], state.error.lasting[vel] = speed_sigma**2 * np.eye(3), 0
    for is_metric in (True, False):
        twin = deepcopy(state)
        scene_gauge.begin_anew(twin, is_metric)
        assert twin.gauge.covariance[6, 6]**0.5 == pytest.approx(0 if is_metric else scale)


def test_a_second_loss_at_a_free_scale_adds_to_what_the_first_left_unsure(state):
    without_planes(state)
    state.velocity, vel = np.array([0, 0, 5.0]), state.at('velocity')
    for sigma in (2.0, 1.0):
        state.error.P[vel, vel], state.error.lasting[vel] = sigma**2 * np.eye(3), 0
        scene_gauge.begin_anew(state, is_metric=False)
        state.velocity = np.array([0, 0, 5.0])
    # The second speed is as unsure as its own block says, and what the heading left of it.
    assert state.gauge.covariance[6, 6] >= 0.4**2 + 0.2**2 - 1e-12


def changed(state, g):
    """Return a state turned, shifted and grown about its gauge's place by g (7,)."""
    R, growth, place = rotation.exp(g[:3]), np.exp(g[6]), state.gauge.place

    def point(X):
        return place + g[3:6] + growth * R @ (X - place)

    other = deepcopy(state)
    other.previous, other.current = (Pose(R @ pose.R, point(pose.t))
                                     for pose in (state.previous, state.current))
    other.velocity = growth * R @ state.velocity
    for id_, known in state.planes.items():
        plane = R @ known.plane / growth
        offset = known.anchor - point(known.anchor)
        other.planes[id_] = AnchoredPlane(plane / (1 + plane @ offset), known.anchor)
    return other


def test_the_gauge_turns_shifts_and_scales_the_whole_scene(rng, state):
    state.gauge = Gauge(rng.normal(size=3))
    names = ('previous', 'current', 'velocity', 'omega', *state.planes)

    def error(g):
        other = changed(state, g)
        e = state.error_to(other)
        e[state.at('velocity')] = other.velocity - state.velocity
        for id_ in state.planes:
            e[state.at(id_)] = other.planes[id_].plane - state.planes[id_].plane
        return np.concatenate([e[state.at(name)] for name in names])

    J = np.vstack([scene_gauge.jacobian(state, name) for name in names])
    np.testing.assert_allclose(J, jacobian(error, np.zeros(7)), atol=1e-6)


def test_what_no_pair_can_tell_stays_however_far_the_scene_goes_on(state):
    """A turn and a shift at the beginning, carried along by a drive without errors of its own."""
    without_planes(state)
    scene_gauge.begin_anew(state, is_metric=True)
    state.error.P = np.zeros_like(state.P)
    turn = state.gauge.covariance[:3, :3]
    for _ in range(5):
        scene_state.propagate(state, 1.0, 0.0, 0.0, 1.0)
    found = scene_gauge.covariance(state, 'current')
    R, way = state.current.R, state.current.t - state.gauge.place
    np.testing.assert_allclose(R @ found[:3, :3] @ R.T, turn, atol=1e-12)
    T = np.c_[-rotation.skew(way), np.eye(3)]
    np.testing.assert_allclose(found[3:, 3:], T @ state.gauge.covariance[:6, :6] @ T.T)
