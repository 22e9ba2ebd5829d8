"""Obstacles that the labels call stationary, or do not show, against drawn traffic."""

from dataclasses import replace

from drawn_movers import Drive, DT, Mover, usable
from mv_slapse.config import ObstacleSettings
from mv_slapse.obstacles import track as tracks
from mv_slapse.obstacles import tracker as obstacles_module
from mv_slapse.obstacles.detection import detections
from mv_slapse.obstacles.tracker import ObstacleTracker
from mv_slapse.obstacles.view import view_of
from mv_slapse.records import Label, ObstacleState
import numpy as np
import pytest

SAME_SPEED = Drive((Mover(1, (0, 14), (0, 10)),))
SETTINGS = ObstacleSettings()


def turned_stationary(drive, since, rng, seconds):
    """Yield what a tracker returns where from some time on the labels call all stationary."""
    tracker = ObstacleTracker(SETTINGS)
    for i in range(round(seconds / DT)):
        now = (i + 1) * DT
        extraction = drive.extraction(now - DT, now, rng)
        if now > since:
            planes = tuple(replace(p, label=Label.STATIONARY) for p in extraction.planes)
            extraction = replace(extraction, planes=planes,
                                 label=np.zeros_like(extraction.label))
        yield now, *tracker.step(extraction, drive.scene(now - DT, now))


@pytest.mark.parametrize('depth', [12, 15])
@pytest.mark.parametrize('speed', [0.0, 0.3, 1.0, 2.0])
def test_a_stopped_car_whose_labels_turn_stationary_is_handed_over(rng, speed, depth):
    drive = Drive((Mover(1, (0, depth), lambda t: (0, 2.0 if t < 1.5 else 0.0)),), speed=speed)
    handed = [(now, h) for now, _, handovers in turned_stationary(drive, 1.7, rng, 2.2)
              for h in handovers]
    assert [h.id for _, h in handed] == [1]
    assert 1.7 < handed[0][0] < 2.2


def test_what_stands_nearer_or_farther_than_an_obstacle_is_not_it(rng):
    drive = Drive((Mover(1, (1, 12), (0, 5)),), sigma=0.05, omega=0.2)
    extraction = drive.extraction(0.9, 1.0, rng)
    view = view_of(extraction, drive.scene(0.9, 1.0), None)
    item = detections(extraction, view, SETTINGS)[0]
    track = tracks.start(item, extraction, view, 1)
    still = replace(drive, movers=(Mover(1, (1, 17), (0, 0)),))
    seen = still.extraction(0.9, 1.0, rng)
    seen = replace(seen, label=np.zeros_like(seen.label))
    share = {}
    for factor in (0.3, 0.7, 1.0, 1.4, 3.5):
        track.mu[2] = item.z[2] + np.log(factor)
        track.P[2, 2] = 1e-4
        share[factor] = obstacles_module._still_share(track, seen, view)
    assert min(share[0.7], share[1.0], share[1.4]) > 0.9
    assert max(share[0.3], share[3.5]) < 0.1


def test_an_obstacle_that_only_the_search_sees_keeps_its_size(rng):
    drive = SAME_SPEED
    tracker, widths = ObstacleTracker(SETTINGS), []
    for i in range(30):
        now = (i + 1) * DT
        extraction = drive.extraction(now - DT, now, rng)
        if i > 8:
            extraction = replace(extraction, planes=(),
                                 label=np.full_like(extraction.label, Label.UNKNOWN),
                                 plane_id=np.full_like(extraction.plane_id, -1))
        obstacles, _ = tracker.step(extraction, drive.scene(now - DT, now))
        if i == 8:  # a part of it, and two single blocks that joined from beside it
            track = tracker._tracks[0]
            low, size = track.box(tracker._view)[:2], track.box(tracker._view)[2:]
            beside = low + [(size[0] + 8, 8), (size[0] + 24, 8)]
            left = track.x[:, 0] < low[0] + 0.6 * size[0]
            track.x = np.r_[track.x[left], beside]
            track.block = np.r_[track.block[left], [[16, 16], [16, 16]]]
        if i >= 8:
            widths += [o.box[2] for o in obstacles]
            assert tracker._tracks[0].evidence[-1].overlap > 0.6 or i == 8
    assert len(widths) == 22
    np.testing.assert_allclose(widths, widths[0], atol=12)


def test_a_car_as_fast_as_the_camera_whose_labels_turn_stationary_coasts(rng):
    # So unsure of the scale its speed might be any; but a car that stopped would come near.
    drive = Drive((Mover(1, (0, 14), (0, 10)),), scale_sigma=0.6)
    result = list(turned_stationary(drive, 1.7, rng, 2.1))
    assert not any(handovers for _, _, handovers in result)
    assert [o.id for o in usable(result[-1][1])] == [1]
    assert usable(result[-1][1])[0].state is ObstacleState.COASTING


def test_a_position_is_as_sure_as_the_outline_tells_not_the_newest_blocks(rng):
    extraction = SAME_SPEED.extraction(0.9, 1.0, rng)
    view = view_of(extraction, SAME_SPEED.scene(0.9, 1.0), None)
    track = tracks.start(detections(extraction, view, SETTINGS)[0], extraction, view, 1)
    whole = track.obstacle(extraction.stamp, view).covariance
    track.x, track.block = track.x[:4], track.block[:4]
    np.testing.assert_array_equal(track.obstacle(extraction.stamp, view).covariance, whole)


def unsure(extraction, elsewhere=False):
    """Return an extraction whose movers are only half as sure, or lie 48 px lower then."""
    planes = tuple(replace(plane, id=-1 - plane.id, label=Label.UNKNOWN, score=8.0)
                   for plane in extraction.planes)
    own = np.where(extraction.plane_id > 0, -1 - extraction.plane_id, -1).astype(np.int32)
    x = extraction.x_cur + np.float32([0, 48 if elsewhere else 0])
    return replace(extraction, planes=planes, plane_id=own, x_cur=x,
                   label=np.zeros_like(extraction.label))


def tracked(drive, rng, n_unsure, n_pairs, elsewhere=False):
    """Return the obstacles of each pair, the first ones of regions that are only half as sure."""
    tracker, found = ObstacleTracker(SETTINGS), []
    for i in range(n_pairs):
        extraction = drive.extraction(i * DT, (i + 1) * DT, rng)
        if i < n_unsure:
            extraction = unsure(extraction, elsewhere)
        found.append(tracker.step(extraction, drive.scene(i * DT, (i + 1) * DT))[0])
    return found


def test_what_is_half_as_sure_is_followed_but_not_confirmed(rng):
    drive = Drive((Mover(1, (0, 14), (0, 5)),))
    found = tracked(drive, rng, 8, 8)
    assert [o.state for obstacles in found for o in obstacles] == [ObstacleState.TENTATIVE] * 8
    assert len({o.id for obstacles in found for o in obstacles}) == 1


def test_what_was_followed_before_is_confirmed_as_soon_as_it_is_called_moving(rng):
    drive = Drive((Mover(1, (0, 14), (0, 5)),))
    followed, new = tracked(drive, rng, 2, 3), tracked(drive, rng, 0, 1)
    assert [o.state for o in followed[2]] == [ObstacleState.CONFIRMED]
    assert followed[2][0].id == followed[0][0].id
    assert [o.state for o in new[0]] == [ObstacleState.TENTATIVE]


def test_a_wrong_beginning_does_not_delay_what_is_called_moving(rng):
    drive = Drive((Mover(1, (0, 14), (0, 5)),))
    late = tracked(drive, rng, 2, 4, elsewhere=True)
    assert not usable(late[2])
    assert len(usable(late[3])) == 1, 'as where nothing was followed before'


def test_what_is_no_body_begins_again_until_it_is_called_moving(rng):
    drive = Drive((Mover(1, (0, 14), (0, 5)),))
    tracker, alone = ObstacleTracker(SETTINGS), ObstacleTracker(SETTINGS)
    for i in range(3):
        extraction, scene = drive.extraction(i * DT, (i + 1) * DT, rng), drive.scene(
            i * DT, (i + 1) * DT)
        if i == 0:  # its left half, which moves otherwise
            first = unsure(extraction)
            first = replace(first, plane_id=np.where(
                first.x_cur[:, 0] < 316, first.plane_id, -1).astype(np.int32), planes=tuple(
                    replace(plane, t_d=plane.t_d + [0.1, 0, 0]) for plane in first.planes))
            tracker.step(first, scene)
            continue
        (one,), _ = tracker.step(extraction, scene)
        (other,), _ = alone.step(extraction, scene)
        assert one.state is other.state
        np.testing.assert_allclose(one.velocity, other.velocity)
        assert one.age == pytest.approx(other.age + DT)
    assert one.state is ObstacleState.CONFIRMED


def test_what_is_half_as_sure_beside_an_obstacle_is_none(rng):
    drive = Drive((Mover(1, (0, 14), (0, 5)),))
    tracker = ObstacleTracker(SETTINGS)
    for i in range(5):
        extraction = drive.extraction(i * DT, (i + 1) * DT, rng)
        if i == 4:
            part = unsure(extraction)
            own = np.flatnonzero(extraction.plane_id > 0)[::2]
            plane_id = extraction.plane_id.copy()
            plane_id[own] = part.plane_id[own]
            extraction = replace(extraction, planes=extraction.planes + part.planes,
                                 plane_id=plane_id)
        found, _ = tracker.step(extraction, drive.scene(i * DT, (i + 1) * DT))
    assert [o.state for o in found] == [ObstacleState.CONFIRMED]
