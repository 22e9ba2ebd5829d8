from dataclasses import replace

from mv_slapse.evaluation import consistency
from mv_slapse.records import ScaleStatus, SceneEstimate, TrackingStatus
from mv_slapse.storage.tum import Trajectory
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

N = 400


def made_up_pair(rng, sigma, scale=1.0, n_wrong=0):
    """Return an estimate of errors sigma, its covariances and the truth, in another frame."""
    stamps = 100_000_000 * np.arange(N)
    heading = np.cumsum(rng.normal(0, 0.05, N))
    turns = Rotation.from_rotvec(heading[:, None] * [0, 1.0, 0])
    positions = np.cumsum(turns.apply([0, 0, 1.0]), axis=0)
    positions, turns = positions - positions[0], turns[0].inv() * turns
    error = rng.normal(0, sigma, (N, 6))
    error[0] = 0
    error[1:1 + n_wrong, :3] += 3.0
    estimate = Trajectory(stamps, positions + error[:, :3],
                          (Rotation.from_rotvec(error[:, 3:]) * turns).as_quat())
    frame = Rotation.from_rotvec([0.3, -1.0, 0.5])
    truth = Trajectory(stamps, frame.apply(positions / scale) + [5, 6, 7],
                       (frame * turns).as_quat())
    return estimate, {int(stamp): np.eye(6) * sigma**2 for stamp in stamps[1:]}, truth


def test_honest_covariances_cover_the_errors(rng):
    found = consistency.figures(*made_up_pair(rng, 0.05), is_metric=True, is_exact=True)
    assert found['position_covered_percent'] == pytest.approx(99.73, abs=0.8)
    assert found['pose_nees'] == pytest.approx(6, rel=0.1)


def test_covariances_three_times_too_small_do_not(rng):
    estimate, covariances, truth = made_up_pair(rng, 0.06)
    small = {stamp: P / 9 for stamp, P in covariances.items()}
    found = consistency.figures(estimate, small, truth, is_metric=True, is_exact=True)
    assert found['position_covered_percent'] < 80  # 65 % lie within one sigma in three dimensions
    assert found['pose_nees'] == pytest.approx(54, rel=0.1)


def test_small_errors_of_small_covariances_count_as_much(rng):
    estimate, covariances, truth = made_up_pair(rng, 2e-4)
    small = {stamp: P / 9 for stamp, P in covariances.items()}
    found = consistency.figures(estimate, small, truth, is_metric=True, is_exact=True)
    assert found['pose_nees'] == pytest.approx(54, rel=0.1)


def test_a_free_scale_is_aligned_and_a_metric_one_is_not(rng):
    given = made_up_pair(rng, 0.05, scale=3.0)
    covered = [consistency.figures(*given, is_metric=metric, is_exact=False)
               for metric in (False, True)]
    assert covered[0]['position_covered_percent'] > 98
    assert covered[1]['position_covered_percent'] < 50
    assert covered[0]['pose_nees'] is None


def test_with_free_scale_the_first_baseline_is_the_unit(rng):
    estimate, covariances, truth = made_up_pair(rng, 1e-3)
    unit = np.linalg.norm(estimate.positions[1])
    own = Trajectory(estimate.stamps, estimate.positions / unit, estimate.quaternions)
    i = np.arange(N)
    error = consistency.pose_errors(own, truth, i, i, is_metric=False)
    assert np.abs(error[1, :3] @ own.positions[1]) < 1e-5  # of no length, but of direction
    assert 1e-4 < np.std(error[:20, :3]) < 0.02


def test_a_few_wrong_poses_do_not_turn_the_alignment(rng):
    """As where a recorded truth is wrong until its receiver has settled."""
    found = consistency.figures(*made_up_pair(rng, 0.05, n_wrong=20), is_metric=True,
                                is_exact=False)
    assert found['position_covered_percent'] == pytest.approx(95, abs=1)


def test_poses_without_covariances_have_no_figures(rng):
    estimate, _, truth = made_up_pair(rng, 0.05)
    found = consistency.figures(estimate, {}, truth, is_metric=True, is_exact=True)
    assert found == {'position_covered_percent': None, 'pose_nees': None}


def scenes_along(rng, n=20, jump=0.0, resets=0):
    """Return poses 0.1 s apart of 10 m/s but for 0.1 m/s, with a jump in their midst [m]."""
    made, t = [], np.zeros(3)
    for i in range(n):
        velocity = np.array([10.0, 0, 0]) + rng.normal(0, 0.1, 3)
        t = t + 0.1 * velocity + [0, jump * (i == n // 2), 0]
        made.append(SceneEstimate(
            i * 10**8, TrackingStatus.OK, '', np.eye(3), t, np.eye(6), velocity, np.zeros(3),
            0.01 * np.eye(6), ScaleStatus.METRIC, 'speed', resets=resets * (i >= n // 2)))
    return made


def test_steps_that_the_twist_explains_are_no_jumps(rng):
    assert consistency.unexplained_step(scenes_along(rng)) == 0
    assert consistency.unexplained_step([]) is None


def test_a_jump_is_found_but_where_a_new_frame_is_told(rng):
    # 3 sigma of 0.1 m/s in 0.1 s, and of a position that may have been corrected by so much
    explained = 3 * np.hypot(0.01, np.sqrt(1.01**2 - 1))
    assert consistency.unexplained_step(scenes_along(rng, jump=2.0)) == pytest.approx(
        2 - explained, abs=0.05)
    assert consistency.unexplained_step(scenes_along(rng, jump=2.0, resets=1)) == 0


def test_a_correction_is_explained_by_what_it_has_made_more_certain(rng):
    made = scenes_along(rng, jump=2.0)
    sure = [replace(scene, pose_covariance=0.04 * np.eye(6)) for scene in made[10:]]
    assert consistency.unexplained_step(made[:10] + sure) == 0
