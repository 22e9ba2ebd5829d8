"""Metres that a given camera height tells: not before successive grounds agree."""

from dataclasses import replace

from mv_slapse.config import SceneSettings
from mv_slapse.records import Label, PlaneObservation, ScaleStatus, TrackingStatus
from mv_slapse.scene import state as scene_state
from mv_slapse.scene.filter import SceneFilter
from mv_slapse.scene.progress import PATIENCE
from mv_slapse.scene.scale.height import ENOUGH, GROSS, Grounds
import numpy as np
import pytest
from scene_drive import Canyon, driven, GROUND, HEIGHT, METRIC, position_errors, SPEED


def ground(depth, sigma=0.01):
    """Return a level ground at a depth [baseline], sure to a share of it."""
    plane = np.array([0, -1.0, 0]) / depth
    return PlaneObservation(GROUND, Label.STATIONARY, plane, np.eye(3) * (sigma / depth)**2,
                            is_ground=True)


def told(depths, lengths, sigma=0.01):
    grounds = Grounds()
    for depth, length in zip(depths, lengths, strict=True):
        grounds = grounds.seen(ground(depth, sigma), length, METRIC)
    return grounds.metres()


def test_grounds_that_agree_tell_how_many_metres_make_a_unit():
    lengths = np.array([0.5, 1.0, 2.0])  # of the ways [map unit]; the ground is 0.4 units below
    assert told((0.4 / lengths)[:2], lengths[:2]) is None
    assert told(0.4 / lengths, lengths) == pytest.approx(HEIGHT / 0.4)
    off = np.array([1.02, 0.98, 1.0])
    assert told(off * 0.4 / lengths, lengths) == pytest.approx(HEIGHT / 0.4, rel=0.01)


@pytest.mark.parametrize('wrong', range(ENOUGH))
def test_grounds_that_contradict_each_other_tell_nothing(wrong):
    depths = np.full(ENOUGH, 2.0)
    depths[wrong] = 1.6
    assert told(depths, np.ones(ENOUGH)) is None
    assert told(depths, np.ones(ENOUGH), sigma=0.1) is not None  # so unsure, they do not


def test_only_the_last_grounds_count():
    assert told([0.9, 0.9, 2.0, 2.0, 2.0], np.ones(5)) == pytest.approx(HEIGHT / 2)


def with_ground(extraction, share):
    """Return an extraction whose ground seems nearer by a share, in all that it shows."""
    floor, *others = extraction.planes
    on_it = extraction.plane_id == GROUND
    return replace(extraction, planes=(replace(floor, plane=floor.plane / share), *others),
                   plane_id=np.where(on_it, -1, extraction.plane_id),
                   label=np.where(on_it, Label.UNKNOWN, extraction.label).astype(np.int8))


def test_a_first_ground_that_is_wrong_by_half_leaves_no_trace_in_the_poses():
    canyon, filter_ = Canyon(), SceneFilter(METRIC)
    first = [filter_.step(with_ground(canyon.extraction(k), 0.5))[0] for k in (1, 2)]
    later = driven(canyon, 30, filter_=filter_, first=3)
    waiting = [*first, *later[:ENOUGH - 1]]
    assert {(e.status, e.scale_status) for e in waiting} == {
        (TrackingStatus.INITIALISING, ScaleStatus.UNKNOWN)}
    assert all('has not been seen alike in 3 successive pairs' in e.reason for e in waiting)
    posed = later[ENOUGH - 1:]
    assert {(e.status, e.scale_status) for e in posed} == {(TrackingStatus.OK, ScaleStatus.METRIC)}
    assert max(position_errors(canyon, posed, 2 + ENOUGH)) < 0.1


def test_grounds_that_never_agree_are_waited_for_no_longer_than_a_prediction_lasts():
    canyon, filter_ = Canyon(), SceneFilter(METRIC)
    statuses = []
    for k in range(1, 70):
        estimate, _ = filter_.step(with_ground(canyon.extraction(k), 1.5 if k % 2 else 1.0))
        statuses.append(estimate.status)
    waited = statuses.index(TrackingStatus.OK)
    assert waited * 0.1 == pytest.approx(5 * METRIC.lost_after, abs=0.2)
    assert TrackingStatus.INITIALISING not in statuses[waited:]
    assert estimate.scale_status is ScaleStatus.UNKNOWN


def test_a_free_scale_waits_for_no_ground():
    canyon = Canyon()
    first, *_ = driven(canyon, 3, SceneSettings())
    assert first.status is TrackingStatus.OK
    assert np.linalg.norm(first.t_world_from_cam) * 0.1 * SPEED == pytest.approx(
        np.linalg.norm(canyon.pose(1)[1]), rel=1e-3)


def test_of_metric_lengths_grounds_tell_only_what_is_wrong_in_bulk():
    grounds = Grounds()
    for _ in range(ENOUGH):
        grounds = grounds.seen(ground(0.8 * HEIGHT), 1.0, METRIC)
    assert grounds.metres() == pytest.approx(1 / 0.8)
    assert grounds.metres(GROSS) is None
    for _ in range(ENOUGH):
        grounds = grounds.seen(ground(0.6 * HEIGHT), 1.0, METRIC)
    assert grounds.metres(GROSS) == pytest.approx(1 / 0.6)


@pytest.mark.parametrize('wrong', [0.5, 2.0])
def test_lengths_that_are_wrong_and_sure_are_put_right_once_the_ground_contradicts_for_long(wrong):
    canyon, filter_ = Canyon(), SceneFilter(METRIC)
    driven(canyon, 20, filter_=filter_)
    place = filter_._progress.place.copy()
    scene_state.rescale_about(filter_._state, place, wrong, 1e-3)
    filter_._map.scale(wrong, place)
    estimates = driven(canyon, 32, filter_=filter_, first=21)
    speeds = np.array([e.baseline / (0.1 * SPEED) for e in estimates])
    np.testing.assert_allclose(speeds[:PATIENCE], wrong, rtol=0.2)
    np.testing.assert_allclose(speeds[PATIENCE + 2:], 1, atol=0.15)
    assert speeds[-1] == pytest.approx(1, abs=0.06)  # 0.56 and 1.66 without
    steps = np.linalg.norm(np.diff([e.t_world_from_cam for e in estimates], axis=0), axis=1)
    grown = np.diff(np.log([e.unit for e in estimates]))
    assert np.count_nonzero(grown) == 1
    at = np.argmax(np.abs(grown))
    assert grown[at] == pytest.approx(np.log(speeds[at + 1] / speeds[at]), abs=0.1)
    assert steps.max() < 2.1 * 0.1 * SPEED  # what was published stays where it is
