"""The scene's kernels against their formulas in numpy, on drawn states and pairs."""

from types import SimpleNamespace

from canyon import CANYON, K, motion, views
import formulas
from kernels import scene_reference as reference
from mv_slapse.config import SceneSettings
from mv_slapse.filters import ekf
from mv_slapse.geometry import rotation
from mv_slapse.geometry.camera import to_pixels
from mv_slapse.kernels.binding import compiled
from mv_slapse.records import Label, PlaneObservation
from mv_slapse.scene import gating as scene_gate
from mv_slapse.scene import observations as scene_observations
from mv_slapse.scene import state as scene_state
from mv_slapse.scene import update as scene_update
from mv_slapse.scene.observations import Kind, Observation
from mv_slapse.scene.scale import ratio as scene_ratio
from mv_slapse.scene.state import AnchoredPlane, Gauge, Pose
import numpy as np
import pytest
from scipy.spatial import ConvexHull

IDS = [4, 9, 11, 13]


@pytest.fixture
def scene(rng):
    return views(*motion('ahead'), rng, 0.3)


@pytest.fixture
def state(rng, scene):
    """A state near a pair's truth, with every error correlated with every other."""
    state = scene_state.start(np.array([0.1, -1.0, 0]) / np.hypot(0.1, 1), 1.0, 0.1, 0.05)
    R = scene.R.T
    state.current = Pose(R @ rotation.exp(rng.normal(0, 0.005, 3)),
                         -R @ scene.t + rng.normal(0, 0.02, 3))
    for id_, plane in zip([*IDS, 20], [*scene.planes, [0.1, 0.2, -0.1]], strict=True):
        state.add_plane(id_, AnchoredPlane(np.asarray(plane) * 1.05, rng.normal(0, 0.1, 3)),
                        np.eye(3))
    state.depth_scale, state.heave = 0.02, 0.01
    A = rng.normal(size=(state.size, state.size))
    state.error.P = 1e-4 * A @ A.T
    state.error.lasting = rng.normal(0, 1e-3, (state.size, scene_state.N_LASTING))
    return state


def test_the_update_is_that_of_the_whole_state(rng, scene, state):
    settings = SceneSettings()
    R, t = scene_state.relative_motion(state)
    depths = scene_ratio.Depths(R @ rotation.exp([0.001, 0, 0]), t / np.linalg.norm(t),
                                rng.normal(size=6), 0.0)
    lasting = rng.normal(0, 1e-2, scene_state.N_LASTING)
    observations = [formulas.camera_height(IDS[0], 1.7, 0.02, lasting),
                    Observation(Kind.MOUNTING, 0.02, plane=IDS[0]),
                    Observation(Kind.LEVEL_COURSE, 0.02),
                    scene_observations.baseline(1.02, 0.05, 0.01),
                    scene_ratio.observed(depths, 0.01)]
    start = rng.normal(0, 1e-3, state.size)
    e, P, errors = reference.update(state, start, scene.pair, scene.surface, IDS, settings,
                                    observations)
    expected = state.moved(e)
    found = scene_update.update(state, start, scene.pair, (scene.surface, IDS), settings,
                                observations)
    np.testing.assert_allclose(found.arrays[0], expected.arrays[0], atol=1e-9)
    np.testing.assert_allclose(found.arrays[1], expected.arrays[1], atol=1e-9)
    np.testing.assert_allclose(found.velocity, expected.velocity, atol=1e-9)
    np.testing.assert_allclose(found.P, P, atol=1e-9 * np.abs(P).max())
    np.testing.assert_allclose(found.error.lasting, errors, atol=1e-9)
    np.testing.assert_array_equal(found.P, found.P.T)


def test_distances_of_planes_seen_again(rng, state):
    settings = SceneSettings()
    seen = [PlaneObservation(id_, Label.STATIONARY, rng.normal(size=3), np.diag([0.1, 0.2, 0.3]))
            for id_ in (11, 4, 20)]
    found = scene_gate.distances(state, SimpleNamespace(planes=seen), settings)
    expected = [reference.squared_distance(state, plane, settings) for plane in seen]
    np.testing.assert_allclose([*found.values()], expected, rtol=1e-9)


def test_a_prediction_by_rows_is_that_by_the_whole_matrix(rng, state):
    rows, F = np.array([3, 7, 8]), np.eye(state.size)
    F[rows] = rng.normal(size=(3, state.size))
    Q = np.zeros_like(F)
    Q[np.ix_(rows, rows)] = np.diag([1.0, 2.0, 3.0])
    lasting = F @ state.error.lasting
    expected = F @ state.P @ F.T + Q
    ekf.predict_rows(state.error, rows, F[rows], Q[np.ix_(rows, rows)])
    np.testing.assert_allclose(state.P, expected, atol=1e-14)
    np.testing.assert_allclose(state.error.lasting, lasting, atol=1e-14)


def test_the_blocks_that_count(rng):
    n = 600
    x = rng.uniform(0, 320, (n, 2)).astype(np.float32)
    label = rng.choice(np.array([-1, 0, 1, 2], np.int8), n, p=[0.3, 0.5, 0.02, 0.18])
    plane_id = rng.choice(np.array([-1, 5], np.int32), n)
    sigma = rng.uniform(0.2, 0.5, n).astype(np.float32)
    skewed = K + np.array([[0, 0.5, 0], [0, 0, 0], [0, 0, 0]])
    rays, before, prev, noise, ids = compiled.stationary_blocks(x, x + np.float32(1), sigma, label,
                                                                plane_id, skewed)
    expected = reference.counts(x, label, plane_id)
    np.testing.assert_array_equal(prev, x[expected] + np.float32(1))
    np.testing.assert_array_equal(noise, sigma[expected])
    np.testing.assert_array_equal(ids, plane_id[expected])
    np.testing.assert_allclose(to_pixels(skewed, rays), x[expected], atol=1e-9)
    np.testing.assert_allclose(to_pixels(skewed, before), prev, atol=1e-9)


def test_what_errors_and_depths_say_together(scene):
    pair = scene.pair
    arguments = (pair.rays_cur, pair.rays_prev, pair.sigma)
    R, t = scene.R, scene.t / np.linalg.norm(scene.t)
    dependence, sigma = compiled.error_dependence(*arguments, pair.x_prev, pair.focal, R, t, 3.0)
    assert dependence == pytest.approx(reference.dependence(pair, R, t, 3.0), rel=1e-9)
    assert sigma == np.median(pair.sigma)
    np.testing.assert_allclose(compiled.depth_slope(*arguments, pair.focal, R, t, 0.2, 0.03),
                               reference.depth_slope(pair, R, t, 0.2, 0.03), rtol=1e-9)


def test_planes_in_the_world(rng, state):
    A = rng.normal(size=(7, 7))
    state.gauge = Gauge(rng.normal(size=3), 1e-3 * A @ A.T)
    _, planes, anchors = state.arrays
    found = compiled.planes_in_world(planes, anchors, state.P, state.error.lasting,
                                     state.gauge.place, state.gauge.covariance)
    for k, id_ in enumerate(state.planes):
        for value, expected in zip(found, reference.plane_in_world(state, id_), strict=True):
            np.testing.assert_allclose(value[k], expected, rtol=1e-9, atol=1e-12)


def test_an_outline_is_the_convex_hull_on_the_plane(rng):
    plane, anchor = CANYON[0], np.array([0.1, 0.2, 0.3])
    x = rng.uniform((0, 0), 2 * K[:2, 2], (200, 2)).astype(np.float32)
    ids = rng.choice(np.array([3, 4], np.int32), 200)
    R, t = rotation.exp(rng.normal(0, 0.05, 3)), rng.normal(0, 0.1, 3)
    pose, values = np.r_[R.ravel(), t], np.array([plane, anchor])
    found = compiled.plane_outline(x, ids, 3, K, pose, values, np.zeros((0, 3)), 30.0, 200)
    rays = np.c_[(x - K[:2, 2]) / np.diag(K)[:2], np.ones(200)][ids == 3] @ R.T
    above = 1 + plane @ (t - anchor)
    reach = -above / (rays @ plane)
    good = (reach > 0) & (reach < 30 * abs(above) / np.linalg.norm(plane))
    points = t + reach[good, None] * rays[good]
    np.testing.assert_allclose((points - anchor) @ plane, -1, atol=1e-9)
    basis = formulas.tangent_basis(plane / np.linalg.norm(plane))
    hull = points[ConvexHull(points @ basis).vertices]
    assert len(found) == len(hull)
    np.testing.assert_allclose(np.sort(found, axis=0), np.sort(hull, axis=0), atol=1e-9)
    again = compiled.plane_outline(x, ids, 7, K, pose, values, found, 30.0, 200)
    np.testing.assert_allclose(np.sort(again, axis=0), np.sort(found, axis=0), atol=1e-9)


def test_an_outline_keeps_the_corners_that_hold_most():
    turn = np.linspace(0, 2 * np.pi, 200, endpoint=False)
    ring = np.c_[np.cos(turn), np.sin(turn), np.full(200, 2.0)]
    ring[50] = 0.0, 4.0, 2.0
    pose, values = np.r_[np.eye(3).ravel(), 0, 0, 0], np.array([[0, 0, -0.5], [0, 0, 0]])
    found = compiled.plane_outline(np.zeros((0, 2), np.float32), np.zeros(0, np.int32), 3, K, pose,
                                   values, ring, 30.0, 32)
    assert len(found) == 32
    assert np.abs(found - ring[50]).max(axis=1).min() < 1e-9
    area = ConvexHull(found[:, :2]).volume
    assert 0.99 * ConvexHull(ring[:, :2]).volume < area < ConvexHull(ring[:, :2]).volume
    assert np.all(np.abs(found[:, None] - ring).max(axis=2).min(axis=1) < 1e-9)


def test_two_points_make_no_outline():
    old = np.array([[0.0, 0.0, 1.0]])
    found = compiled.plane_outline(np.zeros((1, 2), np.float32), np.array([3], np.int32), 3, K,
                                   np.r_[np.eye(3).ravel(), 0, 0, 0],
                                   np.array([[0, 0, -1.0], [0, 0, 0]]), old, 30.0, 3)
    np.testing.assert_array_equal(found, old)
