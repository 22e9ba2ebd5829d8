import made_up
from mv_slapse.evaluation import planes
from mv_slapse.evaluation.truth import LabelTable, TruePlane
from mv_slapse.storage.tum import Trajectory
import numpy as np
from numpy.testing import assert_allclose
import pytest
from scipy.spatial.transform import Rotation

N = 6
PERIOD = 100_000_000
GROUND = TruePlane(1, 'ground', np.array([0.0, -1, 0]), 1.65)
WALL = TruePlane(2, 'wall', np.array([-1.0, 0, 0]), 5.0)


@pytest.fixture
def truth(rng) -> Trajectory:
    turns = Rotation.from_rotvec(rng.normal(0, 0.1, (N, 3)))
    return Trajectory(PERIOD * np.arange(N), rng.normal(0, 0.5, (N, 3)), turns.as_quat())


def table_of(truth, observed, ids=None):
    """Return a planes.csv that shows each plane of ``observed`` in every key frame."""
    ids = ids or [plane.id for plane in observed]
    rows = []
    for stamp, R, t in zip(truth.stamps, truth.rotations(), truth.positions, strict=True):
        normals, depths = planes.in_camera(observed, R, t)
        rows += [(stamp, id_, *n, d, 30) for id_, n, d in zip(ids, normals, depths, strict=True)]
    names = ('stamp', 'id', 'nx', 'ny', 'nz', 'd', 'n_macroblocks')
    return dict(zip(names, np.array(rows).T, strict=True))


def labels_of(plane, label=None):
    """Return labels of four macroblocks in all key frames."""
    plane = np.tile(plane, (N, 1))
    return LabelTable(PERIOD * np.arange(N), np.arange(4.0), np.zeros(4),
                      np.zeros_like(plane) if label is None else np.tile(label, (N, 1)), plane)


def test_a_plane_keeps_its_points_in_the_camera(rng):
    R, t = made_up.rotation(rng), rng.normal(0, 10, 3)
    X = np.array([5.0, *rng.normal(size=2)])  # on the wall
    (normal,), (depth,) = planes.in_camera([WALL], R, t)
    assert normal @ (R.T @ (X - t)) + depth == pytest.approx(0)
    assert depth >= 0


def test_the_true_planes_have_no_error(truth):
    score = planes.evaluate(table_of(truth, [GROUND, WALL]), [GROUND, WALL], truth, 1.0)
    figures = planes.figures(score)
    assert figures['plane_depth_error_m'] == pytest.approx(0, abs=1e-9)
    assert figures['plane_normal_error_deg'] == pytest.approx(0, abs=1e-5)
    assert (figures['n_planes'], figures['n_plane_observations']) == (2, 2 * N)


def test_errors_are_means_over_all_observations(truth):
    table = table_of(truth, [GROUND, WALL])
    table['d'] += np.where(table['id'] == 2, 0.5, 0)
    score = planes.evaluate(table, [GROUND, WALL], truth, 1.0)
    assert planes.figures(score)['plane_depth_error_m'] == pytest.approx(0.25)


def test_the_normal_error_is_the_angle(truth):
    tilted = Rotation.from_rotvec([np.radians(3), 0, 0]).as_matrix()
    table = table_of(truth, [GROUND])
    seen = np.c_[table['nx'], table['ny'], table['nz']]
    R = truth.rotations()
    seen = np.einsum('nji,nj->ni', R, np.einsum('nij,nj->ni', R, seen) @ tilted.T)
    table |= dict(zip(('nx', 'ny', 'nz'), seen.T, strict=True))
    score = planes.evaluate(table, [GROUND, WALL], truth, 1.0)
    assert_allclose(score.true_id, 1)
    assert planes.figures(score)['plane_normal_error_deg'] == pytest.approx(3, abs=1e-6)


def test_a_plane_seen_in_three_key_frames_does_not_count(truth):
    table = table_of(truth, [GROUND, WALL])
    keep = (table['id'] == 1) | (table['stamp'] < 3 * PERIOD)
    score = planes.evaluate({k: v[keep] for k, v in table.items()}, [GROUND, WALL], truth, 1.0)
    assert (score.n_estimated, len(score.depth_error)) == (1, N)


def test_a_free_scale_is_made_metric_first(truth):
    table = table_of(truth, [WALL])
    table['d'] /= 4
    score = planes.evaluate(table, [WALL], truth, 4.0)
    assert_allclose(score.depth_error, 0, atol=1e-9)


def test_labels_decide_which_plane_is_meant(truth):
    near = TruePlane(3, 'ledge', WALL.normal, 4.5)
    table = table_of(truth, [WALL], ids=[70])
    labels = labels_of([70, 70, 70, -1]), labels_of([3, 3, 2, 1])
    score = planes.evaluate(table, [WALL, near], truth, 1.0, labels)
    assert_allclose(score.true_id, 3)
    assert_allclose(score.depth_error, 0.5, atol=1e-9)
    assert_allclose(score.purity, 2 / 3)


def test_observations_on_one_plane_are_counted(truth):
    table = table_of(truth, [GROUND, WALL], ids=[10, 20])
    labels = labels_of([10, 10, 20, 20]), labels_of([1, 1, 1, 2])
    figures = planes.figures(planes.evaluate(table, [GROUND, WALL], truth, 1.0, labels))
    assert figures['plane_observations_on_one_plane_percent'] == 50


def test_wrong_vectors_and_blocks_of_unknown_truth_do_not_count(truth):
    table = table_of(truth, [WALL], ids=[20])
    labels = (labels_of([20, 20, 20, 20], [0, 0, 1, 0]),
              labels_of([2, 2, 1, 1], [0, 0, 0, -1]))
    score = planes.evaluate(table, [GROUND, WALL], truth, 1.0, labels)
    assert_allclose(score.purity, 1)


def test_no_observation_gives_no_figure(truth):
    table = {name: values[:0] for name, values in table_of(truth, [WALL]).items()}
    figures = planes.figures(planes.evaluate(table, [WALL], truth, 1.0))
    assert figures['plane_depth_error_m'] is None
    assert figures['n_planes'] == 0
