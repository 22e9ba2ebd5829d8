"""A filter that is told the speed: on its own, with slip, over a gap, after a rest."""

from dataclasses import replace

from mv_slapse.config import SceneSettings
from mv_slapse.evaluation.consistency import unexplained_step
from mv_slapse.records import MotionStatus, ScaleStatus, Speed, TrackingStatus
from mv_slapse.scene.filter import SceneFilter
from mv_slapse.scene.scale import speed as scene_speed
import numpy as np
import pytest
from scene_drive import Canyon, DT, METRIC, position_errors, SPEED, stamp

FREE = SceneSettings()
S = 1_000_000_000


def speeds_of(canyon, first, n, factor=1.0):
    """Return speeds at 50 Hz from key frame first - 1 to n."""
    times = np.arange((first - 1) * DT, n * DT + 0.01, 0.02)
    return [Speed(round(t * S), factor * (canyon.way(t + 0.01) - canyon.way(t - 0.01)) / 0.02)
            for t in times]


def driven(canyon, n, speeds, settings=FREE, filter_=None, first=1, extraction=None):
    filter_ = filter_ or SceneFilter(settings)
    found = []
    for k in range(first, n + 1):
        due = [speed for speed in speeds if stamp(k - 1) < speed.stamp <= stamp(k)
               or k == first and speed.stamp <= stamp(k)]
        found.append(filter_.step((extraction or canyon.extraction)(k), (), due)[0])
    return found


def deviation(estimate):
    """Return the standard deviation of a position along the way."""
    ahead = estimate.velocity_world / np.linalg.norm(estimate.velocity_world)
    return float(np.sqrt(ahead @ estimate.pose_covariance[:3, :3] @ ahead))


def test_a_speed_makes_the_scale_metric_from_the_first_pair_on():
    canyon = Canyon()
    estimates = driven(canyon, 30, speeds_of(canyon, 1, 30))
    assert max(position_errors(canyon, estimates)) < 0.03
    assert all(e.scale_status is ScaleStatus.METRIC for e in estimates)
    assert {e.scale_source for e in estimates} == {'speed'}
    assert all(e.status is TrackingStatus.OK for e in estimates)


def test_a_speed_that_begins_later_makes_it_metric_then():
    canyon = Canyon()
    estimates = driven(canyon, 40, speeds_of(canyon, 15, 40))
    assert [e.scale_status for e in estimates[:13]] == [ScaleStatus.UNKNOWN] * 13
    assert estimates[-1].scale_source == 'speed'
    assert_continuous(canyon, estimates, 14)
    units = [e.unit for e in estimates]
    assert units[:13] == [1.0] * 13
    assert units[13:] == pytest.approx([DT * SPEED] * 27, rel=1e-3)
    assert np.linalg.norm(estimates[-1].velocity_world) == pytest.approx(SPEED, rel=0.02)


def assert_continuous(canyon, estimates, k):
    """What was published before metres were known stays; from there on lengths are metres."""
    assert unexplained_step(estimates) == 0
    way = np.array([e.t_world_from_cam for e in estimates[k - 2:]])
    true = np.array([canyon.pose(i + 1)[1] for i in range(k - 2, len(estimates))])
    assert np.linalg.norm(way[-1] - way[0] - true[-1] + true[0]) < 0.03 * np.linalg.norm(
        true[-1] - true[0])
    assert np.linalg.norm(way[0] - true[0]) > 2  # in units of the first way, not metres
    for estimate, position in zip(estimates[k - 1:], true[1:], strict=True):
        error = position - estimate.t_world_from_cam
        assert error @ np.linalg.solve(estimate.pose_covariance[:3, :3], error) < 14.2


def test_wheels_of_another_size_are_an_error_that_lasts():
    canyon, wrong = Canyon(), 1 + FREE.speed_bias
    last = driven(canyon, 60, speeds_of(canyon, 1, 60, wrong))[-1]
    error = np.linalg.norm(last.t_world_from_cam - canyon.pose(60)[1])
    assert error == pytest.approx(FREE.speed_bias * 60 * DT * SPEED, rel=0.1)
    assert error < 1.5 * deviation(last)
    careless = driven(canyon, 60, speeds_of(canyon, 1, 60, wrong),
                      replace(FREE, speed_bias=0.0))[-1]
    assert deviation(careless) < 0.5 * deviation(last)


def test_wheels_that_stand_or_slip_are_not_believed():
    canyon = Canyon()
    right = speeds_of(canyon, 1, 40)
    wrong = [Speed(s.stamp, 0.0 if 1.5 < s.stamp / S < 2 else 2 * s.value
                   if 2.5 < s.stamp / S < 3 else s.value) for s in right]
    estimates = driven(canyon, 40, wrong)
    assert max(position_errors(canyon, estimates)) < 0.05


def test_the_length_of_a_way_nobody_saw_is_that_of_the_wheels():
    def braking(time):
        """Drive with 8 m/s and brake from 2 s on with 3 m/s^2 for 1 s."""
        slow = np.clip(time - 2, 0, 1)
        return SPEED * time - 1.5 * slow**2 - 3 * max(time - 3, 0)

    canyon = Canyon(way=braking, yaw_rate=1e-3)
    errors, sigmas = [], []
    for told in (40, 20):
        speeds = speeds_of(canyon, 1, told)
        filter_ = SceneFilter(METRIC)
        driven(canyon, 20, speeds, filter_=filter_)
        blind = driven(canyon, 30, [s for s in speeds if s.stamp > stamp(20)], filter_=filter_,
                       first=21, extraction=canyon.blank)
        errors.append(position_errors(canyon, blind, 21)[-1])
        sigmas.append(deviation(blind[-1]))
    assert errors[0] < 0.1 < 1.0 < errors[1]
    assert errors[0] < 3 * sigmas[0]
    assert sigmas[0] < 0.6 * sigmas[1]


def test_after_a_rest_the_speed_tells_the_first_way():
    def resting(time):
        """Drive for 1 s, stand for 1 s, start with 4 m/s^2."""
        return 8 * min(time, 1) + 2 * max(time - 2, 0)**2

    canyon = Canyon(way=resting)
    speeds, filter_ = speeds_of(canyon, 1, 40), SceneFilter(FREE)
    driven(canyon, 10, speeds, filter_=filter_)
    driven(canyon, 20, speeds, filter_=filter_, first=11,
           extraction=lambda k: canyon.blank(k, MotionStatus.STANDSTILL, ''))
    estimates = driven(canyon, 40, speeds, filter_=filter_, first=21)
    assert max(position_errors(canyon, estimates, 21)) < 0.05


@pytest.mark.parametrize('moved', [0, 10])
@pytest.mark.parametrize('status', [
    MotionStatus.STANDSTILL, MotionStatus.ROTATION_ONLY, MotionStatus.UNKNOWN])
def test_a_camera_that_goes_nowhere_keeps_no_speeds_but_those_of_its_pair(status, moved):
    canyon, filter_ = Canyon(), SceneFilter(FREE)
    driven(canyon, moved, [], filter_=filter_)
    for k in range(moved + 1, moved + 100):
        told = [Speed(stamp(k - 1) + i * S // 100, 0.0) for i in range(1, 11)]
        filter_.step(canyon.blank(k, status), (), told)
        first = [stamp(k - 1)] if k > moved + 1 else []  # with it the pair's way begins
        assert [speed.stamp for speed in filter_._speeds._speeds] == [
            *first, *(speed.stamp for speed in told)]


@pytest.mark.parametrize(('turn', 'speed', 'sigma'), [
    (0.0, 4.0, 0.02), (0.1, 4.0, np.hypot(0.02, 0.025)), (0.1, -2.0, np.hypot(0.02, 0.05))])
def test_a_turn_widens_what_a_speed_tells(turn, speed, sigma):
    log = scene_speed.SpeedLog()
    log.feed([Speed(0, speed), Speed(S // 2, speed)])
    way = scene_speed.distance(log, 0, S // 2, turn, FREE)
    assert way.length == pytest.approx(abs(speed) / 2)
    assert way.sigma == pytest.approx(sigma, abs=1e-4)


def test_a_speed_that_is_next_to_none_tells_nothing():
    log = scene_speed.SpeedLog()
    log.feed([Speed(0, 0.04), Speed(S // 2, 0.04), Speed(S, 0.04)])
    assert scene_speed.distance(log, 0, S, 0.0, FREE) is None
    log.feed([Speed(3 * S // 2, 0.2), Speed(2 * S, 0.2)])
    assert scene_speed.distance(log, 3 * S // 2, 2 * S, 0.0, FREE) is not None
    # The camera's place on the vehicle decides more than the wheels.
    assert scene_speed.distance(log, 3 * S // 2, 2 * S, 0.3, FREE) is None
