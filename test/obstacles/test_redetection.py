"""Obstacles that the labels miss, by their vectors in drawn traffic."""

from dataclasses import replace

from drawn_movers import Drive, DT, Mover
from mv_slapse.config import ObstacleSettings
from mv_slapse.obstacles import motion_model as om
from mv_slapse.obstacles import redetection
from mv_slapse.obstacles.association import observed
from mv_slapse.obstacles.detection import detections
from mv_slapse.obstacles.tracker import ObstacleTracker
from mv_slapse.obstacles.view import view_of
from mv_slapse.records import Label, ObstacleState
import numpy as np
import pytest

SETTINGS = ObstacleSettings()
CASES = {'slower': Drive((Mover(1, (0, 18), (0, 5)),)),
         'same_speed': Drive((Mover(1, (0, 12), (0, 10)),)),
         'crossing': Drive((Mover(1, (-7, 18), (5, 0), size=(4.2, 1.5)),), speed=3.0)}


def unlabelled(extraction):
    """Return an extraction whose labels miss every mover."""
    return replace(extraction, planes=(), label=np.full(len(extraction.x_cur), Label.UNKNOWN),
                   plane_id=np.full(len(extraction.x_cur), -1))


def moment(drive, now, rng):
    """Return extraction, view and the state of the one mover, known by its own detection."""
    extraction = drive.extraction(now - DT, now, rng)
    view = view_of(extraction, drive.scene(now - DT, now), None)
    return extraction, view, detections(extraction, view, SETTINGS)[0]


def found(item, extraction, view):
    return redetection.found(item.z, item.R, item.box, extraction, view, SETTINGS)


def track(drive, rng, labelled, seconds=3.0):
    """Return (time, obstacles); the labels show movers for as long as ``labelled`` says."""
    tracker, result = ObstacleTracker(SETTINGS), []
    for i in range(int(round(seconds / DT))):
        now = (i + 1) * DT
        extraction = drive.extraction(now - DT, now, rng)
        if not labelled(now):
            extraction = unlabelled(extraction)
        result.append((now, tracker.step(extraction, drive.scene(now - DT, now))[0]))
    return result


@pytest.fixture(params=CASES, ids=str)
def drive(request):
    return CASES[request.param]


def test_vectors_alone_give_the_rate(drive, rng):
    exact = replace(drive, sigma=0.0)
    extraction, view, item = moment(exact, 0.5, rng)
    wrong = item.z + np.r_[0, 0, 0, 0.02, -0.02, 0.03, 0, 0]
    unsure = replace(item, z=wrong, R=item.R + 0.05**2 * np.eye(8))
    again = found(unsure, unlabelled(extraction), view)
    np.testing.assert_allclose(again.z[om.RATE], item.z[om.RATE], atol=0.02)
    assert not again.has_depth
    assert np.all(np.linalg.eigvalsh(again.R[om.RATE, om.RATE]) > 0)


def test_what_lies_behind_does_not_tell_the_rate(drive, rng):
    extraction, view, item = moment(replace(drive, sigma=0.0), 0.5, rng)
    unsure = replace(item, R=item.R + 0.3**2 * np.eye(8))
    behind = extraction.x_cur[:, 1] < item.box[1] + item.box[3] / 3
    assert np.any(behind & (extraction.plane_id == item.id))
    moved = np.where(behind[:, None], extraction.x_prev + np.float32([1.5, -1.5]),
                     extraction.x_prev)
    again = found(unsure, replace(unlabelled(extraction), x_prev=moved), view)
    np.testing.assert_allclose(again.z[om.RATE], item.z[om.RATE], atol=0.02)


@pytest.mark.parametrize('lag', [0.02, 0.04, 0.08])
def test_most_blocks_tell_the_rate_where_the_rest_moves_as_predicted(drive, rng, lag):
    # As of a car that brakes before a facade which drives by as the car did.
    extraction, view, item = moment(replace(drive, sigma=0.1), 0.5, rng)
    off = lag * rng.choice([-1, 1], 2)
    lagging = replace(item, z=item.z + np.r_[0, 0, 0, off, 0, 0, 0],
                      R=item.R + 0.3**2 * np.eye(8))
    behind = extraction.x_cur[:, 1] < item.box[1] + item.box[3] / 3
    shift = -np.float32(DT * 600 * off)
    moved = np.where(behind[:, None], extraction.x_prev + shift, extraction.x_prev)
    again = found(lagging, replace(unlabelled(extraction), x_prev=moved), view)
    np.testing.assert_allclose(again.z[om.RATE][:2], item.z[om.RATE][:2], atol=0.01)


def test_blocks_that_disagree_show_the_place_but_no_motion(drive, rng):
    extraction, view, item = moment(drive, 0.5, rng)
    unsure = replace(item, R=item.R + 0.3**2 * np.eye(8))
    apart = rng.choice([-4, 4], extraction.x_prev.shape).astype(np.float32)
    again = found(unsure, replace(unlabelled(extraction), x_prev=extraction.x_prev + apart), view)
    assert not again.has_rate
    np.testing.assert_array_equal(observed(again.has_depth, again.has_rate), [0, 1, 6, 7])
    np.testing.assert_allclose(again.z[om.BEARING], item.z[om.BEARING], atol=0.02)


def test_a_confirmed_obstacle_is_followed_without_labels(drive, rng):
    mover = drive.movers[0]
    result = track(drive, rng, lambda now: now < 0.85)
    for now, obstacles in result[6:24]:
        assert [o.state for o in obstacles] == [ObstacleState.CONFIRMED]
        R, t = drive.pose(now)
        range_ = np.linalg.norm(mover.centre(now) - t)
        assert np.linalg.norm(obstacles[0].position - mover.centre(now)) < 0.2 * range_
        assert np.linalg.norm(obstacles[0].velocity - mover.speed(now)) < 2


def test_a_tentative_obstacle_is_not_looked_for(drive, rng):
    result = track(drive, rng, lambda now: now < 0.15, 1.0)
    assert all(o.state is ObstacleState.TENTATIVE for _, obstacles in result for o in obstacles)
    assert not result[-1][1]


def test_what_moves_otherwise_is_not_the_obstacle(drive, rng):
    extraction, view, item = moment(drive, 0.5, rng)
    shifted = replace(unlabelled(extraction), x_prev=extraction.x_prev + np.float32([9, -9]))
    assert found(item, shifted, view) is None


def test_blocks_on_any_plane_stay_its_own(drive, rng):
    extraction, view, item = moment(drive, 0.5, rng)
    assert np.all(extraction.plane_id >= 0)
    assert found(item, extraction, view) is None
    assert found(item, unlabelled(extraction), view) is not None


def test_what_is_seen_only_above_the_road_is_what_lies_behind(drive, rng):
    extraction, view, item = moment(drive, 0.5, rng)
    top, height = item.box[1], item.box[3]
    high = extraction.x_cur[:, 1] < top + height / 2
    moved = np.where(high[:, None], extraction.x_prev, extraction.x_prev + np.float32([9, -9]))
    assert found(item, replace(unlabelled(extraction), x_prev=moved), view) is None


def test_a_few_blocks_are_not_enough(drive, rng):
    extraction, view, item = moment(drive, 0.5, rng)
    few = unlabelled(extraction)
    few = replace(few, **{name: getattr(few, name)[:3] for name in (
        'x_cur', 'x_prev', 'sigma', 'block', 'label', 'plane_id')})
    assert found(item, few, view) is None
