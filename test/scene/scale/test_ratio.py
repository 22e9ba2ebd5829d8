"""Baselines by depths: what a pair's motion does to its depths, and lengths that nothing tells."""

from copy import deepcopy
from dataclasses import replace

from canyon import K, motion, views
from mv_slapse.config import SceneSettings
from mv_slapse.geometry import rotation, two_view
from mv_slapse.geometry.camera import to_rays
from mv_slapse.records import CameraMotion, MotionStatus
from mv_slapse.scene import state as scene_state
from mv_slapse.scene.observations import linearised
from mv_slapse.scene.scale import ratio as scene_ratio
from mv_slapse.scene.state import Pose
from numeric import jacobian
import numpy as np
import pytest
from scene_drive import between_two_poses, Canyon, driven

SIGMA = 0.05


def depths_with(slope, state):
    """Return depths of a state's own motion."""
    R, t = scene_state.relative_motion(state)
    return scene_ratio.Depths(R, t / np.linalg.norm(t), np.asarray(slope, float), 0.0)


@pytest.fixture
def state(rng):
    state = between_two_poses(rng)
    state.depth_scale = 0.3
    A = rng.normal(size=(state.size, state.size))
    state.error.P = 1e-4 * A @ A.T
    return state


def test_the_jacobian_is_the_numerical_one_of_the_innovation(state, rng):
    depths = depths_with(rng.normal(size=6), state)
    observation = scene_ratio.observed(depths, 0.006)
    innovation, H = linearised(observation, state)
    numerical = -jacobian(lambda e: linearised(observation, state.moved(e))[0],
                          np.zeros(state.size))
    np.testing.assert_allclose(H, numerical, rtol=1e-5, atol=1e-7)
    value, _ = scene_state.log_baseline(state)
    np.testing.assert_allclose(innovation, [value - 0.3])
    assert observation.sigma == 0.006


@pytest.mark.parametrize('metric', [False, True])
def test_a_turn_makes_the_unit_less_sure_by_its_angle(state, metric):
    at, before = state.at('depth_scale'), state.error.total
    for angle in (0.5, 0.0, 1.5):
        scene_ratio.turn(state, angle, metric)
    grown = state.error.total - before
    expected = np.zeros_like(grown)
    expected[at, at] = 2 * scene_ratio.TURNING**2
    np.testing.assert_allclose(grown, expected, atol=1e-12)
    # Where planes may put the length right, the error is the filter's; else it lasts.
    assert bool(np.any(state.error.lasting)) is not metric


def test_a_turn_adds_to_an_error_that_lasts_with_its_sign(state):
    at = state.at('depth_scale')
    state.error.lasting[at, scene_state.LENGTH] = -0.1
    scene_ratio.turn(state, 0.5, metric=False)
    assert state.error.lasting[at, scene_state.LENGTH] == pytest.approx(
        -np.hypot(0.1, scene_ratio.TURNING * np.sqrt(0.5)))


def depths_change(depths, state):
    """Return the mean log of inverse depth at a state's motion over depths', and derivative."""
    value, H = scene_state.log_baseline(state)
    [off], [by_state] = linearised(scene_ratio.observed(depths, 1.0), state)
    by_state[state.at('depth_scale')] = 0
    return value - state.depth_scale - off, by_state + H


def test_a_motion_that_errs_makes_depths_wrong_by_what_their_slope_says():
    scene = views(*motion('sideways'))
    pair = two_view.Pair(to_rays(K, scene.x_cur), to_rays(K, scene.x_true), scene.x_true,
                         np.full(len(scene.x_cur), SIGMA), K)
    wrong = CameraMotion(MotionStatus.MOVING, rotation.exp(np.array([0, 3e-4, 0])) @ scene.R,
                         scene.t, np.eye(6) * 1e-8)
    state = scene_state.start(np.array([0, -1.0, 0]), 1.0, 0.1, 0.05)
    state.current = Pose(scene.R.T, -scene.R.T @ scene.t)
    depths = scene_ratio.depths_of(pair, wrong, replace(SceneSettings(), dependence=2.0))
    change = depths_change(depths, state)[0]
    rho, per_pixel = two_view.inverse_depth(pair.rays_cur, pair.rays_prev, pair.focal,
                                            wrong.R_cur_from_prev, scene.t)
    true, _ = two_view.inverse_depth(pair.rays_cur, pair.rays_prev, pair.focal, scene.R, scene.t)
    sure = SIGMA * per_pixel < two_view.MAX_SPREAD * rho
    weight = 1 / (np.square(SIGMA * per_pixel / rho) + SceneSettings().relief**2)[sure]
    expected = weight @ np.log(true[sure] / rho[sure]) / weight.sum()
    assert abs(expected) > 0.003
    assert change == pytest.approx(expected, rel=0.1)
    assert depths.variance == pytest.approx(2e-8 * depths.slope @ depths.slope)


def test_a_new_depth_scale_is_the_baseline_and_shares_its_error(state):
    value, H = scene_state.log_baseline(state)
    depths = depths_with([3.0, 0, 0, 0, 0, 0], state)
    H = H - depths_change(depths, state)[1]
    expected = H @ state.P
    assert scene_ratio.begin(state, depths, 0.02)
    at = state.at('depth_scale')
    assert state.depth_scale == pytest.approx(value)
    others = np.delete(np.arange(state.size), at.start)
    np.testing.assert_allclose(state.P[at.start, others], expected[others])
    assert state.P[at, at].item() == pytest.approx(expected @ H + 0.02**2)


@pytest.mark.parametrize(('sigma', 'carried'), [(1.0, True), (1.5, False)])
def test_a_baseline_guessed_after_a_rest_gives_the_depths_a_scale(sigma, carried):
    state = scene_state.start(np.array([0, -1.0, 0]), 1.0, 0.1, 0.05)
    state.current.t = np.array([0, 0, 0.1])
    at = state.at('current')
    state.error.P[at, at] = np.diag([0, 0, 0, 0, 0, (0.1 * sigma)**2])
    assert scene_ratio.begin(state, depths_with(np.zeros(6), state), 0.006) is carried


def test_a_baseline_next_to_zero_gives_the_depths_no_scale(state):
    depths = depths_with(np.zeros(6), state)
    state.current.t = state.previous.t + 1e-3
    assert not scene_ratio.begin(state, depths, 0.02)
    at = state.at('depth_scale')
    assert not state.P[at].any()
    assert not state.P[:, at].any()


def test_a_ratio_moves_the_depth_scale_and_widens_it(state):
    before, at = deepcopy(state), state.at('depth_scale')
    scene_ratio.move(state, 0.1, 0.02)
    assert state.depth_scale == pytest.approx(before.depth_scale + 0.1)
    expected = before.P.copy()
    expected[at, at] += 0.02**2
    np.testing.assert_allclose(state.P, expected)


@pytest.mark.parametrize(('sigmas', 'sigma', 'holds'), [
    (3.0, 0.01, True), (-3.0, 0.01, True), (3.6, 0.01, False), (3.6, np.inf, False)])
def test_a_ratio_holds_within_the_gate_of_the_predicted_length(rng, sigmas, sigma, holds):
    state = between_two_poses(rng)
    state.depth_scale = 0.2
    value, _ = scene_state.log_baseline(state)
    ratio = value - state.depth_scale + sigmas * 0.01
    assert scene_ratio.holds(state, ratio, sigma) is holds


def test_a_ratio_may_contradict_by_what_the_doubt_of_the_motion_explains(state):
    state.error.P *= 1e-4
    contradiction = scene_state.log_baseline(state)[0] - state.depth_scale + 1.0
    extraction = replace(Canyon().extraction(2), baseline_ratio=contradiction)
    settings, sure = SceneSettings(), depths_with(np.zeros(6), state)
    unsure = deepcopy(state)
    assert scene_ratio.told(state, extraction, sure, settings) == []
    assert len(scene_ratio.told(unsure, extraction, replace(sure, variance=1.0), settings)) == 1
    for one in (state, unsure):
        assert one.depth_scale == pytest.approx(0.3 + contradiction)


class Swerving(Canyon):
    """From the fourth pair on shows neither planes nor ratios, and ways that swerve by 40 deg."""

    def motion(self, k):
        R, t = super().motion(k)
        return R, rotation.exp(np.array([0, 0.35 * (-1)**k, 0])) @ t if k > 3 else t

    def extraction(self, k, ratio=True):
        shown = super().extraction(k, ratio=k <= 3)
        return shown if k <= 3 else replace(shown, planes=(),
                                            plane_id=np.full_like(shown.plane_id, -1))


def test_a_length_that_nothing_tells_is_not_drawn_to_zero_by_directions_that_err():
    estimates = driven(Swerving(np.random.default_rng(0), 0.1, 1e-3), 20, SceneSettings())
    lengths = np.array([estimate.baseline for estimate in estimates])
    assert np.all(lengths > 0.1)  # without what is supposed of them: 0.003
    assert np.all(lengths < 1.1)


def test_the_ratio_counts_half_where_planes_tell_the_length_by_the_same_vectors(state):
    extraction = replace(Canyon().extraction(2), baseline_ratio=float(
        scene_state.log_baseline(state)[0] - state.depth_scale))
    alone, shared = (scene_ratio.told(deepcopy(state), extraction, depths_with(np.zeros(6), state),
                                      SceneSettings(), shared=both)[0].sigma
                     for both in (False, True))
    assert shared == pytest.approx(np.sqrt(2) * alone)
