"""A height that nobody gave, but that stays: taken where the camera keeps to the ground only."""

from copy import deepcopy
from dataclasses import replace

from mv_slapse.config import SceneSettings
from mv_slapse.filters import ekf
from mv_slapse.records import ScaleStatus, Speed
from mv_slapse.scene import observations as scene_observations
from mv_slapse.scene import state as scene_state
from mv_slapse.scene import update as scene_update
from mv_slapse.scene.filter import SceneFilter
from mv_slapse.scene.scale.ride import Ride
from numeric import jacobian
import numpy as np
import pytest
from scene_drive import Canyon, driven, DT, GROUND, HEIGHT, METRIC, position_errors, SPEED
from scipy.spatial.transform import Rotation

FREE = SceneSettings()
UNIT = DT * SPEED  # m, the first translation


class Lifted(Canyon):
    """A camera that swings and rises over the road: by rise(k) [m] and roll(k) [rad]."""

    def __init__(self, rise=lambda k: 0.0, roll=lambda k: 0.0, **how):
        super().__init__(**how)
        self.rise, self.roll = rise, roll

    def pose(self, k):
        R, t = super().pose(k)
        turn = Rotation.from_euler('z', self.roll(k)).as_matrix()
        return R @ turn, t - (0, self.rise(k) - self.rise(0), 0)


def taken(canyon, n, settings=FREE):
    """Return the ride after n key frames, the estimates, and from which on it was taken."""
    filter_, estimates, rides = SceneFilter(settings), [], []
    for k in range(1, n + 1):
        estimates.append(filter_.step(canyon.extraction(k))[0])
        rides.append(filter_._ride.height > 0)
    return filter_, estimates, rides


def test_the_height_of_a_vehicle_is_taken_after_ten_of_them(rng):
    canyon = Canyon(rng, sigma=0.2)
    filter_, estimates, rides = taken(canyon, 40)
    first = rides.index(True)
    assert all(rides[first:])
    assert 10 * HEIGHT <= (first + 1) * UNIT < 13 * HEIGHT
    assert filter_._ride.height == pytest.approx(HEIGHT / UNIT, rel=0.03)
    assert 0.003 < filter_._ride.error[scene_state.HEIGHT] < 0.2
    assert max(position_errors(canyon, estimates, scale=UNIT)) < 0.02 * 40 * UNIT
    assert estimates[-1].scale_status is ScaleStatus.UNKNOWN


def test_a_height_that_is_given_is_the_only_one():
    filter_, _, rides = taken(Canyon(), 40, METRIC)
    assert not any(rides)
    assert not filter_._ride.sights


def test_the_height_carries_the_scale_where_all_planes_are_lost():
    """Blind for 1 s the car brakes to half its speed, and no plane is known again."""
    def braking(time):
        slow = np.clip(time - 3, 0, 1)
        return SPEED * time - 2 * slow**2 - 4 * max(time - 4, 0)

    def speed(never):
        canyon, filter_ = Canyon(way=braking, yaw_rate=1e-3), SceneFilter(FREE)
        driven(canyon, 30, filter_=filter_)
        if never:
            filter_._ride = Ride()
        for k in range(31, 41):
            filter_.step(canyon.blank(k))
        for k in range(41, 56):
            seen = canyon.extraction(k)
            planes = tuple(replace(plane, id=plane.id + 100) for plane in seen.planes)
            ids = np.where(seen.plane_id < 0, -1, seen.plane_id + 100).astype(np.int32)
            last = filter_.step(replace(seen, planes=planes, plane_id=ids))[0]
        return UNIT * np.linalg.norm(last.velocity_world)

    assert speed(never=False) == pytest.approx(SPEED / 2, rel=0.03)
    assert speed(never=True) > 0.6 * SPEED


@pytest.mark.parametrize('canyon', [
    Lifted(rise=lambda k: 0.05 * np.sin(2 * k), roll=lambda k: 0.05 * np.sin(1.3 * k)),
    Lifted(rise=lambda k: 0.5 * np.sin(0.3 * k)), Lifted(rise=lambda k: 0.04 * k)],
    ids=['walk', 'waves', 'climb'])
def test_of_a_camera_that_does_not_ride_no_height_is_taken(canyon):
    assert not any(taken(canyon, 60)[2])


def test_a_flight_that_was_level_and_climbs_is_let_go():
    """Level for 3 s, then 1.5 m up in 1.5 s: as long as it takes to see that, little is lost."""
    canyon = Lifted(rise=lambda k: np.clip(0.1 * (k - 30), 0, 1.5))
    _, estimates, rides = taken(canyon, 60)
    assert any(rides[:30])
    assert not any(rides[35:45])
    errors = position_errors(canyon, estimates, scale=UNIT)
    assert max(errors) < 0.02 * 60 * UNIT
    assert errors[-1] < 3 * UNIT * np.sqrt(np.trace(estimates[-1].pose_covariance[:3, :3]))


def test_what_is_not_known_of_the_height_is_an_error_that_lasts(rng):
    filter_ = SceneFilter(FREE)
    driven(Canyon(rng, sigma=0.3), 8, filter_=filter_)
    state = filter_._state

    def log_height(e):
        plane = scene_state.plane_in_camera(state.moved(e), GROUND)
        return np.array([-np.log(np.linalg.norm(plane))])

    height, H = scene_observations.height_above(state, GROUND)
    assert np.log(height) == pytest.approx(log_height(np.zeros(state.size))[0])
    np.testing.assert_allclose(H[None], jacobian(log_height, np.zeros(state.size)), atol=1e-6)
    before, sigma = state.error.total.copy(), np.sqrt(H @ state.P @ H)
    error = ekf.consider(state.error, H, scene_state.HEIGHT.start)
    np.testing.assert_allclose(state.error.total, before, atol=1e-12)
    np.testing.assert_allclose(H @ state.P @ H, 0, atol=1e-12)
    assert error[scene_state.HEIGHT] == pytest.approx(sigma)
    # The height that is observed errs as the state does: nothing is learned, nothing moves.
    ride = Ride(height, error)
    after = scene_update.observe(deepcopy(state), ride.observations(GROUND, FREE)[:1],
                                 replace(FREE, iterations=3))
    np.testing.assert_allclose(after.error.lasting @ after.error.lasting.T,
                               state.error.lasting @ state.error.lasting.T, rtol=0.1, atol=1e-6)
    ekf.estimate_again(state.error, scene_state.HEIGHT.start)
    np.testing.assert_allclose(state.error.total, before, atol=1e-12)
    assert not state.error.lasting[:, scene_state.HEIGHT].any()


@pytest.mark.parametrize('wrong', [0.9, 1.1])
def test_a_first_speed_that_is_wrong_leaves_no_trace_in_the_height(rng, wrong):
    canyon, filter_, found, n = Canyon(rng, sigma=0.3), SceneFilter(FREE), [], 100
    for k in range(1, n + 1):
        extraction = canyon.extraction(k)
        told = [Speed(at, SPEED * (wrong if k == 40 else 1))
                for at in (extraction.previous_stamp, extraction.stamp - 1)]
        found.append(filter_.step(extraction, (), told if k >= 40 else ())[0])
        if k == 39:
            assert filter_._ride.height == pytest.approx(HEIGHT / UNIT, rel=0.02)
    scale = np.array([e.baseline / UNIT for e in found])
    assert scale[39] == pytest.approx(wrong, rel=0.01)
    assert scale[59:].mean() == pytest.approx(1, abs=2e-3)  # 0.978 and 1.018 with it
    ride = filter_._ride
    assert ride.height == pytest.approx(HEIGHT, rel=0.01)  # off by 10 % with it, and sure to 0.9
    assert abs(np.log(ride.height / HEIGHT)) < 3 * ride.error[scene_state.HEIGHT]


def test_to_let_a_height_go_changes_no_height_that_is_given(rng):
    filter_ = SceneFilter(METRIC)
    driven(Canyon(rng, sigma=0.3), 20, filter_=filter_)
    state = deepcopy(filter_._state)
    assert state.error.lasting[:, scene_state.HEIGHT].any()
    Ride().released(state)
    np.testing.assert_array_equal(state.error.lasting, filter_._state.error.lasting)


def test_only_a_camera_that_rides_is_observed_to():
    assert len(Ride(2.0).observations(1, FREE)) == len(Ride().observations(1, METRIC)) == 3
    assert Ride().observations(1, FREE) == []
