"""The scene filter on a camera that rests or turns on the spot, and drives on."""

from dataclasses import replace

import canyon as canyon_views
from mv_slapse.config import SceneSettings
from mv_slapse.geometry import rotation
from mv_slapse.records import (
    CameraMotion,
    Label,
    MotionStatus,
    ScaleStatus,
    Speed,
    TrackingStatus,
)
from mv_slapse.scene.filter import SceneFilter
from mv_slapse.scene.scale import rest as scene_rest
import numpy as np
import pytest
from scene_drive import (
    assert_is_covariance,
    Canyon,
    driven,
    HEIGHT,
    METRIC,
    position_errors,
    SPEED,
)

WALL = 1


def test_a_standing_camera_does_not_drift_by_a_bit():
    canyon, filter_ = Canyon(), SceneFilter(METRIC)
    before = driven(canyon, 10, filter_=filter_)[-1]
    for k in range(11, 60):
        still = filter_.step(canyon.blank(k, MotionStatus.STANDSTILL, ''))[0]
    np.testing.assert_array_equal(still.t_world_from_cam, before.t_world_from_cam)
    np.testing.assert_array_equal(still.R_world_from_cam, before.R_world_from_cam)
    np.testing.assert_array_equal(still.pose_covariance, before.pose_covariance)
    np.testing.assert_array_equal(np.r_[still.velocity_world, still.omega_cam], 0)
    assert still.status is TrackingStatus.OK
    assert still.baseline == 0
    assert_is_covariance(filter_._state.P)


@pytest.mark.parametrize(('speed', 'doubted'), [(8.0, 11), (1.5, 0)])
def test_a_stop_that_no_brake_makes_is_doubted_for_as_long_as_braking_takes(speed, doubted):
    """5 standard deviations of 1.5 m/s^1.5: 8 m/s take 1.1 s, as a frozen stream may tell."""
    canyon, filter_ = Canyon(way=lambda time: speed * time), SceneFilter(METRIC)
    before = driven(canyon, 10, filter_=filter_)[-1]
    stood = [filter_.step(canyon.blank(k, MotionStatus.STANDSTILL, ''))[0] for k in range(11, 41)]
    assert [one.status for one in stood] == doubted * [TrackingStatus.PREDICTED] + (
        30 - doubted) * [TrackingStatus.OK]
    for k, one in enumerate(stood[:doubted], 1):
        assert 'the stream may be frozen' in one.reason
        assert one.twist_covariance[2, 2]**0.5 > 0.9 * speed
        assert one.pose_covariance[2, 2]**0.5 > 0.9 * speed * 0.1 * k
    np.testing.assert_array_equal(stood[-1].pose_covariance, before.pose_covariance)
    np.testing.assert_array_equal(stood[-1].t_world_from_cam, before.t_world_from_cam)


def test_a_stop_is_doubted_where_the_clock_stands_too():
    """Two pictures with one stamp: the camera has gone no way, but it may be as fast."""
    scene = driven(Canyon(), 3)[-1]
    doubted = scene_rest.Stop(scene.stamp, np.array([0, 0, 5.0])).doubted(scene)
    np.testing.assert_array_equal(doubted.pose_covariance, scene.pose_covariance)
    assert (doubted.twist_covariance - scene.twist_covariance)[2, 2] == pytest.approx(25)


def stood(filter_, canyon, keys, speed):
    """Return what the filter says of pictures that stand still, wheels having told a speed."""
    return [filter_.step(canyon.blank(k, MotionStatus.STANDSTILL, ''), (),
                         [Speed(round(1e8 * (k - 0.5)), speed)])[0] for k in keys]


@pytest.mark.parametrize('status', [MotionStatus.STANDSTILL, MotionStatus.ROTATION_ONLY])
def test_a_picture_that_stands_while_wheels_drive_is_doubted_as_long_as_they_do(status):
    canyon, filter_ = Canyon(way=lambda time: 1.5 * time), SceneFilter(METRIC)
    before = driven(canyon, 10, filter_=filter_)[-1]
    stood(filter_, canyon, (11, 12), 1.5)  # of the first one half is not told
    frozen = [filter_.step(canyon.blank(k, status, ''), (), [Speed(10**8 * k, 1.5)])[0]
              for k in range(13, 63)]
    assert {one.status for one in frozen} == {TrackingStatus.PREDICTED}
    assert all('speed given' in one.reason for one in frozen)
    assert 0.9 < frozen[-1].pose_covariance[2, 2]**0.5 / (1.5 * 5.2) < 1.5
    assert 0.9 < frozen[-1].twist_covariance[2, 2]**0.5 / 1.5 < 1.5
    rest = stood(filter_, canyon, range(63, 66), 0.0)
    assert rest[-1].status is TrackingStatus.OK
    np.testing.assert_allclose(rest[-1].t_world_from_cam, before.t_world_from_cam, atol=1e-3)
    assert rest[-1].pose_covariance[2, 2]**0.5 < 0.1


def test_a_picture_that_stands_from_the_start_is_doubted_while_wheels_drive():
    still = stood(SceneFilter(METRIC), Canyon(), range(1, 8), 4.0)
    assert {one.status for one in still[2:]} == {TrackingStatus.PREDICTED}
    assert still[-1].pose_covariance[2, 2]**0.5 > 1.5


@pytest.mark.parametrize('speed', [0.0, 0.03, 0.1])
def test_wheels_that_creep_by_less_than_a_picture_shows_doubt_no_rest(speed):
    canyon, filter_ = Canyon(way=lambda time: 1.5 * time), SceneFilter(METRIC)
    driven(canyon, 10, filter_=filter_)
    assert {one.status for one in stood(filter_, canyon, range(12, 30), speed)} == {
        TrackingStatus.OK}


def test_a_camera_that_stands_from_the_start_is_ok():
    canyon, filter_ = Canyon(), SceneFilter(METRIC)
    first = filter_.step(canyon.blank(1, MotionStatus.STANDSTILL, ''))[0]
    assert first.status is TrackingStatus.OK
    np.testing.assert_array_equal(first.t_world_from_cam, 0)


def turning(canyon, k, R, R_before):
    """Return what a turn on the spot from R_before to R (world from camera) shows."""
    blank = canyon.blank(k, MotionStatus.ROTATION_ONLY, '')
    covariance = np.diag([1e-8] * 3 + [0.0] * 3)
    return replace(blank, motion=CameraMotion(MotionStatus.ROTATION_ONLY, R.T @ R_before,
                                              covariance=covariance))


def turns(canyon, filter_, first, last):
    """Yield each turn (world from camera), aside and back, and what the filter says of it."""
    R_start, _ = canyon.pose(first - 1)
    R_last = R_start
    for k in range(first, last + 1):
        share = (k - first + 1) / (last - first + 1)
        R = R_start @ rotation.exp(np.array([0, 1.2 * np.sin(np.pi * share), 0]))
        yield R, filter_.step(turning(canyon, k, R, R_last))[0]
        R_last = R


@pytest.mark.parametrize('settings', [METRIC, SceneSettings()])
def test_a_turn_on_the_spot_leaves_the_position_and_the_scale(settings):
    """It stops, looks aside and back for four seconds, and drives on."""
    def way(time):
        return SPEED * min(time, 1.0) + 1.5 * max(time - 5.0, 0.0)**2

    canyon, filter_ = Canyon(way=way), SceneFilter(settings)
    driven(canyon, 10, settings, filter_)
    places = []
    for R, spun in turns(canyon, filter_, 11, 50):
        assert spun.status in (TrackingStatus.OK, TrackingStatus.PREDICTED)
        assert canyon_views.turn_between(spun.R_world_from_cam, R) < 2e-3
        places.append(spun.t_world_from_cam)
    assert spun.status is TrackingStatus.OK
    unit = 1.0 if settings.camera_height else 0.1 * SPEED
    assert np.linalg.norm(unit * spun.t_world_from_cam - canyon.pose(10)[1]) < 0.05
    # A stop from full speed within one pair is hard to believe; then nothing drifts.
    np.testing.assert_allclose(spun.t_world_from_cam, places[1], atol=1e-3)
    assert unit * np.linalg.norm(spun.velocity_world) < 0.01
    after = driven(canyon, 65, settings, filter_, first=51)
    lengths = [unit * e.baseline for e in after]
    truth = [np.linalg.norm(canyon.motion(k)[1]) for k in range(51, 66)]
    np.testing.assert_allclose(lengths[4:], truth[4:], rtol=0.04)
    assert max(position_errors(canyon, after, 51, unit)) < 0.15


def test_a_turn_before_the_first_motion_is_followed():
    canyon, filter_ = Canyon(), SceneFilter(METRIC)
    R = rotation.exp(np.array([0, 0.3, 0]))
    first = filter_.step(turning(canyon, 1, R, np.eye(3)))[0]
    assert first.status is TrackingStatus.INITIALISING
    np.testing.assert_allclose(first.R_world_from_cam, R, atol=1e-9)
    np.testing.assert_array_equal(first.t_world_from_cam, 0)
    assert np.trace(first.pose_covariance[3:, 3:]) > 0


def test_a_camera_that_stands_first_has_its_unit_from_the_first_motion():
    canyon, filter_ = Canyon(), SceneFilter(SceneSettings())
    for k in (1, 2, 3):
        filter_.step(canyon.blank(k, MotionStatus.STANDSTILL, ''))
    after = driven(canyon, 12, SceneSettings(), filter_, first=4)
    assert after[0].baseline == pytest.approx(1.0, abs=1e-3)
    assert after[-1].baseline == pytest.approx(1.0, abs=0.02)


def test_it_drives_on_after_standing():
    def way(time):
        """Brake from 8 m/s at 4 m/s^2, stand half a second, pull away at 3 m/s^2."""
        braking, away = min(time, 2.0), max(time - 2.5, 0.0)
        return 8 * braking - 2 * braking**2 + 1.5 * away**2

    canyon, filter_ = Canyon(way=way), SceneFilter(METRIC)
    driven(canyon, 20, filter_=filter_)
    for k in range(21, 26):
        filter_.step(canyon.blank(k, MotionStatus.STANDSTILL, ''))
    after = driven(canyon, 45, filter_=filter_, first=26)
    assert max(position_errors(canyon, after, 26)) < 0.15  # 1 % of the way
    assert after[-1].velocity_world @ canyon.pose(45)[0][:, 2] == pytest.approx(6.0, abs=0.3)


def test_a_free_scale_outlasts_a_camera_that_nearly_stops():
    def way(time):
        """Brake from 8 m/s to 0.4 m/s in two seconds, and pull away as hard."""
        turn = 2.0
        if time < turn:
            return 8 * time - 1.9 * time**2
        return 8 * turn - 1.9 * turn**2 + 0.4 * (time - turn) + 1.9 * (time - turn)**2

    canyon = Canyon(way=way)
    estimates = driven(canyon, 40, SceneSettings())
    unit = np.linalg.norm(canyon.motion(1)[1])
    assert max(position_errors(canyon, estimates, scale=unit)) < 0.02 * way(4.0)


def test_before_the_ground_is_seen_the_unit_is_what_it_would_tell():
    canyon, filter_ = Canyon(), SceneFilter(METRIC)
    bare = replace(canyon.extraction(1), planes=())
    estimate = filter_.step(bare)[0]
    assert np.linalg.norm(estimate.t_world_from_cam) == pytest.approx(0.1 * SPEED, rel=0.05)
    assert estimate.scale_status is ScaleStatus.UNKNOWN
    above = bare.x_cur[:, 1] < bare.K[1, 2]
    none = replace(bare, label=np.where(above, bare.label, Label.UNKNOWN).astype(np.int8))
    assert scene_rest.supposed_baseline(none, HEIGHT) == 0


def test_a_unit_that_drifts_in_a_turn_is_put_right_by_the_ground():
    """The map's depths are half as large again after a turn; the height is known."""
    def way(time):
        return SPEED * min(time, 1.0) + 1.5 * max(time - 3.0, 0.0)**2

    canyon, filter_ = Canyon(way=way), SceneFilter(METRIC)
    driven(canyon, 10, METRIC, filter_)
    for _ in turns(canyon, filter_, 11, 30):
        pass
    before, first = (np.linalg.norm(canyon.motion(k)[1]) for k in (10, 31))
    shown = replace(canyon.extraction(31), baseline_ratio=np.log(1.5 * first / before),
                    baseline_ratio_sigma=0.002)
    after = [filter_.step(shown)[0], *driven(canyon, 40, METRIC, filter_, first=32)]
    truth = [np.linalg.norm(canyon.motion(k)[1]) for k in range(31, 41)]
    np.testing.assert_allclose([e.baseline for e in after][2:], truth[2:], rtol=0.03)
