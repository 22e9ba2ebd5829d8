"""Corrections of the scene: the maximum of the posterior of all that a pair tells."""

from dataclasses import replace

from canyon import angle_between, CANYON, K, motion, turn_between, views
import ekf_reference
import formulas
from kernels.scene_reference import observation_jacobian
from mv_slapse.config import SceneSettings
from mv_slapse.filters import ekf
from mv_slapse.geometry import rotation
from mv_slapse.geometry.camera import to_pixels
from mv_slapse.scene import observations as scene_observations
from mv_slapse.scene import state as scene_state
from mv_slapse.scene import update as scene_update
from mv_slapse.scene.scale import ratio as scene_ratio
from mv_slapse.scene.state import AnchoredPlane, Pose
from numeric import jacobian
import numpy as np
import pytest

ROAD, IDS = 4, [4, 9, 11, 13]
SIMPLE = SceneSettings(relief=0.0, depth_bias=0.0, dependence=1.0, depth_dependence=1.0,
                       vector_bias=1e-4, mover_bias=0.0, iterations=20)


def state_before(scene, rng, pose_sigma=0.02):
    """Return a state whose pose errs as its covariance says, and whose planes are unknown."""
    state = scene_state.start(np.array([0, -1.0, 0]), 1.0, 0.1, 0.05)
    offset = np.r_[rng.normal(0, 0.1 * pose_sigma, 3), rng.normal(0, pose_sigma, 3)]
    R = scene.R.T
    state.current = Pose(R @ rotation.exp(offset[:3]), -R @ scene.t + offset[3:])
    at = state.at('current')
    state.error.P[at, at] = np.diag([(0.1 * pose_sigma)**2] * 3 + [pose_sigma**2] * 3)
    for id_, plane in zip(IDS, scene.planes, strict=True):
        # The anchor, as a new plane's, is the predicted position.
        anchor = state.current.t.copy()
        true = R @ plane / (1 + R @ plane @ (anchor + R @ scene.t))
        state.add_plane(id_, AnchoredPlane(true * 1.05, anchor), 9 * (plane @ plane) * np.eye(3))
    return state


@pytest.fixture
def scene(rng):
    return views(*motion('ahead'), rng, 0.3)


@pytest.fixture
def state(rng, scene):
    state = state_before(scene, rng, 0.1)
    A = rng.normal(size=(state.size, state.size))
    state.error.P = 1e-4 * A @ A.T
    return state


def updated(scene, state, settings=SIMPLE, observations=()):
    return scene_update.update(state, np.zeros(state.size), scene.pair, (scene.surface, IDS),
                               settings, observations)


def without_pair(scene, state, *observations):
    """Update by direct observations alone."""
    return scene_update.update(state, np.zeros(state.size), scene.pair[:0],
                               (scene.surface[:0], []), SIMPLE, observations)


def test_a_linear_observation_is_that_of_the_filter(rng, scene, state):
    observation = formulas.camera_height(ROAD, 1.9, 0.3)
    innovation, H = scene_observations.linearised(observation, state)
    twin = ekf.State()
    twin.add('all', np.zeros(state.size), state.P)
    ekf_reference.update(twin, innovation, H, np.eye(1) * 0.3**2)
    once = SceneSettings(iterations=1)
    found = scene_update.update(
        state, np.zeros(state.size), scene.pair[:0], (scene.surface[:0], []), once,
        [observation])
    np.testing.assert_allclose(found.P, twin.P, atol=1e-12)
    np.testing.assert_allclose(state.error_to(found)[:12], twin.mu[:12], atol=1e-9)
    np.testing.assert_allclose(found.velocity, state.velocity + twin.mu[12:15])


def test_camera_height_sets_the_depth_of_the_road(rng, scene):
    state = state_before(scene, rng)
    found = without_pair(scene, state, formulas.camera_height(ROAD, 1.65, 1e-5))
    depth = 1 / np.linalg.norm(scene_state.plane_in_camera(found, ROAD))
    assert depth == pytest.approx(1.65, abs=1e-4)


def test_the_gauge_leaves_angles_and_proportions_as_the_pair_shows_them(rng, scene):
    """Joined with the pair: set afterwards, at another length, it would bend the planes."""
    state = state_before(scene, rng)
    shown = state.moved(np.zeros(state.size))
    state.current = Pose(state.current.R, np.zeros(3))
    state.error.P[state.at('current'), state.at('current')][3:, 3:] = 100 * np.eye(3)
    found = scene_update.update(
        state, state.error_to(shown), scene.pair, (scene.surface, IDS), SIMPLE,
        [scene_observations.baseline(1.0, 1e-6)])
    R, t = scene_state.relative_motion(found)
    assert np.linalg.norm(t) == pytest.approx(1, abs=1e-4)
    assert np.degrees(angle_between(t, scene.t)) < 0.3
    for id_, plane in zip(IDS[:3], CANYON[:3], strict=True):
        np.testing.assert_allclose(scene_state.plane_in_camera(found, id_), plane,
                                   atol=0.03 * np.linalg.norm(plane))


def test_correspondences_find_the_pose_and_the_planes_exactly(rng):
    scene = views(*motion('ahead'), sigma=0.1)
    state = state_before(scene, rng)
    # One of the six planes' unknowns and the baseline's length is a gauge: fix it.
    state.current.t /= np.linalg.norm(state.current.t)
    found = updated(scene, state, SIMPLE)
    R, t = scene_state.relative_motion(found)
    length = np.linalg.norm(t)
    assert turn_between(R, scene.R) < 1e-5
    assert angle_between(t, scene.t) < 1e-5
    for id_, plane in zip(IDS, CANYON, strict=True):
        np.testing.assert_allclose(scene_state.plane_in_camera(found, id_) * length, plane,
                                   atol=2e-4)


def test_the_update_is_the_maximum_of_the_posterior(rng, scene):
    state = state_before(scene, rng)
    P = state.P.copy()
    found = updated(scene, state)
    e = state.error_to(found)
    for id_ in IDS:
        e[state.at(id_)] = found.planes[id_].plane - state.planes[id_].plane

    def cost(e):
        moved = state.moved(e)
        planes = np.array([scene_state.plane_in_camera(moved, id_) for id_ in IDS])
        return formulas.normal_equations(scene.pair, *scene_state.relative_motion(moved), planes,
                                         scene.surface, 0.0, 3.0)[2]

    # Where prior and data balance: P^-1 e + gradient / 2 = 0, for a P that is singular.
    gradient = jacobian(cost, e, 1e-6)
    free = np.r_[state.at('current'), [i for id_ in IDS for i in np.r_[state.at(id_)]]]
    sigma = np.sqrt(np.diag(found.P)[free])
    # In units of what an error of one posterior standard deviation would change.
    balance = (e + P @ gradient / 2)[free]
    prior = np.linalg.inv(P[np.ix_(free, free)])
    assert np.max(np.abs(prior @ balance * sigma)) < 0.05


def test_covariance_is_the_inverse_of_prior_and_data_information(rng, scene):
    state = state_before(scene, rng)
    P = state.P.copy()
    found = updated(scene, state)
    planes = np.array([scene_state.plane_in_camera(found, id_) for id_ in IDS])
    A, _, _ = formulas.normal_equations(scene.pair, *scene_state.relative_motion(found), planes,
                                        scene.surface, 0.0, 3.0)
    G = observation_jacobian(found, IDS)
    free = np.r_[state.at('current'), [i for id_ in IDS for i in np.r_[state.at(id_)]]]
    at = np.ix_(free, free)
    expected = np.linalg.inv(np.linalg.inv(P[at]) + (G.T @ A @ G)[at])
    np.testing.assert_allclose(found.P[at], expected, rtol=1e-3, atol=1e-3 * expected.max())
    np.testing.assert_array_equal(found.P, found.P.T)


def test_errors_have_the_size_that_the_covariance_says():
    distances = []
    for seed in range(30):
        rng = np.random.default_rng(seed)
        scene = views(*motion('ahead'), rng, 0.3)
        found = updated(scene, state_before(scene, rng))
        at = found.at('current')
        error = np.r_[rotation.log(found.current.R.T @ scene.R.T),
                      -scene.R.T @ scene.t - found.current.t]
        distances.append(error @ np.linalg.solve(found.P[at, at], error))
    # Mean of 30 chi-squares with 6 degrees of freedom: 6 +- 0.63. The kernel costs a little.
    assert 4.0 < np.mean(distances) < 8.5


def test_outliers_move_the_pose_by_little(rng):
    scene = views(*motion('ahead'), rng, 0.3, outliers=0.3)
    found = updated(scene, state_before(scene, rng))
    R, t = scene_state.relative_motion(found)
    assert np.degrees(turn_between(R, scene.R)) < 0.03
    assert np.degrees(angle_between(t, scene.t)) < 0.3


def test_without_planes_direction_and_turn_are_corrected_and_the_length_is_not(rng, scene):
    state = state_before(scene, rng)
    for id_ in IDS:
        state.remove_plane(id_)
    length = np.linalg.norm(state.current.t)
    found = scene_update.update(state, np.zeros(state.size), scene.pair,
                                (np.full(len(scene.pair), -1), []), SIMPLE)
    R, t = scene_state.relative_motion(found)
    assert np.degrees(turn_between(R, scene.R)) < 0.03
    assert np.degrees(angle_between(t, scene.t)) < 0.5
    assert np.linalg.norm(t) == pytest.approx(length, rel=2e-3)


def test_dependence_and_bias_widen_the_covariance(rng, scene):
    traces = [np.trace(updated(scene, state_before(scene, rng), settings).P[6:12, 6:12])
              for settings in (SIMPLE, replace(SIMPLE, dependence=8.0),
                               replace(SIMPLE, dependence=8.0, depth_dependence=8.0),
                               replace(SIMPLE, dependence=8.0, depth_dependence=8.0,
                                       depth_bias=0.1))]
    assert traces[0] < traces[1] < traces[2] < traces[3]


def test_errors_that_last_shift_the_update_as_the_covariance_says(rng, scene):
    """A turn of all vectors, places beside the middle, wrong height, speed, focal length, unit."""
    settings = replace(SIMPLE, vector_bias=0.05, mover_bias=0.02, place_bias=0.5,
                       focal_sigma=0.002)

    length = np.linalg.norm(scene.t)

    own = scene_ratio.Depths(scene.R, scene.t / length, np.zeros(6), 0.0)

    def posterior(turn, height, beside=(0.0, 0.0), longer=0.0, faster=0.0, unit=0.0):
        rays = scene.pair.rays_prev @ rotation.exp(-turn).T
        offset = np.r_[np.array(beside) / scene.pair.focal, 0.0]
        wide = np.array([1 + longer, 1 + longer, 1])
        rays = (rays / rays[:, 2:] - offset) * wide
        pair = replace(scene.pair, rays_prev=rays, x_prev=to_pixels(K, rays),
                       rays_cur=(scene.pair.rays_cur - offset) * wide)
        state = state_before(scene, np.random.default_rng(1))
        state.depth_scale = np.log(length) + unit
        scene_ratio.turn(state, 0.01, metric=False)
        found = scene_update.update(
            state, np.zeros(state.size), pair, (scene.surface, IDS), settings,
            [scene_ratio.observed(own, 0.02), formulas.camera_height(ROAD, height, 0.03, 0.02),
             scene_observations.baseline(length * np.exp(faster), 0.02, 0.01)])
        return state.error_to(found)[6:12], found

    base, found = posterior(np.zeros(3), 1.65)
    leaning = 0.02 * np.array([1.0, 1.0, scene.pair.roll_arm])
    size = np.hypot(0.05, leaning) / np.mean([K[0, 0], K[1, 1]])
    shifts = [posterior(scene.R.T @ (turn * size), 1.65)[0] - base for turn in np.eye(3)]
    shifts += [posterior(np.zeros(3), 1.65, 0.5 * side)[0] - base for side in np.eye(2)]
    shifts.append(posterior(np.zeros(3), 1.67)[0] - base)
    shifts.append(posterior(np.zeros(3), 1.65, faster=0.01)[0] - base)
    shifts.append(posterior(np.zeros(3), 1.65, longer=0.002)[0] - base)
    shifts.append(posterior(np.zeros(3), 1.65, unit=0.1 * scene_ratio.TURNING)[0] - base)
    columns = found.error.lasting[found.at('current')]
    scale = np.sqrt(np.diag(found.error.total))[6:12, None]
    np.testing.assert_allclose(columns / scale, np.transpose(shifts) / scale, atol=0.1)
    assert np.all(np.abs(columns / scale).max(axis=0) > 0.1)


def test_common_errors_of_depths_do_not_add_up(scene):
    """Each pair's error is in its ratio and, negated, in the next: the way does not drift."""
    errors, sigmas = [], []
    depths = scene_ratio.Depths(np.eye(3), np.array([0, 0, -1.0]), np.zeros(6), 0.0)
    for seed in range(20):
        rng = np.random.default_rng(seed)
        state = scene_state.start(np.array([0, -1.0, 0]), 0.1, 0.01, 0.05)
        state.velocity = np.array([0, 0, 10.0])
        scene_state.propagate(state, 0.1, 0.0, 0.0, 1.0)
        scene_ratio.begin(state, depths, 0.006)
        common = rng.normal(0, 0.006)
        for _ in range(50):
            scene_state.propagate(state, 0.1, 3.0, 0.1, 1.0)
            before, common = common, rng.normal(0, 0.006)
            scene_ratio.move(state, common - before, 1e-4)
            state = without_pair(scene, state, scene_ratio.observed(depths, 0.006))
        value, H = scene_state.log_baseline(state)
        errors.append(value)
        sigmas.append(np.sqrt(H @ state.P @ H))
    # Errors that added up would be 0.006 * 50^0.5 = 0.04.
    assert np.std(errors) < 0.015
    assert 0.5 < np.std(errors) / np.mean(sigmas) < 1.5
