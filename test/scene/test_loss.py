"""The scene filter without a view: predicted, lost, and after it."""

from dataclasses import replace

from mv_slapse.config import SceneSettings
from mv_slapse.geometry import rotation
from mv_slapse.records import MotionStatus, TrackingStatus
from mv_slapse.scene.filter import SceneFilter
import numpy as np
import pytest
from scene_drive import assert_is_covariance, Canyon, driven, METRIC, position_errors, SPEED


def test_a_lost_pair_is_predicted_and_the_filter_goes_on():
    canyon, filter_ = Canyon(), SceneFilter(METRIC)
    before = driven(canyon, 10, filter_=filter_)[-1]
    gap = [filter_.step(canyon.blank(k))[0] for k in (11, 12)]
    assert [e.status for e in gap] == [TrackingStatus.PREDICTED] * 2
    assert gap[0].reason == 'the packet was lost'
    volumes = [np.trace(e.pose_covariance) for e in (before, *gap)]
    assert volumes[0] < volumes[1] < volumes[2]
    assert max(position_errors(canyon, gap, 11)) < 0.1
    after = driven(canyon, 20, filter_=filter_, first=13)
    assert after[0].status is TrackingStatus.OK
    assert max(position_errors(canyon, after, 13)) < 0.3
    assert np.trace(after[-1].pose_covariance) < volumes[-1] * 3


def test_a_clock_that_is_set_back_is_taken_for_the_usual_time():
    canyon, filter_, back = Canyon(), SceneFilter(METRIC), 10_000_000_000
    driven(canyon, 10, filter_=filter_)
    torn = replace(canyon.blank(11), stamp=canyon.blank(11).stamp - back)
    gap, _ = filter_.step(torn)
    assert gap.status is TrackingStatus.PREDICTED
    assert max(position_errors(canyon, [gap], 11)) < 0.1
    after = [filter_.step(replace(pair, stamp=pair.stamp - back,
                                  previous_stamp=pair.previous_stamp - back))[0]
             for pair in map(canyon.extraction, range(12, 20))]
    assert all(estimate.status is TrackingStatus.OK for estimate in after)
    assert max(position_errors(canyon, after, 12)) < 0.3
    lost = [filter_.step(replace(pair, stamp=pair.stamp - back, previous_stamp=(
        pair.previous_stamp - back)))[0].status for pair in map(canyon.blank, range(20, 34))]
    assert lost[-1] is TrackingStatus.LOST


def test_lost_comes_after_lost_after_and_ends_with_a_view(rng):
    canyon, filter_ = Canyon(), SceneFilter(METRIC)
    driven(canyon, 5, filter_=filter_)
    statuses = [filter_.step(canyon.blank(k))[0].status for k in range(6, 20)]
    # Ten key frames are a second: lost_after.
    assert statuses == [TrackingStatus.PREDICTED] * 10 + [TrackingStatus.LOST] * 4
    estimate = filter_.step(canyon.blank(20))[0]
    assert 'nothing observed for 1.5 s' in estimate.reason
    found = driven(canyon, 21, filter_=filter_, first=21)[0]
    assert found.status is TrackingStatus.OK
    assert nees(canyon, found, 21) < 25


def nees(canyon, estimate, k):
    R, t = canyon.pose(k)
    error = np.r_[t - estimate.t_world_from_cam, rotation.log(R @ estimate.R_world_from_cam.T)]
    return error @ np.linalg.solve(estimate.pose_covariance, error)


@pytest.mark.parametrize('lost', [1, 15])
def test_pairs_that_never_come_are_predicted_through(rng, lost):
    """The pair after a gap relates its own two key frames, not the last one seen to it."""
    canyon, filter_ = Canyon(rng, 0.3), SceneFilter(METRIC)
    before = driven(canyon, 10, filter_=filter_)[-1]
    after = driven(canyon, 16 + lost, filter_=filter_, first=11 + lost)
    assert after[0].status is TrackingStatus.OK
    assert after[0].baseline == pytest.approx(0.1 * SPEED, rel=0.1)
    assert np.trace(after[0].pose_covariance) > 1.2 * np.trace(before.pose_covariance)
    assert all(nees(canyon, e, 11 + lost + i) < 25 for i, e in enumerate(after))


@pytest.mark.parametrize('settings', [METRIC, SceneSettings()])
def test_after_two_seconds_without_a_view_the_covariance_covers_the_error(rng, settings):
    """The road bends and the car brakes meanwhile."""
    canyon = Canyon(rng, 0.3, yaw_rate=0.3, way=lambda time: SPEED * min(time, 2.0) + 0.6 * SPEED
                    * max(time - 2.0, 0.0))
    filter_ = SceneFilter(settings)
    unit = 1.0 if settings.camera_height else 0.1 * SPEED
    driven(canyon, 10, filter_=filter_)
    statuses = [filter_.step(canyon.blank(k))[0].status for k in range(11, 31)]
    after = driven(canyon, 50, filter_=filter_, first=31)
    assert statuses[-1] is TrackingStatus.LOST
    assert all(e.status is TrackingStatus.OK for e in after[5:])
    for i, estimate in enumerate(after):
        error = canyon.pose(31 + i)[1] / unit - estimate.t_world_from_cam
        assert error @ np.linalg.solve(estimate.pose_covariance[:3, :3], error) < 14.2
    assert 0.1 < after[-1].pose_covariance[4, 4]**0.5 < 0.7  # what a car may have turned


def test_a_mounted_camera_stays_upright_while_nothing_is_seen():
    canyon, filter_ = Canyon(), SceneFilter(METRIC)
    driven(canyon, 10, filter_=filter_)
    for k in range(11, 31):
        estimate = filter_.step(canyon.blank(k))[0]
    pitch, yaw, roll = np.sqrt(np.diag(estimate.pose_covariance))[3:]
    assert max(pitch, roll) < 0.05 < 0.5 < yaw
    assert estimate.pose_covariance[1, 1]**0.5 < 0.6  # m: the road itself may rise


def test_a_heading_that_was_lost_stays_as_uncertain_as_it_was(rng):
    """Pairs relate cameras to each other: none of them tells how the first one turned."""
    canyon, filter_ = Canyon(rng, 0.3), SceneFilter(METRIC)
    before = driven(canyon, 10, filter_=filter_)[-1]
    after = driven(canyon, 50, filter_=filter_, first=31)
    heading = [e.pose_covariance[4, 4]**0.5 for e in after]
    assert before.pose_covariance[4, 4]**0.5 < 0.01
    assert min(heading) > 0.99 * heading[0] > 0.4
    assert all(e.status is TrackingStatus.OK for e in after)
    assert [e.baseline for e in after[5:]] == pytest.approx([0.1 * SPEED] * 15, rel=0.1)
    assert all(nees(canyon, e, 31 + i) < 25 for i, e in enumerate(after))


@pytest.mark.parametrize('settings', [METRIC, SceneSettings()])
@pytest.mark.parametrize('step', [1, 60, 3600, 86400, -1, -60, -86400])
def test_a_clock_that_steps_does_not_carry_the_pose_away(settings, step):
    """Lost or right, and found again with the next pair, in a frame that is counted as new."""
    canyon, filter_, step = Canyon(), SceneFilter(settings), step * 10**9
    unit = 1.0 if settings.camera_height else 0.1 * SPEED
    driven(canyon, 10, filter_=filter_)
    torn = replace(canyon.blank(11), stamp=canyon.blank(11).stamp + step)
    estimates = [filter_.step(torn)[0]]
    for pair in map(canyon.extraction, range(12, 32)):
        estimates.append(filter_.step(replace(pair, stamp=pair.stamp + step,
                                              previous_stamp=pair.previous_stamp + step))[0])
    assert estimates[0].status is (TrackingStatus.LOST if step > 0 else TrackingStatus.PREDICTED)
    assert all(e.status is TrackingStatus.OK for e in estimates[1:])
    assert estimates[-1].resets == (step > 0)
    for k, estimate in enumerate(estimates):
        assert_is_covariance(estimate.pose_covariance)
        error = canyon.pose(11 + k)[1] / unit - estimate.t_world_from_cam
        assert np.linalg.norm(error) * unit < 10
        assert error @ np.linalg.solve(estimate.pose_covariance[:3, :3], error) < 14.2


@pytest.mark.parametrize('apart', [1, 1000])
def test_pairs_that_are_no_time_apart_leave_the_velocity_as_it_was(apart):
    """As a clock that stands still shows them: usual time has passed."""
    canyon, filter_ = Canyon(), SceneFilter(METRIC)
    driven(canyon, 10, filter_=filter_)
    for i in range(5):
        pair = canyon.extraction(11 + i)
        pair = replace(pair, previous_stamp=canyon.extraction(10).stamp + apart * i,
                       stamp=canyon.extraction(10).stamp + apart * (i + 1))
        estimate = filter_.step(pair)[0]
        assert_is_covariance(estimate.pose_covariance)
        assert np.linalg.norm(estimate.velocity_world) == pytest.approx(SPEED, rel=0.1)
    assert max(position_errors(canyon, [estimate], 15)) < 0.3


def test_a_pose_goes_no_farther_than_a_prediction_says_something():
    canyon, filter_ = Canyon(), SceneFilter(METRIC)
    before = driven(canyon, 10, filter_=filter_)[-1]
    gone = [filter_.step(canyon.blank(k))[0] for k in range(11, 400)]
    way = [np.linalg.norm(e.t_world_from_cam - before.t_world_from_cam) for e in gone]
    assert way[48] == pytest.approx(4.9 * SPEED, rel=0.1)
    assert max(way) < 5.2 * SPEED
    assert {e.status for e in gone[10:]} == {TrackingStatus.LOST}
    found = filter_.step(canyon.extraction(400))[0]
    assert (found.status, found.resets) == (TrackingStatus.OK, 1)


def test_a_first_pair_and_a_stop_leave_a_speed_to_start_again_with():
    """Else the next baseline is guessed as zero, whose logarithm is none, and P no covariance."""
    canyon, filter_ = Canyon(), SceneFilter(SceneSettings())
    filter_.step(canyon.extraction(1))
    filter_.step(canyon.blank(2, MotionStatus.STANDSTILL))
    pair = canyon.extraction(3)
    estimate = filter_.step(replace(pair, planes=(), plane_id=np.full_like(pair.plane_id, -1),
                                    baseline_ratio_sigma=np.inf))[0]
    assert estimate.repairs == 0
    assert np.sqrt(np.diag(estimate.pose_covariance)[:3]).max() < 1
    assert estimate.baseline == pytest.approx(0.1, rel=0.5)  # a tenth of the first
