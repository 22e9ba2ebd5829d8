"""The scene's state: every derivative against its numerical twin, by the state's own errors."""

from copy import deepcopy

import formulas
from kernels.scene_reference import observation_jacobian
from mv_slapse.config import SceneSettings
from mv_slapse.geometry import plane as plane_geometry
from mv_slapse.geometry import rotation
from mv_slapse.scene import state as scene_state
from mv_slapse.scene.state import AnchoredPlane
from numeric import jacobian
import numpy as np
import pytest
from scene_drive import between_two_poses

IDS = [4, 9]
SWAYS = SceneSettings(camera_height_sigma=0.02, camera_height_time=0.3)


def error_between(old, new):
    """Return the error (n,) that takes one state's values to another's."""
    e = old.error_to(new)
    for name in ('velocity', 'omega', 'mount'):
        e[old.at(name)] = getattr(new, name) - getattr(old, name)
    for name in ('depth_scale', 'heave'):
        e[old.at(name)] = getattr(new, name) - getattr(old, name)
    for id_ in old.planes:
        e[old.at(id_)] = new.planes[id_].plane - old.planes[id_].plane
    return e


@pytest.fixture
def state(rng):
    state = between_two_poses(rng)
    state.velocity, state.omega = rng.normal(0, 5, 3), rng.normal(0, 0.1, 3)
    for id_ in IDS:
        state.add_plane(id_, AnchoredPlane(rng.normal(0, 0.1, 3), rng.normal(0, 2, 3)), np.eye(3))
    A = rng.normal(size=(state.size, state.size))
    state.error.P = A @ A.T
    return state


def test_at_the_start_the_pose_is_that_of_the_world_and_certain():
    state = scene_state.start(np.array([0, -1.0, 0]), 100.0, 1.0, 0.07)
    for name in ('previous', 'current'):
        np.testing.assert_array_equal(getattr(state, name).R, np.eye(3))
        np.testing.assert_array_equal(getattr(state, name).t, 0)
        assert not state.error.covariance(name).any()
    np.testing.assert_array_equal(state.error.covariance('velocity'), 1e4 * np.eye(3))
    np.testing.assert_array_equal(state.error.covariance('omega'), np.eye(3))
    assert state.size == 6 + 6 + 3 + 3 + 3 + 1 + 1


def test_moving_by_an_error_undoes_the_error_between(rng, state):
    e = rng.normal(0, 0.1, state.size)
    e[state.at('mount')] = 0  # renormalised: tested by itself
    moved = state.moved(e)
    np.testing.assert_allclose(error_between(state, moved), e, atol=1e-12)
    np.testing.assert_allclose(moved.current.R,
                               state.current.R @ rotation.exp(e[state.at('current')][:3]))
    assert moved.planes[4].anchor is state.planes[4].anchor


def test_a_moved_mount_stays_a_unit_vector(rng, state):
    moved = state.moved(rng.normal(0, 0.1, state.size))
    assert np.linalg.norm(moved.mount) == pytest.approx(1)
    assert moved.mount @ state.mount < 1


def test_planes_come_and_go_without_touching_the_rest(state):
    before, size = state.P.copy(), state.size
    state.add_plane(77, AnchoredPlane(np.ones(3), np.zeros(3)), 2 * np.eye(3))
    assert state.size == size + 3
    assert not state.error.P[state.at(77), state.at('current')].any()
    state.remove_plane(77)
    np.testing.assert_array_equal(state.P, before)
    assert set(state.planes) == set(IDS)


def test_propagation_moves_the_pose_by_the_velocities(state):
    current, velocity, omega = state.current.copy(), state.velocity.copy(), state.omega.copy()
    scene_state.propagate(state, 0.2, 0.0, 0.0, 1.0)
    np.testing.assert_array_equal(state.previous.R, current.R)
    np.testing.assert_array_equal(state.previous.t, current.t)
    np.testing.assert_allclose(state.current.t, current.t + 0.2 * velocity)
    np.testing.assert_allclose(state.current.R, current.R @ rotation.exp(0.2 * omega))


def test_propagated_covariance_is_that_of_the_numerical_transition(state):
    dt, P = 0.1, state.P.copy()

    def propagated(e):
        twin = deepcopy(state).moved(e)
        twin.error = deepcopy(state).error
        scene_state.propagate(twin, dt, 0.0, 0.0, 1.0)
        return twin

    nominal = propagated(np.zeros(state.size))
    F = jacobian(lambda e: error_between(nominal, propagated(e)), np.zeros(state.size))
    F[state.at('mount'), state.at('mount')] = np.eye(3)
    # The turn by omega dt is linearised to first order: half its angle, here under 1.5 %, of dt.
    scene_state.propagate(state, dt, 0.0, 0.0, 1.0)
    scale = np.sqrt(np.outer(np.diag(F @ P @ F.T), np.diag(F @ P @ F.T)))
    np.testing.assert_allclose(state.P / scale, F @ P @ F.T / scale, atol=5e-3)


def test_noise_is_that_of_many_small_steps(rng, state):
    state.omega = np.zeros(3)
    state.error.P = np.zeros_like(state.P)
    fine = deepcopy(state)
    scene_state.propagate(state, 0.3, 0.7, 0.4, 0.6)
    for _ in range(300):
        scene_state.propagate(fine, 0.001, 0.7, 0.4, 0.6)
    keep = np.r_[6:18]
    np.testing.assert_allclose(state.P[np.ix_(keep, keep)], fine.P[np.ix_(keep, keep)],
                               rtol=1e-2, atol=1e-9)
    assert state.P[9, 9] == pytest.approx(0.7**2 * 0.3**3 / 3)


def test_points_on_a_plane_lie_on_it_in_the_camera(rng, state):
    anchored = state.planes[4]
    X = rng.normal(0, 5, (20, 3))
    X -= np.outer(X @ anchored.plane + 1, anchored.plane) / (anchored.plane @ anchored.plane)
    in_camera = (X + anchored.anchor - state.current.t) @ state.current.R
    np.testing.assert_allclose(in_camera @ scene_state.plane_in_camera(state, 4), -1)


def test_the_anchor_of_a_plane_is_of_no_account(rng, state):
    anchored = state.planes[4]
    elsewhere = rng.normal(size=3)
    state.planes[77] = AnchoredPlane(
        plane_geometry.transform(anchored.plane, np.eye(3), anchored.anchor - elsewhere),
        elsewhere)
    np.testing.assert_allclose(scene_state.plane_in_camera(state, 77),
                               scene_state.plane_in_camera(state, 4))


def test_a_plane_through_the_origin_of_the_world_is_no_singularity():
    state = scene_state.start(np.array([0, -1.0, 0]), 1.0, 1.0, 0.1)
    state.current.t = np.array([2.0, 0, 0])
    # A facade along x = 0, first seen from x = 2.
    state.add_plane(1, AnchoredPlane(np.array([0.5, 0, 0]), np.array([2.0, 0, 0])), np.eye(3))
    np.testing.assert_allclose(scene_state.plane_in_camera(state, 1), [0.5, 0, 0])


def test_plane_in_camera_jacobian_is_the_numerical_one(state):
    by_pose, by_plane = formulas.plane_in_camera_jacobian(state, 4)
    numerical = jacobian(lambda e: scene_state.plane_in_camera(state.moved(e), 4),
                         np.zeros(state.size))
    np.testing.assert_allclose(by_pose, numerical[:, state.at('current')], rtol=1e-5, atol=1e-8)
    np.testing.assert_allclose(by_plane, numerical[:, state.at(4)], rtol=1e-5, atol=1e-8)


def test_relative_motion_maps_points_of_the_previous_camera(rng, state):
    X = rng.normal(size=(10, 3))
    in_previous, in_current = ((X - pose.t) @ pose.R for pose in (state.previous, state.current))
    R, t = scene_state.relative_motion(state)
    np.testing.assert_allclose(in_previous @ R.T + t, in_current)


def test_observation_jacobian_is_the_numerical_one(state):
    R, t = scene_state.relative_motion(state)

    def observed(e):
        moved = state.moved(e)
        R_e, t_e = scene_state.relative_motion(moved)
        planes = [scene_state.plane_in_camera(moved, id_) for id_ in IDS]
        return np.r_[rotation.log(R_e @ R.T), t_e, np.ravel(planes)]

    numerical = jacobian(observed, np.zeros(state.size))
    G = observation_jacobian(state, IDS)
    np.testing.assert_allclose(G, numerical, rtol=1e-5, atol=1e-7)
    by_previous, by_current = formulas.relative_motion_jacobian(state)
    np.testing.assert_array_equal(G[:6, state.at('previous')], by_previous)
    np.testing.assert_array_equal(G[:6, state.at('current')], by_current)


def test_log_baseline_jacobian_is_the_numerical_one(state):
    value, H = scene_state.log_baseline(state)
    assert value == pytest.approx(np.log(np.linalg.norm(state.current.t - state.previous.t)))
    numerical = jacobian(lambda e: scene_state.log_baseline(state.moved(e))[0],
                         np.zeros(state.size))
    np.testing.assert_allclose(H, numerical, rtol=1e-5, atol=1e-8)


def test_scaling_the_state_commutes_with_its_errors(rng, state):
    """Values and covariance scale as samples of the state do."""
    factor, e = 2.5, rng.normal(0, 1e-3, state.size)
    e[state.at('mount')] = 0
    sample = deepcopy(state).moved(e)
    sample.error = deepcopy(state).error
    nominal = deepcopy(state)
    scene_state.scale_lengths(nominal, factor)
    scene_state.scale_lengths(sample, factor)
    D = error_between(nominal, sample) / np.where(e == 0, 1, e)
    D[state.at('mount')] = 1
    np.testing.assert_allclose(nominal.P, D[:, None] * state.P * D, rtol=1e-5)
    R, t = scene_state.relative_motion(state)
    R_scaled, t_scaled = scene_state.relative_motion(nominal)
    np.testing.assert_allclose(R_scaled, R)
    np.testing.assert_allclose(t_scaled, factor * t)
    np.testing.assert_allclose(scene_state.plane_in_camera(nominal, 4) * factor,
                               scene_state.plane_in_camera(state, 4))
    np.testing.assert_allclose(nominal.velocity, factor * state.velocity)
    assert nominal.depth_scale == pytest.approx(state.depth_scale + np.log(factor))


def test_a_turn_on_the_spot_has_the_numerical_transition(state):
    R = rotation.exp(np.array([0.02, 0.3, -0.05]))

    def turned(e):
        twin = deepcopy(state).moved(e)
        twin.error = deepcopy(state).error
        scene_state.turn_on_the_spot(twin, R, np.zeros((3, 3)), 0.0)
        return twin

    base, P = turned(np.zeros(state.size)), state.P.copy()
    F = jacobian(lambda e: error_between(base, turned(e)), np.zeros(state.size))
    F[state.at('mount'), state.at('mount')] = np.eye(3)
    cur = state.at('current')
    scene_state.turn_on_the_spot(state, R, 1e-4 * np.eye(3), 0.02)
    expected = F @ P @ F.T
    expected[cur, cur] += np.diag([1e-4] * 3 + [0.02**2] * 3)
    np.testing.assert_allclose(state.P, expected, rtol=1e-4, atol=1e-6 * np.abs(P).max())
    np.testing.assert_array_equal(state.current.t, state.previous.t)
    np.testing.assert_allclose(scene_state.relative_motion(state)[0], R, atol=1e-12)


def test_a_turn_on_the_spot_is_as_wrong_as_the_focal_length(state):
    turn, twin = np.array([0.002, 0.3, 0.0]), deepcopy(state)
    scene_state.turn_on_the_spot(state, rotation.exp(turn), np.zeros((3, 3)), 0.0, 0.01)
    scene_state.turn_on_the_spot(twin, rotation.exp(1.01 * turn), np.zeros((3, 3)), 0.0)
    grown = (state.error.lasting - twin.error.lasting)[state.at('current')][:3, scene_state.FOCAL]
    wrong = rotation.log(state.current.R.T @ twin.current.R)
    np.testing.assert_allclose(grown, wrong, atol=1e-2 * np.linalg.norm(wrong))


def test_the_height_swings_about_its_mean_and_forgets(state):
    def swayed(e):
        twin = deepcopy(state).moved(e)
        twin.error = deepcopy(state).error
        scene_state.sway(twin, 0.2, SWAYS)
        return twin

    state.heave = 0.03
    base, P = swayed(np.zeros(state.size)), state.P.copy()
    F = jacobian(lambda e: error_between(base, swayed(e)), np.zeros(state.size))
    F[state.at('mount'), state.at('mount')] = np.eye(3)
    scene_state.sway(state, 0.2, SWAYS)
    at, left = state.at('heave'), np.exp(-0.2 / 0.3)
    assert state.heave == pytest.approx(0.03 * left)
    expected = F @ P @ F.T
    expected[at, at] += 0.02**2 * (1 - left**2)
    np.testing.assert_allclose(state.P, expected, rtol=1e-4, atol=1e-6 * np.abs(P).max())
    scene_state.sway(state, np.inf, SWAYS)
    assert state.heave == 0
    assert state.P[at, at] == pytest.approx(0.02**2)


def test_a_halt_leaves_no_velocity_and_no_memory_of_one(state):
    omega, covariance = np.array([0, 0.2, 0]), np.diag([1e-4, 2e-4, 3e-4])
    scene_state.halt(state, omega, covariance)
    vel, om = state.at('velocity'), state.at('omega')
    np.testing.assert_array_equal(state.velocity, 0)
    np.testing.assert_array_equal(state.omega, omega)
    np.testing.assert_array_equal(state.P[om, om], covariance)
    assert not state.P[om, vel].any()
    assert not state.P[vel, state.at('current')].any()


def test_a_common_error_of_all_lengths_is_what_scaling_does(state):
    size, before = 1e-6, deepcopy(state)
    scaled = deepcopy(state)
    scene_state.scale_lengths(scaled, 1 + size)
    for id_, plane in state.planes.items():
        scene_state.move_anchor(scaled, id_, plane.anchor)
    e = error_between(state, scaled) / size
    scene_state.widen_scale(state, 0.1)
    added = state.P - before.P
    np.testing.assert_allclose(added, 0.01 * np.outer(e, e), rtol=1e-4, atol=1e-7)


def test_a_copied_pose_is_independent(state):
    before, twin = deepcopy(state).current, state.current.copy()
    twin.t += 1
    twin.R[:] = 0
    np.testing.assert_array_equal(state.current.R, before.R)
    np.testing.assert_array_equal(state.current.t, before.t)


def test_moving_the_anchor_moves_neither_the_plane_nor_its_uncertainty_in_the_camera(rng, state):
    def seen(state):
        by_pose, by_plane = formulas.plane_in_camera_jacobian(state, 4)
        J = np.zeros((3, state.size))
        J[:, state.at('current')], J[:, state.at(4)] = by_pose, by_plane
        return scene_state.plane_in_camera(state, 4), J @ state.P @ J.T

    plane, covariance = seen(state)
    anchor = state.planes[4].anchor + rng.normal(0, 0.5, 3)
    scene_state.move_anchor(state, 4, anchor)
    np.testing.assert_array_equal(state.planes[4].anchor, anchor)
    np.testing.assert_allclose(seen(state)[0], plane)
    np.testing.assert_allclose(seen(state)[1], covariance)


def test_a_surface_changes_by_its_relief_while_the_camera_moves_by_its_distance(state):
    known = state.planes[4]
    unit = known.plane / np.linalg.norm(known.plane)
    distance = 1 / np.linalg.norm(known.plane)
    for share, way, camera in ((0.25, 0.25 * distance, known.anchor), (0.0, 0.0, known.anchor),
                               (1.0, 0.5, known.anchor - distance * unit)):
        before = state.error.covariance(4).copy()
        state.current.t, across = camera, np.cross(unit, [1.0, 0.0, 0.0])
        state.previous.t = camera + way * across / np.linalg.norm(across)
        scene_state.renew(state, 0.03)
        added = state.error.covariance(4) - before
        np.testing.assert_allclose(added, share * 0.03**2 * np.outer(known.plane, known.plane),
                                   atol=1e-9)


def test_a_bend_turns_the_normal_and_leaves_the_depth(state):
    before = state.error.covariance(4).copy()
    scene_state.bend(state, 4, 0.01)
    added = state.error.covariance(4) - before
    plane = state.planes[4].plane
    np.testing.assert_allclose(added @ plane, 0, atol=1e-12)
    assert np.sqrt(np.trace(added) / 2) / np.linalg.norm(plane) == pytest.approx(0.01)


def test_a_new_unit_leaves_one_place_where_it_was(rng):
    """What is seen from there stays; the way to there, told in another unit, is as unsure."""
    state, place = between_two_poses(rng), np.array([3.0, -1, 7])
    state.add_plane(4, AnchoredPlane(np.array([0.1, 0.2, -0.3]), np.array([1.0, 2, 3])),
                    1e-4 * np.eye(3))
    state.current.t = place.copy()
    before = deepcopy(state)
    seen = scene_state.plane_in_camera(before, 4)
    scene_state.rescale_about(state, place, 2.0, 0.1)
    np.testing.assert_allclose(state.current.t, place)
    np.testing.assert_allclose(state.previous.t - place, 2 * (before.previous.t - place))
    np.testing.assert_allclose(scene_state.plane_in_camera(state, 4), seen / 2)
    at = slice(state.at('current').start + 3, state.at('current').stop)
    np.testing.assert_allclose(state.P[at, at], 4 * before.P[at, at])  # no length, no error of it
    np.testing.assert_allclose(state.gauge.covariance[3:6, 3:6], np.outer(place, place))
