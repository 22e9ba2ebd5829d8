import made_up
from mv_slapse.errors import UnusableInput
from mv_slapse.evaluation import trajectory
from mv_slapse.storage.tum import Trajectory
import numpy as np
from numpy.testing import assert_allclose, assert_array_equal
import pytest
from scipy.spatial.transform import Rotation

PERIOD = 100_000_000


def made_up_path(rng, n=40) -> Trajectory:
    """Return a bent walk of some 80 m."""
    turns = Rotation.from_rotvec(np.cumsum(rng.normal(0, 0.05, (n, 3)), axis=0))
    steps = turns.apply([0.0, 0, 2.0])
    return Trajectory(PERIOD * np.arange(n), np.cumsum(steps, axis=0), turns.as_quat())


def moved(path: Trajectory, R, t, scale=1.0) -> Trajectory:
    turned = Rotation.from_matrix(R) * Rotation.from_quat(path.quaternions)
    return Trajectory(path.stamps, scale * path.positions @ R.T + t, turned.as_quat())


def disturbed(path: Trajectory, rng, sigma=0.1) -> Trajectory:
    turns = Rotation.from_rotvec(rng.normal(0, 0.02, (len(path), 3)))
    return Trajectory(path.stamps, path.positions + rng.normal(0, sigma, path.positions.shape),
                      (turns * Rotation.from_quat(path.quaternions)).as_quat())


def test_alignment_finds_the_similarity(rng):
    X, R, t = rng.normal(size=(10, 3)), made_up.rotation(rng), rng.normal(size=3)
    found = trajectory.align(X, 2.5 * X @ R.T + t)
    assert_allclose(found.R, R, atol=1e-12)
    assert_allclose([found.scale, *found.t], [2.5, *t])


def test_rigid_alignment_keeps_the_scale(rng):
    X = rng.normal(size=(10, 3))
    found = trajectory.align(X, 2.5 * X, with_scale=False)
    assert found.scale == 1
    assert_allclose(found.R, np.eye(3), atol=1e-12)


def test_alignment_never_mirrors(rng):
    X = rng.normal(size=(10, 3))
    found = trajectory.align(X, X * [1, 1, -1])
    assert_allclose(np.linalg.det(found.R), 1)


def test_points_in_one_place_align_without_scale():
    found = trajectory.align(np.zeros((4, 3)), np.ones((4, 3)))
    assert_allclose([found.scale, *found.t], [1, 1, 1, 1])


def test_association_takes_the_nearest_within_the_tolerance():
    truth = np.array([0, 100, 200, 300])
    i, j = trajectory.associate(np.array([-4, 96, 104, 150, 301]), truth, tolerance=10)
    assert_array_equal(i, [0, 1, 4])  # two ask for 100, as near; 150 is too far from any
    assert_array_equal(j, [0, 1, 3])


def test_association_with_nothing_is_empty():
    i, j = trajectory.associate(np.array([1, 2]), np.zeros(0, int))
    assert not len(i)
    assert not len(j)


def test_a_moved_and_scaled_trajectory_has_no_error(rng):
    truth = made_up_path(rng)
    R, t = made_up.rotation(rng), rng.normal(size=3)
    figures = trajectory.figures(trajectory.evaluate(moved(truth, R, t, 0.5), truth))
    assert_allclose([figures[name] for name in ('ate_mean_m', 'ate_max_m', 'rpe_mean_m',
                                                'rpe_mean_deg', 'rpe_10m_percent')], 0, atol=1e-5)
    assert figures['scale'] == pytest.approx(2)
    assert figures['distance_m'] == pytest.approx(2 * 39)
    assert figures['ate_rigid_mean_percent'] > 5


def test_the_error_of_one_pose_is_found_where_it_is(rng):
    truth = made_up_path(rng)
    positions = truth.positions.copy()
    positions[7] += [0, 3, 0]
    score = trajectory.evaluate(Trajectory(truth.stamps, positions, truth.quaternions), truth)
    assert score.ate.argmax() == 7
    assert score.ate[7] == pytest.approx(3, abs=0.5)
    assert set(np.argsort(score.rpe)[-2:]) == {6, 7}


def test_the_distance_counts_the_truth_between_the_associated_poses(rng):
    truth = made_up_path(rng)
    part = Trajectory(truth.stamps[4:20:5], truth.positions[4:20:5], truth.quaternions[4:20:5])
    score = trajectory.evaluate(part, truth)
    assert score.n_poses == 4
    assert score.distance == pytest.approx(2 * 15)


def test_too_few_common_stamps_are_named(rng):
    truth = made_up_path(rng)
    late = Trajectory(truth.stamps + 10**18, truth.positions, truth.quaternions)
    with pytest.raises(UnusableInput, match='only 0 of 40 poses.*--stamp-offset'):
        trajectory.evaluate(late, truth)


def test_a_camera_that_stands_still_has_errors_in_metres_only():
    still = Trajectory(PERIOD * np.arange(4), np.zeros((4, 3)), np.tile([0.0, 0, 0, 1], (4, 1)))
    figures = trajectory.figures(trajectory.evaluate(still, still))
    assert figures['ate_mean_m'] == 0
    assert figures['ate_mean_percent'] is None


def test_evo_gives_the_same_figures(rng):
    pytest.importorskip('evo')
    from evo.core import metrics, sync
    from evo.core.trajectory import PoseTrajectory3D
    truth = made_up_path(rng)
    estimate = disturbed(moved(truth, made_up.rotation(rng), rng.normal(size=3), 0.4), rng)
    score = trajectory.evaluate(estimate, truth)
    pair = sync.associate_trajectories(*(PoseTrajectory3D(
        path.positions, np.roll(path.quaternions, 1, axis=1), path.stamps / 1e9)
        for path in (truth, estimate)))
    for with_scale, ours in ((False, score.ate_rigid), (True, score.ate)):
        pair[1].align(pair[0], correct_scale=with_scale)
        ape = metrics.APE(metrics.PoseRelation.translation_part)
        ape.process_data(pair)
        assert_allclose(ours, ape.error, rtol=1e-6)
    for relation, ours in ((metrics.PoseRelation.translation_part, score.rpe),
                           (metrics.PoseRelation.rotation_angle_rad, score.rpe_angle)):
        rpe = metrics.RPE(relation, delta=1, delta_unit=metrics.Unit.frames)
        rpe.process_data(pair)
        assert_allclose(ours, rpe.error, rtol=1e-6, atol=1e-9)


def test_drift_at_rest_is_the_farthest_from_where_a_standstill_began():
    """Drives 2 s, rests 2 s, drives on; the estimate creeps by 3 mm while it rests, and back."""
    time = np.arange(60) * 0.1
    way = np.clip(time, 0, 2) + np.clip(time - 4, 0, None)
    target = np.c_[way, 0 * way, 0 * way]
    source = target.copy()
    source[25:30, 1] += 0.003
    stamps = (time * 1e9).astype(np.int64)
    assert trajectory._standstill_drift(source, target, stamps) == pytest.approx(0.003)
    assert trajectory._standstill_drift(source[:28], target[:28], stamps[:28]) is None


def test_epsilon_d_is_the_mean_share_by_which_the_way_from_the_first_pose_is_off(rng):
    truth, R = made_up_path(rng), made_up.rotation(rng)
    longer = moved(truth, R, np.array([3.0, 1, 2]), 1.02)
    assert_allclose(trajectory.epsilon_d(longer, truth, is_metric=True), 2)
    # Where the scale is free the first step is the unit.
    assert_allclose(trajectory.epsilon_d(longer, truth, is_metric=False), 0, atol=1e-9)
    turned = Trajectory(truth.stamps, truth.positions, np.roll(truth.quaternions, 1, axis=0))
    turned.quaternions[0] = (Rotation.from_quat(truth.quaternions[0])
                             * Rotation.from_rotvec([0, 0.03, 0])).as_quat()
    assert_allclose(trajectory.epsilon_d(turned, truth, is_metric=True), 3, rtol=0.1)
    still = Trajectory(truth.stamps, 0 * truth.positions, truth.quaternions)
    assert trajectory.epsilon_d(still, still, is_metric=True) is None
