"""Lengths that the depths of pairs tell the scene filter, right ones and wrong ones."""

from dataclasses import replace

from mv_slapse.config import SceneSettings
from mv_slapse.records import MotionStatus, TrackingStatus
from mv_slapse.scene.filter import SceneFilter
from mv_slapse.scene.progress import PATIENCE
from mv_slapse.scene.state import LENGTH
import numpy as np
import pytest
from scene_drive import Canyon, driven, METRIC, SPEED


def bare(canyon, k, ratio=0.0):
    """What pair k shows without planes; its ratio to the baseline before is off by a logarithm."""
    shown = canyon.extraction(k)
    return replace(shown, planes=(), plane_id=np.full_like(shown.plane_id, -1),
                   baseline_ratio=shown.baseline_ratio + ratio)


def test_a_ratio_that_the_speed_cannot_have_made_is_not_believed():
    canyon, filter_ = Canyon(), SceneFilter(SceneSettings())
    driven(canyon, 10, filter_=filter_)
    estimate, _ = filter_.step(bare(canyon, 11, 2.5))
    assert estimate.baseline == pytest.approx(1, rel=0.1)


def test_the_map_of_blocks_outlasts_a_pair_whose_ratio_is_wrong():
    canyon = Canyon(way=lambda time: SPEED * time * (1 if time < 1 else 1 - 0.2 * (time - 1)))
    filter_, unit = SceneFilter(SceneSettings()), np.linalg.norm(canyon.pose(1)[1])
    for k in range(1, 11):
        filter_.step(bare(canyon, k))
    filter_.step(bare(canyon, 11, -1.5))
    # Against the map the next pair's length is right, so that its ratio errs the other way.
    for k, off in ((12, 1.5), (13, 0.0), (14, 0.0)):
        estimate, _ = filter_.step(bare(canyon, k, off))
    assert estimate.status is TrackingStatus.OK
    way = np.linalg.norm(canyon.motion(14)[1])
    assert unit * estimate.baseline == pytest.approx(way, rel=0.01)


def test_depths_that_contradict_for_long_are_compared_with_the_map_no_more():
    canyon, filter_ = Canyon(), SceneFilter(SceneSettings())
    for k in range(1, 11):
        filter_.step(bare(canyon, k))
    statuses = [filter_.step(bare(canyon, 11 + k, 2.5 * (k == 0)))[0] for k in range(PATIENCE + 2)]
    assert all(one.status is TrackingStatus.PREDICTED for one in statuses[:PATIENCE + 1])
    assert statuses[-1].status is TrackingStatus.OK
    assert statuses[-1].baseline == pytest.approx(1, rel=0.05)


@pytest.mark.parametrize('wrong', [2.5, 0.0])
def test_depths_that_contradicted_until_a_rest_have_no_scale_after_it(wrong):
    def way(time):
        return SPEED * (min(time, 1.2) + max(time - 1.5, 0.0))  # stands for pairs 13 to 15

    canyon, filter_ = Canyon(way=way), SceneFilter(SceneSettings())
    for k in range(1, 13):
        filter_.step(bare(canyon, k, wrong * (k == 12)))
    for k in range(13, 16):
        filter_.step(canyon.blank(k, MotionStatus.STANDSTILL, ''))
    # As long as the last way before the rest.
    shown = replace(bare(canyon, 16), baseline_ratio=0.0, baseline_ratio_sigma=0.002)
    estimate, P = filter_.step(shown)[0], filter_._state.P
    at = filter_._state.at('depth_scale')
    if wrong:
        assert estimate.baseline < 1.5  # by the depths it would be 12 times the others
        assert np.sqrt(P[at, at].item()) > 0.5
    else:
        assert estimate.baseline == pytest.approx(1, rel=0.02)
        assert np.sqrt(P[at, at].item()) < 0.05


@pytest.mark.parametrize('sigma', [1e-4, 0.01])
def test_a_free_scale_is_less_sure_with_each_ratio_by_what_that_errs_by(sigma):
    canyon, settings = Canyon(), SceneSettings()
    filter_ = SceneFilter(settings)
    for k in range(1, 21):
        filter_.step(replace(bare(canyon, k), baseline_ratio_sigma=sigma))
    at = filter_._state.at('depth_scale')
    expected = sigma * np.sqrt(19 * settings.depth_dependence)
    assert filter_._state.error.lasting[at, LENGTH].item() == pytest.approx(expected, rel=0.1)


def test_a_metric_scale_is_put_right_by_the_ground_and_errs_by_nothing_for_good():
    canyon, filter_ = Canyon(), SceneFilter(METRIC)
    for k in range(1, 21):
        filter_.step(replace(canyon.extraction(k), baseline_ratio_sigma=0.01))
    lasting = filter_._state.error.lasting[filter_._state.at('depth_scale'), LENGTH]
    assert abs(lasting.item()) < 0.001


def test_a_flight_that_takes_off_may_soon_be_many_times_as_fast():
    canyon = Canyon(way=lambda time: 20 * max(time - 0.03, 0.0)**2)
    filter_, unit = SceneFilter(SceneSettings()), np.linalg.norm(canyon.pose(1)[1])
    for k in range(1, 9):
        estimate, _ = filter_.step(bare(canyon, k))
        assert estimate.status is TrackingStatus.OK
    assert unit * estimate.baseline == pytest.approx(np.linalg.norm(canyon.motion(8)[1]), rel=0.05)


def test_a_camera_that_brakes_hard_does_not_go_backwards():
    canyon = Canyon(way=lambda time: 0.5 * min(time, 1.0) + 0.15 * max(time - 1.0, 0.0))
    filter_ = SceneFilter(METRIC)
    driven(canyon, 10, filter_=filter_)
    # Nothing but the ratio to the baseline before tells the length, and no sign.
    estimate = filter_.step(bare(canyon, 11))[0]
    np.testing.assert_allclose(estimate.t_world_from_cam, canyon.pose(11)[1], atol=0.002)


def test_a_camera_that_starts_within_its_first_pair_keeps_its_unit():
    canyon = Canyon(way=lambda time: SPEED * max(time - 0.08, 0.0))
    unit = np.linalg.norm(canyon.pose(1)[1])
    filter_ = SceneFilter(SceneSettings())
    for k in range(1, 11):
        estimate = filter_.step(bare(canyon, k))[0]
    np.testing.assert_allclose(unit * estimate.t_world_from_cam, canyon.pose(10)[1], rtol=0.02,
                               atol=0.05)


def test_a_chain_of_lengths_that_grows_is_held_by_the_ground():
    """Behind buses the map's unit drifts by .5 % in each pair, always one way."""
    canyon, filter_ = Canyon(), SceneFilter(METRIC)
    for k in range(1, 41):
        shown = canyon.extraction(k)
        estimate, _ = filter_.step(replace(shown, baseline_ratio=shown.baseline_ratio + 0.005))
    assert estimate.baseline == pytest.approx(np.linalg.norm(canyon.motion(40)[1]), rel=0.02)
