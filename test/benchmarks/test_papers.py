"""The printed pipelines on drawn scenes: they find what is there, and err where the print does."""

from canyon import angle_between, K, motion, turn_between, views
from compare import as_trajectory
from mv_slapse.evaluation import trajectory
from mv_slapse.geometry import rotation
from mv_slapse.geometry.camera import to_pixels, to_rays
from mv_slapse.geometry.plane import transform
from mv_slapse.records import Label
from mv_slapse.simulation import drawn
from mv_slapse.simulation.street import Street, StreetSettings
import numpy as np
from papers import filters, pipelines, two_views
from papers.two_views import Thresholds, View
import pytest

BOUNDS = Thresholds()
FRAMES = range(4, 44, 4)
STREET = Street(StreetSettings(seed=3, n_frames=45, movers=('faster',)))


def view_of(scene, rows=slice(None)):
    return View(scene.x_cur[rows], scene.x_prev[rows], K)


@pytest.mark.parametrize('name', ['ahead', 'sideways', 'turning'])
def test_the_motion_is_found_among_wrong_vectors(name):
    R, t = motion(name)
    scene = views(R, t, np.random.default_rng(0), 0.25, 0.4)
    F, inlier = two_views.eight_points(view_of(scene), BOUNDS.f, np.random.default_rng(1))
    assert np.mean(inlier[~scene.outlier]) > 0.9
    assert np.mean(inlier[scene.outlier]) < 0.2  # some lie on their epipolar lines
    first = two_views.motion(view_of(scene), F, inlier)
    better = two_views.refined(view_of(scene, inlier), *first)
    for turn, way, bound in ((*first, 0.05), (*better, 0.01)):
        assert turn_between(R, turn) < bound / 4
        assert angle_between(t, way) < bound
    cost = [np.sum(two_views.sampson(two_views.fundamental(K, *one), view_of(scene, inlier))**2)
            for one in (first, better)]
    assert cost[1] <= cost[0]


def test_too_few_vectors_have_no_motion():
    F, inlier = two_views.eight_points(view_of(views(*motion('ahead')), slice(12)), 1.0, None)
    assert F is None
    assert not inlier.any()


@pytest.mark.parametrize('name', ['ahead', 'backward', 'sideways'])
def test_each_condition_of_definition_1_counts(name):
    R, t = motion(name)
    scene = views(R, t)
    view = view_of(scene)
    still = two_views.stationary(view, R, t, BOUNDS)
    turned = two_views.without_rotation(view, R)
    flow = view.x_cur - turned
    length = np.linalg.norm(flow, axis=1)
    rows = np.flatnonzero(still & (length > 8))[5::60]
    beside = np.c_[-flow[:, 1], flow[:, 0]] / np.maximum(length, 1e-9)[:, None]
    for change in (5 * beside, 2 * flow, -1.5 * flow):
        x_prev = scene.x_prev.copy()
        x_prev[rows] = to_pixels(K, to_rays(K, turned + change) @ R)[rows]
        called = two_views.stationary(View(view.x_cur, x_prev, K), R, t, BOUNDS)
        assert len(rows) > 3
        assert not called[rows].any()
    assert np.mean(still[scene.surface >= 0]) > 0.5  # two surfaces on a line bend it


def test_planes_are_extracted_and_keep_their_numbers():
    scene = views(*motion('ahead'), np.random.default_rng(0), 0.1)
    near, none = scene.surface >= 0, np.full(len(scene.x_cur), -1)
    plane = two_views.homographies(view_of(scene), near, none, BOUNDS)
    for n in range(3):  # the largest: road and facades
        shown = scene.surface[plane == n]
        assert np.mean(shown == np.bincount(shown).argmax()) > 0.85
    known = np.where(scene.surface == 1, 7, -1)
    again = two_views.homographies(view_of(scene), near, known, BOUNDS)
    assert np.mean(again[scene.surface == 1] == 7) > 0.95
    assert set(again[again != 7]) <= {-1, *range(8, 18)}
    assert two_views.moving_planes(plane, scene.surface != scene.surface[plane == 1][0]) == [1]


def test_a_plane_and_all_of_them_with_the_motion_are_fitted():
    R, t = motion('turning')
    scene = views(R, t, np.random.default_rng(2), 0.2)
    planes = np.array([two_views.fitted_plane(view_of(scene, scene.surface == n), R.T, -R.T @ t)
                       for n in range(4)])
    np.testing.assert_allclose(planes, scene.planes, atol=0.01)
    start = two_views.Joint(*two_views.moved(R, t, 0.01 * np.ones(5)), 1.1 * planes, None)
    found = two_views.joint(view_of(scene), np.ones(len(scene.x_cur), bool), scene.surface, start,
                            0.2)
    assert turn_between(R, found.R) < 3e-4
    assert angle_between(t, found.t) < 3e-3
    np.testing.assert_allclose(found.planes, scene.planes, atol=0.01)
    sigma = np.sqrt(np.diag(np.linalg.inv(found.information)))
    assert np.all(np.abs(found.planes - scene.planes).ravel() < 5 * sigma[5:])


def test_euler_angles_and_a_filter_without_noise():
    angles = np.array([0.3, -0.2, 0.1])
    np.testing.assert_allclose(filters.angles(filters.euler(angles)), angles)
    kalman = filters.Kalman(np.zeros(2), np.eye(2))
    kalman.predict(lambda x, n: np.array([x[0] + x[1], x[1] + n[0]]), np.array([0.5]))
    np.testing.assert_allclose(kalman.P, [[2, 1], [1, 1.5]], atol=1e-9)
    kalman.update(lambda x: np.array([3 - x[0]]), np.array([1.0]))
    np.testing.assert_allclose(kalman.x, [2, 1], atol=1e-8)
    np.testing.assert_allclose(kalman.P, [[2 / 3, 1 / 3], [1 / 3, 1.5 - 1 / 3]], atol=1e-8)


@pytest.mark.parametrize('kind', [filters.Slapse, filters.Mvo])
def test_planes_are_predicted_where_the_motion_takes_them(kind):
    R, t = filters.euler(np.array([0.02, -0.1, 0.01])), np.array([0.6, 0, 0.8])
    plane = [0.1, 0.3, 0]
    scene = kind(R, t, 0.1)
    scene.add(5, np.array(plane))
    scene.advance()
    scene.step(0.2)
    scene.advance()
    turn, way = scene.motion
    np.testing.assert_allclose(np.linalg.norm(way), 2.0)
    np.testing.assert_allclose(rotation.angle(turn), 2 * rotation.angle(R), rtol=1e-3)
    if kind is filters.Mvo:  # {W} is one motion before its first state
        R_world, t_world = scene.advance()
        expected = transform(np.array(plane), R_world.T, -R_world.T @ t_world)
    else:
        expected = transform(np.array(plane), turn.T, -turn.T @ way)
    np.testing.assert_allclose(scene.in_camera()[0], expected, atol=1e-12)
    assert np.all(np.diag(scene.P)[-6:] > 0)


def test_a_plane_that_is_not_where_it_is_expected_is_given_up():
    pipeline = pipelines.Mvo(STREET.camera)
    pipeline.scene = filters.Mvo(np.eye(3), np.array([0, 0, 1.0]), 0.1)
    for id_, plane in ((3, [0, 0.5, 0]), (8, [0.2, 0, 0])):
        pipeline.scene.add_in_camera(id_, np.array(plane))
    there = dict(zip((3, 8), pipeline.scene.in_camera(), strict=True))
    assert pipeline._verified({3: 1.1 * there[3], 8: 2 * there[8]}, 1.0) == [3]
    assert pipeline._verified({3: 2 * there[3], 8: 2 * there[8]}, 1.0) == [3, 8]


@pytest.fixture(scope='module')
def pairs():
    rng = np.random.default_rng(0)
    return [drawn.draw_pair(STREET, i, i + 4, rng, 0.25, 0.1) for i in FRAMES]


@pytest.mark.parametrize(('pipeline', 'most'), [(pipelines.Slapse, 1.0), (pipelines.Mvo, 0.5)])
def test_a_drive_is_found_by_the_printed_pipelines(pairs, pipeline, most):
    found = pipelines.run(pipeline, STREET.camera, pairs)
    assert len(found.poses) == 11
    truth = as_trajectory([(STREET.stamp(i), *STREET.pose(i)) for i in (*FRAMES, 44)])
    score = trajectory.evaluate(as_trajectory(found.poses), truth)
    assert trajectory.figures(score)['ate_mean_percent'] < most
    assert np.degrees(score.rpe_angle).max() < 0.2
    depths = [score.alignment.scale * row[5] for row in found.planes if abs(row[3]) > 0.99]
    assert np.median(depths) == pytest.approx(1.65, rel=0.05)  # the road
    again = pipelines.run(pipeline, STREET.camera, pairs[:3])
    assert np.array_equal([a[2] for a in found.poses[:4]], [b[2] for b in again.poses])


def test_a_car_is_called_moving_and_walls_are_not(pairs):
    found = pipelines.run(pipelines.Mvo, STREET.camera, pairs)
    counts = np.zeros((2, 2))  # by Definition 2 of what stands, by Definition 1 of what moves
    for k, i in enumerate(FRAMES):
        truth = drawn.draw(STREET, i, i + 4, np.random.default_rng(0))
        cell = pipelines.grid_index(truth.correspondences.x_cur, 640, 480)
        for moves in (0, 1):
            labels = (found.labels, found.blocks)[moves][k][cell]
            label = labels[(truth.label == Label.MOVING) == moves]
            counts[moves] += (label == Label.MOVING).sum(), (label != Label.UNKNOWN).sum()
    still, moving = counts[:, 0] / counts[:, 1]
    assert moving > 0.8
    assert still < 0.2


def test_a_pair_without_vectors_is_predicted(pairs):
    empty = pairs[5].__class__(pairs[5].stamp, pairs[5].previous_stamp, 640, 480, pairs[5].kind)
    for pipeline in (pipelines.Slapse, pipelines.Mvo):
        found = pipelines.run(pipeline, STREET.camera, [*pairs[3:5], empty, pairs[6]])
        ways = np.linalg.norm(np.diff([pose[2] for pose in found.poses], axis=0), axis=1)
        assert ways[2] == pytest.approx(ways[1], rel=0.05)
        assert len(found.label_table().stamps) == 4
