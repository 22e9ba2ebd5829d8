"""Gaps, clocks that are set back, other units and plane ids that wander, against drawn traffic."""

from dataclasses import replace

from drawn_movers import Drive, DT, Groundless, Mover, usable
from mv_slapse.config import ObstacleSettings
from mv_slapse.obstacles import redetection, units
from mv_slapse.obstacles import tracker as tracker_module
from mv_slapse.obstacles.detection import detections
from mv_slapse.obstacles.track import NO_PLANE
from mv_slapse.obstacles.tracker import ObstacleTracker, OWN_IDS
from mv_slapse.obstacles.view import view_of
from mv_slapse.records import Label, MotionStatus, PlaneHandover, ScaleStatus
from numeric import jacobian
import numpy as np
import pytest

SETTINGS = ObstacleSettings()
AHEAD = Drive((Mover(1, (0.3, 20), (0, 12)),))


def follow(tracker, drive, rng, seconds, start=0.0, metres=1.0):
    """Return the usable obstacles of each key frame, in a unit of some ``metres`` if not 1.

    Then the last position is where it is in metres, as the scene filter has it.
    """
    result, place = [], drive.pose(start + seconds)[1]
    for i in range(round(seconds / DT)):
        before, now = start + i * DT, start + (i + 1) * DT
        scene = drive.scene(before, now)
        if metres != 1:
            scene = replace(
                scene, scale_status=ScaleStatus.UNKNOWN, baseline=scene.baseline / metres,
                t_world_from_cam=place + (scene.t_world_from_cam - place) / metres,
                unit=scene.unit / metres,
                velocity_world=scene.velocity_world / metres,
                twist_covariance=scene.twist_covariance / metres**2,
                planes=tuple(replace(p, depth=p.depth / metres) for p in scene.planes))
        result.append(usable(tracker.step(drive.extraction(before, now, rng), scene)[0]))
    return result


@pytest.mark.parametrize('gap', [0.6, 3.0, 30.0])
def test_what_is_seen_after_a_gap_is_another_obstacle(rng, gap):
    tracker = ObstacleTracker(SETTINGS)
    assert [o.id for o in follow(tracker, AHEAD, rng, 1.0)[-1]] == [1]
    other = Drive((Mover(1, (0.3, 20 - 2 * gap), (0, 12)),))
    later = follow(tracker, other, rng, 1.0, start=1.0 + gap)
    assert not later[0]
    assert [o.id for o in later[-1]] == [OWN_IDS + 1]


def test_where_the_clock_is_set_back_the_tracker_begins_anew(rng):
    tracker = ObstacleTracker(SETTINGS)
    follow(tracker, AHEAD, rng, 1.0, start=10.0)
    again = follow(tracker, AHEAD, rng, 1.0)
    assert not again[0]
    assert [o.id for o in again[-1]] == [OWN_IDS + 1]


def test_of_the_ids_that_were_given_the_newest_are_remembered(rng, monkeypatch):
    monkeypatch.setattr(tracker_module, 'USED_IDS', 3)
    tracker = ObstacleTracker(SETTINGS)
    for lane in range(6):  # each seen in turn, and gone for long
        mover = Mover(lane + 1, (0.3, 20 - 60 * lane), (0, 12))
        seen = follow(tracker, Drive((mover,)), rng, 1.0, start=30.0 * lane)
        assert seen[-1][0].id == lane + 1
    assert list(tracker._used) == [4, 5, 6]
    again = follow(tracker, Drive((Mover(6, (0.3, 20 - 360), (0, 12)),)), rng, 1.0, start=180.0)
    assert again[-1][0].id == OWN_IDS + 1


def test_a_pair_that_comes_late_changes_nothing(rng):
    tracker = ObstacleTracker(SETTINGS)
    last = follow(tracker, AHEAD, rng, 1.0)[-1]
    late = follow(tracker, AHEAD, rng, DT, start=0.7)[-1]
    assert [(o.id, o.stamp) for o in late] == [(o.id, o.stamp) for o in last]


@pytest.mark.parametrize('kind', [Drive, Groundless])
@pytest.mark.parametrize('lost', [0.0, 0.2])
@pytest.mark.parametrize('metres', [20.0, 2.0, 0.77])
def test_obstacles_keep_their_place_when_the_unit_becomes_the_metre(rng, metres, lost, kind):
    drive, tracker = kind(AHEAD.movers), ObstacleTracker(SETTINGS)
    before = follow(tracker, drive, rng, 0.8, metres=metres)[-1]
    speeds = [e.speed for e in tracker._tracks[0].evidence]
    after = follow(tracker, drive, rng, 0.3, start=0.8 + lost)[0]
    assert [o.id for o in before] == [o.id for o in after] == [1]
    ahead = [o.position[2] - 10 * time for (o,), time in ((before, 0.8), (after, 0.9 + lost))]
    assert ahead[1] == pytest.approx(metres * ahead[0], rel=0.1)
    assert after[0].velocity[2] == pytest.approx(metres * before[0].velocity[2], rel=0.15)
    np.testing.assert_allclose([e.speed for e in tracker._tracks[0].evidence][:len(speeds)],
                               metres * np.array(speeds))


def test_a_ground_out_of_sight_keeps_its_place_when_the_unit_becomes_the_metre(rng):
    tracker = ObstacleTracker(SETTINGS)
    follow(tracker, AHEAD, rng, 0.8, metres=2.0)
    scene = AHEAD.scene(0.8, 0.9)
    unseen = replace(scene.planes[0], last_stamp=0)
    tracker.step(AHEAD.extraction(0.8, 0.9, rng), replace(scene, planes=(unseen,)))
    assert np.linalg.norm(tracker._view.ground) == pytest.approx(1 / 1.65, rel=1e-3)


def test_the_scene_filter_hands_over_in_the_unit_of_before(rng):
    mover, place = Mover(1, (0.3, 20), (0, 12)), AHEAD.pose(0.8)[1]
    drive, tracker = Groundless((mover,)), ObstacleTracker(SETTINGS)
    follow(tracker, Groundless(()), rng, 0.8, metres=2.0)
    normal, d = mover.plane(0.9)
    item = PlaneHandover(9 * 10**8, 1, Label.MOVING, normal / d, np.zeros(3), 1e-6 * np.eye(6))
    seen = replace(drive.extraction(0.8, 0.9, rng), planes=())
    [found] = tracker.step(seen, drive.scene(0.8, 0.9),
                           [units.handover_in_unit(item, 0.5, place)])[0]
    assert found.position[2] == pytest.approx(20 + 12 * 0.9, rel=1e-3)


@pytest.mark.parametrize('growth', [1.6, 0.6])
def test_obstacles_follow_a_metric_scale_that_is_put_right(rng, growth):
    tracker = ObstacleTracker(SETTINGS)
    [before] = follow(tracker, AHEAD, rng, 0.8)[-1]
    speeds = [e.speed for e in tracker._tracks[0].evidence]
    scene, place = AHEAD.scene(0.8, 0.9), AHEAD.pose(0.8)[1]
    grown = replace(scene, unit=growth, baseline=growth * scene.baseline,
                    t_world_from_cam=place + growth * (scene.t_world_from_cam - place),
                    velocity_world=growth * scene.velocity_world,
                    planes=tuple(replace(p, depth=growth * p.depth) for p in scene.planes))
    [after] = tracker.step(AHEAD.extraction(0.8, 0.9, rng), grown)[0]
    assert after.id == before.id
    assert after.velocity[2] == pytest.approx(growth * before.velocity[2], rel=0.1)
    ahead = [(o.position - t)[2] for o, t in ((before, place), (after, grown.t_world_from_cam))]
    assert ahead[1] == pytest.approx(growth * (ahead[0] + 0.2), rel=0.05)  # 2 m/s faster
    np.testing.assert_allclose([e.speed for e in tracker._tracks[0].evidence][:len(speeds)],
                               growth * np.array(speeds))


@pytest.mark.parametrize('metres', [2.0, 0.5])
def test_where_the_map_is_another_one_all_is_forgotten(rng, metres):
    tracker = ObstacleTracker(SETTINGS)
    assert [o.id for o in follow(tracker, AHEAD, rng, 0.8)[-1]] == [1]
    assert not follow(tracker, AHEAD, rng, DT, start=0.8, metres=metres)[0]
    assert 1 not in [o.id for o in follow(tracker, AHEAD, rng, 0.5, start=0.9)[-1]]


def test_before_a_camera_that_has_only_stood_there_is_no_unit_to_change(rng):
    tracker, stands = ObstacleTracker(SETTINGS), Groundless(AHEAD.movers, speed=0.0)
    before = follow(tracker, stands, rng, 0.8, metres=1.001)[-1]
    after = follow(tracker, stands, rng, DT, start=0.8)[-1]
    assert [o.id for o in before] == [o.id for o in after] == [1]


def test_a_hand_over_comes_into_the_new_unit(rng):
    A, place, unit = rng.normal(size=(6, 6)), np.array([1.0, -0.5, 40]), 2.5
    item = PlaneHandover(1, 1, Label.MOVING, np.array([0.01, 0.05, -0.02]), np.array([0, 0, 3.0]),
                         A @ A.T)
    there = units.handover_in_unit(item, unit, place)
    X = rng.normal(size=(5, 3)) + place
    X -= ((X @ item.plane + 1) / (item.plane @ item.plane))[:, None] * item.plane  # on the plane
    np.testing.assert_allclose((place + unit * (X - place)) @ there.plane, -1)
    np.testing.assert_allclose(there.velocity, [0, 0, 7.5])
    J = unit * np.eye(6)
    J[:3, :3] = jacobian(lambda e: units.handover_in_unit(
        replace(item, plane=item.plane + e), unit, place).plane, np.zeros(3))
    np.testing.assert_allclose(there.covariance, J @ item.covariance @ J.T, rtol=1e-5)


@pytest.mark.parametrize(('place', 'velocity', 'yaw'), [
    ((-3.2, 4.5), (0, 16), np.pi / 2), ((3.0, 5.2), (-5, 8), 0.0), ((0.3, 3.0), (0, 9), 0.0)],
    ids=['overtakes', 'at the other edge', 'before the camera'])
def test_no_other_car_at_the_edge_is_the_one_that_passed(rng, place, velocity, yaw):
    tracker, passed = ObstacleTracker(SETTINGS), Drive((Mover(1, (-3.5, 22), (0, -8)),))
    assert [o.id for o in follow(tracker, passed, rng, 0.9)[-1]] == [1]
    start = np.array(place) + (0, 10) - np.array(velocity)  # there at 1 s
    other = Drive((Mover(1, tuple(start), velocity, size=(4.5, 1.5), yaw=yaw),))
    for obstacles in follow(tracker, other, rng, 0.3, start=0.9):
        assert 1 not in [o.id for o in obstacles]


def test_a_plane_is_of_one_track_only(rng):
    tracker = ObstacleTracker(SETTINGS)
    two = Drive((Mover(1, (-4, 14), (0, 9)), Mover(2, (4, 14), (0, 12))))
    follow(tracker, two, rng, 0.5)
    swapped = Drive((replace(two.movers[0], id=2),), hidden={1: lambda now: True})
    follow(tracker, swapped, rng, DT, start=0.5)
    assert sorted(track.plane_id for track in tracker._tracks) == [NO_PLANE, 2]


def test_no_id_is_given_twice(rng):
    tracker = ObstacleTracker(SETTINGS)
    movers = [Mover(OWN_IDS + 1, (-4, 14), (0, 9)), Mover(1, (4, 14), (0, 12))]
    follow(tracker, Drive(tuple(movers)), rng, 0.5)
    follow(tracker, Drive(tuple(movers[:1])), rng, 0.7, start=0.5)
    assert [o.id for o in follow(tracker, Drive(tuple(movers)), rng, 0.5, start=1.2)[-1]] == [
        OWN_IDS + 1, OWN_IDS + 2]


@pytest.mark.parametrize(('status', 'is_found'), [
    (MotionStatus.STANDSTILL, False), (MotionStatus.MOVING, True)])
def test_to_a_standing_camera_what_rests_is_no_obstacle_that_was_lost(rng, status, is_found):
    drive = Drive((Mover(1, (0.3, 12), (0, 0.0)),), speed=0.0)
    extraction = drive.extraction(0.4, 0.5, rng)
    view = view_of(extraction, drive.scene(0.4, 0.5), None)
    item = detections(extraction, view, SETTINGS)[0]
    n = len(extraction.x_cur)
    rests = replace(extraction, planes=(), label=np.full(n, Label.STATIONARY, np.int8),
                    plane_id=np.full(n, -1),
                    motion=replace(extraction.motion, status=status))
    found = redetection.found(item.z, item.R, item.box, rests, view, SETTINGS)
    assert (found is not None) == is_found
