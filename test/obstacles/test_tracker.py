"""Tracks of drawn traffic against its exact motion."""

from dataclasses import replace

from drawn_movers import Drive, DT, GRID, Groundless, Mover, nanoseconds, usable
from mv_slapse.config import ObstacleSettings
from mv_slapse.obstacles import tracker as obstacles_module
from mv_slapse.obstacles.tracker import ObstacleTracker
from mv_slapse.records import (
    Extraction,
    Label,
    ObstacleState,
    PlaneHandover,
    PlaneObservation,
    ScalePrior,
    ScaleStatus,
)
import numpy as np
import pytest

CASES = {
    'slower': Drive((Mover(1, (0, 22), (0, 5)),)),
    'same_speed': Drive((Mover(1, (0, 14), (0, 10)),)),
    'faster': Drive((Mover(1, (0.5, 10), (0, 12.5)),)),
    'oncoming': Drive((Mover(1, (-3, 45), (0, -8)),)),
    'crossing': Drive((Mover(1, (-10, 22), (6, 0), size=(4.2, 1.5)),), speed=3.0),
    'standing_camera': Drive((Mover(1, (-6, 14), (5, 0), size=(4.2, 1.5)),), speed=0.0),
    'turning': Drive((Mover(1, (1, 16), (1, 7)),), omega=0.1),
}
SETTINGS = ObstacleSettings()
ENOUGH = 6  # macroblocks


def run(drive, rng, seconds=3.0, settings=SETTINGS, start=0.0):
    """Return (time, obstacles, handovers) of each key frame."""
    tracker, result = ObstacleTracker(settings), []
    for i in range(int(round(seconds / DT))):
        before, now = start + i * DT, start + (i + 1) * DT
        obstacles, handovers = tracker.step(drive.extraction(before, now, rng),
                                            drive.scene(before, now, rng))
        result.append((now, obstacles, handovers))
    return result


def errors(drive, result):
    """Return (position over range, velocity [m/s], time to contact as a share, NEES) (N, 4)."""
    mover, rows = drive.movers[0], []
    for now, obstacles, _ in result:
        R, t = drive.pose(now)
        relative = R.T @ (mover.centre(now) - t)
        camera = (t - drive.pose(now - DT)[1]) / DT
        closing = -(R.T @ (mover.speed(now) - camera))[2]
        for o in usable(obstacles):
            error = np.r_[o.position - mover.centre(now), o.velocity - mover.speed(now)]
            contact = relative[2] / closing if closing > 1 else np.nan
            rows.append([np.linalg.norm(error[:3]) / np.linalg.norm(relative),
                         np.linalg.norm(error[3:]),
                         abs(o.time_to_contact - contact) / contact,
                         error @ np.linalg.solve(o.covariance, error)])
    return np.array(rows)


@pytest.fixture(params=CASES, ids=str)
def drive(request):
    return CASES[request.param]


def test_each_mover_is_one_obstacle_confirmed_within_half_a_second(drive, rng):
    large, confirmed, ids = None, None, set()
    for now, obstacles, _ in run(drive, rng):
        if large is None and len(drive.blocks(drive.movers[0], now - DT, now, 0.5)[0]) >= ENOUGH:
            large = now - DT
        if confirmed is None and usable(obstacles):
            confirmed = now
        ids |= {o.id for o in usable(obstacles)}
    assert confirmed - large <= 0.6 + 1e-9
    assert ids == {1}


def test_median_errors_are_small(drive):
    found = np.concatenate([errors(drive, run(drive, np.random.default_rng(seed)))
                            for seed in range(4)])
    position, velocity = np.median(found[:, :2], axis=0)
    contact = found[~np.isnan(found[:, 2]), 2]
    assert position < 0.12
    assert velocity < 1.0
    assert not len(contact) or np.median(contact) < 0.1


def test_errors_are_what_the_covariance_expects():
    nees = [np.mean(errors(drive, run(drive, np.random.default_rng(seed)))[:, 3])
            for drive in CASES.values() for seed in range(3)]
    # Drawn vectors have no errors in common, of which the covariance takes account.
    assert 0.3 < np.mean(nees) < 7.0
    assert np.quantile(nees, 0.95) < 14


def test_cars_side_by_side_are_two_obstacles(rng):
    drive = Drive((Mover(1, (-1.1, 12), (0, 9)), Mover(2, (1.1, 12), (0, 9))))
    ids = [{o.id for o in usable(obstacles)} for _, obstacles, _ in run(drive, rng)]
    assert ids[-1] == {1, 2}


def test_a_standing_surface_is_never_confirmed(rng):
    side = rng.choice([-1, 1])
    drive = Drive((Mover(1, (side * rng.uniform(2.5, 5), rng.uniform(18, 40)), (0, 0),
                         size=(rng.uniform(1.8, 5), 2.0), yaw=-0.8 * side),))
    assert not any(usable(obstacles) for _, obstacles, _ in run(drive, rng, 2.0))


def test_a_car_that_stops_is_handed_over_within_a_second(rng):
    drive = Drive((Mover(1, (0, 13), lambda t: (0, max(0, 7 - 4 * t))),), speed=2.0)
    result = run(drive, rng, 4.0)
    stopped = [(now, handover) for now, _, handovers in result for handover in handovers]
    assert len(stopped) == 1
    now, handover = stopped[0]
    assert 1.3 < now < 1.75 + 1.0
    assert handover.to_label is Label.STATIONARY
    assert handover.id == 1
    n, d = drive.movers[0].plane(now)
    depth = 1 / np.linalg.norm(handover.plane)
    assert abs(depth - abs(d)) < 3 * depth * np.sqrt(
        handover.plane @ handover.covariance[:3, :3] @ handover.plane) / np.linalg.norm(
            handover.plane) + 0.1 * abs(d)
    assert not any(usable(obstacles) for at, obstacles, _ in result if at > now)


def questions(monkeypatch):
    """Return where `alone` goes with which tracks are judged."""
    asked, confirms = [], obstacles_module.lifecycle.confirms

    def noted(evidence, is_metric, settings, alone):
        asked.append(alone)
        return confirms(evidence, is_metric, settings, alone)
    monkeypatch.setattr(obstacles_module.lifecycle, 'confirms', noted)
    return asked


def test_a_parked_car_that_starts_is_confirmed_within_a_second(rng):
    drive = Drive((Mover(1, (2, 16), lambda t: (0, 3 * max(0, t - 1))),), speed=2.0)
    result = run(drive, rng)
    first = next(now for now, obstacles, _ in result if usable(obstacles))
    assert 1.0 < first < 2.0 + DT / 2


def test_an_obstacle_expires_after_its_lifetime(rng):
    drive = replace(CASES['same_speed'], hidden={1: lambda t: t > 1.55})
    states = {round(now, 1): [o.state for o in obstacles]
              for now, obstacles, _ in run(drive, rng)}
    assert states[1.5] == [ObstacleState.CONFIRMED]
    assert states[1.6] == states[2.0] == [ObstacleState.COASTING]
    assert all(not states[time] for time in (2.1, 2.2, 3.0))


def test_an_id_lasts_through_a_short_occlusion(rng):
    drive = replace(CASES['turning'], hidden={1: lambda t: 1.05 < t < 1.45})
    result = run(drive, rng)
    assert {o.id for _, obstacles, _ in result for o in obstacles} == {1}
    assert usable(result[-1][1])[0].state is ObstacleState.CONFIRMED


def test_a_long_gap_gives_a_new_id_never_an_old_one(rng):
    drive = replace(CASES['same_speed'], hidden={1: lambda t: 1.05 < t < 1.95})
    ids = [o.id for _, obstacles, _ in run(drive, rng) for o in usable(obstacles)]
    assert len(set(ids)) == 2


def test_a_coasting_obstacle_moves_on_and_grows_unsure(rng):
    drive = replace(CASES['oncoming'], hidden={1: lambda t: t > 1.55})
    result = [(now, usable(obstacles)[0]) for now, obstacles, _ in run(drive, rng, 1.9)
              if usable(obstacles)]
    seen = [o for now, o in result if now < 1.55][-1]
    lost = result[-1][1]
    assert lost.position[2] < seen.position[2] - 1
    assert np.linalg.norm(lost.position - drive.movers[0].centre(result[-1][0])) < 3
    assert np.trace(lost.covariance) > np.trace(seen.covariance)


def test_two_faces_of_one_car_are_one_obstacle(rng):
    # 2.4 m wide together, as vehicles are.
    drive = Drive((Mover(1, (-1, 14), (0, 6), size=(1.4, 1.5)),
                   Mover(2, (0.2, 14.2), (0, 6), size=(1.0, 1.5))))
    # Without a correlation time the outline is that of the newest blocks.
    result = run(drive, rng, 1.0, replace(SETTINGS, correlation_time=0.0))
    assert [o.id for o in usable(result[-1][1])] == [1]
    assert [o.id for o in usable(run(drive, rng, 1.0)[-1][1])] == [1]
    box = usable(result[-1][1])[0].box
    both = np.concatenate([drive.blocks(m, 0.9, 1.0)[0] for m in drive.movers])
    np.testing.assert_allclose(box[:2], both.min(axis=0) - 8, atol=1)
    np.testing.assert_allclose(box[:2] + box[2:], both.max(axis=0) + 8, atol=1)


def test_two_cars_side_by_side_with_other_speeds_are_two(rng):
    drive = Drive((Mover(1, (-1.5, 14), (0, 6)), Mover(2, (1.5, 14), (0, 13))))
    assert [o.id for o in usable(run(drive, rng, 1.0)[-1][1])] == [1, 2]


def test_a_region_over_two_obstacles_tells_nothing_of_either(rng):
    """Buses side by side go at one speed for a while: then one region holds them both."""
    apart = Drive((Mover(1, (-2.1, 14), (0, 11)), Mover(2, (2.1, 14), (0, 10))))
    joined = Drive((Mover(1, (0, 14), (0, 10.5), size=(6, 1.5)),))
    tracker, ids = ObstacleTracker(SETTINGS), []
    for i in range(20):
        drive, now = joined if i in (10, 11) else apart, (i + 1) * DT
        obstacles, _ = tracker.step(drive.extraction(i * DT, now, rng),
                                    drive.scene(i * DT, now, rng))
        found = sorted(usable(obstacles), key=lambda o: o.position[0])
        if i > 8:
            ids.append([o.id for o in found])
            for obstacle, mover in zip(found, apart.movers, strict=True):
                assert np.linalg.norm(obstacle.position - mover.centre(now)) < 1.0
    assert all(now == ids[0] for now in ids)


@pytest.mark.parametrize(('road', 'ids'), [(True, [1, 2]), (False, [1])])
def test_cars_behind_each_other_are_two_where_the_road_shows_below_the_farther(rng, road, ids):
    drive = Drive((Mover(1, (0, 10), (0, 10)), Mover(2, (2.6, 22), (0, 10))))
    tracker = ObstacleTracker(SETTINGS)
    for i in range(10):
        before, now = i * DT, (i + 1) * DT
        seen = drive.extraction(before, now, rng)
        box = np.concatenate([drive.blocks(drive.movers[1], before, now)[0].min(axis=0),
                              drive.blocks(drive.movers[0], before, now)[0].max(axis=0)])
        at = np.all((box[:2] < GRID) & (box[2:] + (80, 0) > GRID), axis=1)
        at &= np.min(np.linalg.norm(GRID[:, None] - seen.x_cur, axis=2), axis=1) > 1
        if road:
            n = at.sum()
            seen = replace(
                seen, x_cur=np.r_[seen.x_cur, GRID[at]].astype(np.float32),
                x_prev=np.r_[seen.x_prev, GRID[at]].astype(np.float32),
                sigma=np.r_[seen.sigma, np.ones(n)],
                block=np.r_[seen.block, np.full((n, 2), 16)].astype(np.uint8),
                label=np.r_[seen.label, np.full(n, Label.STATIONARY)],
                plane_id=np.r_[seen.plane_id, np.zeros(n)].astype(np.int32))
        obstacles, _ = tracker.step(seen, drive.scene(before, now))
    assert [o.id for o in usable(obstacles)] == ids


def test_passing_cars_keep_their_ids(rng):
    drive = Drive((Mover(1, (-3, 40), (0, -8)), Mover(2, (0, 14), (0, 9))))
    for now, obstacles, _ in run(drive, rng):
        for o in usable(obstacles):
            mover = drive.movers[o.id - 1]
            assert np.linalg.norm(o.position - mover.centre(now)) < 6


def test_what_is_seen_in_the_middle_under_the_name_of_a_car_that_passed_is_another(rng):
    front = Drive((Mover(1, (-3.5, 22), (0, -8)),))
    rest = Drive((Mover(1, (1.0, 26.0), (0, -8), size=(4.5, 1.5)),))
    tracker, seen, errors_ahead = ObstacleTracker(SETTINGS), set(), []
    for i in range(11):
        now = (i + 1) * DT
        drive = front if now < 0.95 else rest
        obstacles, _ = tracker.step(drive.extraction(now - DT, now, rng),
                                    drive.scene(now - DT, now))
        seen |= {o.id for o in usable(obstacles)}
        if drive is rest:
            errors_ahead += [o.position[2] - rest.movers[0].centre(now)[2] for o in obstacles
                             if o.id == 1_000_001]
    assert seen == {1, 1_000_001}
    assert len(errors_ahead) == 2
    np.testing.assert_allclose(errors_ahead, 0.0, atol=2.0)


def test_a_plane_handed_over_becomes_a_track_with_its_place_and_speed(rng):
    drive = replace(CASES['slower'], label=Label.STATIONARY)
    now = 0.5
    n, d = drive.movers[0].plane(now)
    plane, direction = n / d, n
    covariance = np.zeros((6, 6))
    covariance[:3, :3] = 1e-8 * np.eye(3)
    covariance[3:, 3:] = 0.25 * np.eye(3)
    handover = PlaneHandover(nanoseconds(now), 1, Label.MOVING, plane, np.array([0, 0, 1.0]),
                             covariance)
    obstacles, _ = ObstacleTracker(SETTINGS).step(
        drive.extraction(now - DT, now, rng), drive.scene(now - DT, now), [handover])
    assert [o.id for o in obstacles] == [1]
    assert obstacles[0].state is ObstacleState.TENTATIVE
    assert obstacles[0].position @ direction == pytest.approx(-d, abs=0.01)
    np.testing.assert_allclose(obstacles[0].velocity, [0, 0, 1], atol=1e-6)
    np.testing.assert_allclose(np.diag(obstacles[0].covariance)[3:], 0.25, rtol=0.3)


def test_plane_of_an_obstacle_holds_its_position_and_outline(drive):
    for _, obstacles, _ in run(drive, np.random.default_rng(0), 1.5):
        for o in usable(obstacles):
            assert o.plane @ o.position == pytest.approx(-1, abs=1e-6)
            assert o.outline.shape == (4, 3)
            low, high = o.outline.min(axis=0) - 0.3, o.outline.max(axis=0) + 0.3
            assert np.all((o.position >= low) & (o.position <= high))


def test_smallest_motion_is_never_confirmed_where_a_depth_explains_it(rng):
    drive = Drive((Mover(1, (2, 20), (0, 0)),))
    result = run(replace_ground(drive), rng, 1.5)
    priors = {o.scale_prior for _, obstacles, _ in result for o in obstacles}
    assert priors == {ScalePrior.SMALLEST_MOTION}
    assert not any(usable(obstacles) for _, obstacles, _ in result)


def test_what_floats_above_the_horizon_is_never_confirmed(rng):
    class Balloon(Mover):
        def centre(self, time):
            return super().centre(time) - [0, 3.5, 0]

    drive = Drive((Balloon(1, (0, 16), (0, 14), size=(3, 3)),))
    result = run(drive, rng, 1.0)
    assert any(obstacles for _, obstacles, _ in result)
    assert not any(usable(obstacles) for _, obstacles, _ in result)


@pytest.mark.parametrize('is_metric', [True, False])
def test_a_lorry_is_confirmed_and_what_is_taller_never(rng, is_metric):
    for size, is_obstacle in (((2.5, 3.8), True), ((4.0, 8.0), False)):
        drive = Drive((Mover(1, (0, 25), (0, 14), size=size),))
        result = run(drive if is_metric else free_scale(drive), rng, 1.0)
        assert any(obstacles for _, obstacles, _ in result)
        assert any(usable(obstacles) for _, obstacles, _ in result) == is_obstacle


def test_motion_against_the_scene_is_confirmed_without_ground(rng):
    drive = replace_ground(Drive((Mover(1, (0.5, 12), (0, 14)),)))
    result = run(drive, rng, 1.5)
    assert usable(result[-1][1])
    # Its depth is a guess, and says so.
    assert np.sqrt(usable(result[-1][1])[0].covariance[2, 2]) > 2


def free_scale(drive):
    """Return the drive with lengths of unknown unit."""
    return FreeScale(drive.movers, drive.speed, drive.omega, drive.sigma, drive.scale_sigma)


class FreeScale(Drive):
    def scene(self, before, now, rng=None):
        return replace(super().scene(before, now, rng), scale_status=ScaleStatus.UNKNOWN)


def replace_ground(drive):
    """Return the drive without any ground plane."""
    return Groundless(drive.movers, drive.speed, drive.omega, drive.sigma, drive.scale_sigma)


def test_broken_pairs_and_repeated_stamps_do_no_harm(rng):
    drive, tracker = CASES['same_speed'], ObstacleTracker(SETTINGS)
    for i in range(12):
        now = (i + 1) * DT
        extraction = drive.extraction(now - DT, now, rng)
        if i == 8:
            extraction = Extraction(extraction.stamp, extraction.previous_stamp, 640, 480,
                                    extraction.kind, extraction.K,
                                    replace(extraction.motion, status=0), reason='broken')
        obstacles, _ = tracker.step(extraction, drive.scene(now - DT, now))
        if i == 8:
            assert [o.state for o in obstacles] == [ObstacleState.COASTING]
        again, handed = tracker.step(extraction, drive.scene(now - DT, now))
        assert [o.id for o in again] == [o.id for o in obstacles]
        assert not handed
    assert [o.id for o in usable(obstacles)] == [1]


def test_an_observation_that_lies_behind_the_camera_is_ignored():
    drive, now = CASES['slower'], 0.5
    extraction = drive.extraction(now - DT, now, np.random.default_rng(0))
    behind = PlaneObservation(1, Label.MOVING, np.array([0, 0, 0.1]), np.eye(6))
    obstacles, _ = ObstacleTracker(SETTINGS).step(
        replace(extraction, planes=(behind,)), drive.scene(now - DT, now))
    assert obstacles == []


def test_the_same_input_gives_the_same_obstacles():
    runs = [run(CASES['crossing'], np.random.default_rng(3), 1.0) for _ in range(2)]
    for (_, a, _), (_, b, _) in zip(*runs, strict=True):
        for one, other in zip(a, b, strict=True):
            np.testing.assert_array_equal(one.position, other.position)
            np.testing.assert_array_equal(one.covariance, other.covariance)


def test_what_lies_before_or_behind_an_obstacle_is_not_alone(rng, monkeypatch):
    asked = questions(monkeypatch)
    behind = Mover(2, (0.9, 32), (2, 9))  # comes out at the side when it is first seen
    run(Drive((*CASES['slower'].movers, behind), hidden={2: lambda now: now < 1.0}), rng)
    assert asked[0]
    assert not all(asked)
