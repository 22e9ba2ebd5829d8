"""Figures of a planner, by a car that the camera nears at 5 m/s: a key frame each 0.1 s."""

from mv_slapse.evaluation import planner
from mv_slapse.evaluation.detection import PointLabels
from mv_slapse.storage.tum import Trajectory
import numpy as np
import pytest

PERIOD = 100_000_000
N = 40
MOVER = 100
STAMPS = PERIOD * np.arange(N)
NAMES = ('stamp', 'id', 'x', 'y', 'width', 'height', 'px', 'py', 'pz', 'vx', 'vy', 'vz', 'ttc',
         'n_macroblocks')
SPEED = 10.0  # of the camera, along z
COURSE = planner.Course(Trajectory(STAMPS, np.c_[np.zeros((N, 2)), SPEED * STAMPS * 1e-9],
                                   np.tile([0.0, 0, 0, 1], (N, 1))), 1.0)
CONTACT = 4.4  # [s] at the first key frame: 2 s at the 24th, 1 s at the 34th


def table(frames, x=32.0, px=0.0, contact=CONTACT, **columns):
    """Return rows of (key frame): a box of 64x48 px, px [m] beside the way, nearer at 5 m/s."""
    frames = np.array(list(frames), int)
    time = 0.1 * frames
    ttc = contact - time
    zero = np.zeros(len(frames))
    values = [PERIOD * frames, zero + MOVER, zero + x, zero + 16, zero + 64, zero + 48, zero + px,
              zero, SPEED * time + 5 * ttc, zero, zero, zero + 5, ttc, zero + 12]
    found = dict(zip(NAMES, values, strict=True))
    found.update({name: np.broadcast_to(value, len(frames)) for name, value in columns.items()})
    return {'state': np.array(['confirmed'] * len(frames), str), **found}


def movers(frames=range(N), aside=0.0, **columns):
    return table(frames, **columns, aside=aside)


def figures(obstacles, true, course=COURSE):
    return planner.figures(obstacles, STAMPS, true, course)


def counts(found):
    return tuple(found[f'hazards{name}'] for name in ('', '_in_time', '_missed'))


@pytest.mark.parametrize(('first', 'expected'), [
    (10, (1, 1, 0)), (24, (1, 1, 0)), (25, (1, 0, 0)), (34, (1, 0, 0)), (35, (1, 0, 1))])
def test_a_hazard_is_in_time_at_two_seconds_and_missed_after_one(first, expected):
    found = figures(table(range(first, N)), movers())
    assert counts(found) == expected
    if not expected[2]:
        assert found['contact_at_confirmation_s'] == pytest.approx(CONTACT - 0.1 * first)


@pytest.mark.parametrize(('first', 'in_time'), [(33, 1), (34, 0)])
def test_what_is_small_for_long_is_due_half_a_second_after_it_is_large(first, in_time):
    size = np.where(np.arange(N) < 28, 6, 12)
    assert counts(figures(table(range(first, N)), movers(n_macroblocks=size)))[1] == in_time


@pytest.mark.parametrize('changed', [
    {'aside': 1.3}, {'vz': 0.1}, {'n_macroblocks': 5}, {'contact': 9.0}, {'aside': np.inf}])
def test_what_goes_by_stands_or_stays_away_is_no_hazard(changed):
    assert counts(figures(table([]), movers(**changed))) == (0, 0, 0)


@pytest.mark.parametrize(('first', 'others'), [(15, (1, 1)), (16, (1, 0))])
def test_any_other_mover_is_in_time_half_a_second_after_it_covers_nine_macroblocks(first, others):
    size = np.where(np.arange(N) < 10, 8, 9)
    found = figures(table(range(first, N)), movers(n_macroblocks=size, aside=3.0))
    assert (found['others'], found['others_in_time']) == others


@pytest.mark.parametrize('changed', [
    {'aside': 0.0}, {'aside': 3.0, 'vz': 0.1}, {'aside': 3.0, 'n_macroblocks': 8}])
def test_hazards_and_what_stands_or_stays_small_are_no_others(changed):
    assert figures(table(range(N)), movers(**changed))['others'] == 0


def test_an_obstacle_on_another_mover_is_no_confirmation():
    assert counts(figures(table(range(N), x=300.0), movers())) == (1, 0, 1)


def test_what_is_ahead_where_nothing_moves_is_false_braking_in_its_last_three_seconds():
    nothing = movers(range(0))
    found = figures(table(range(1, N)), nothing)
    assert (found['false_braking_frames'], found['frames_judged']) == (N - 15, N)
    assert figures(table(range(1, N)), movers())['false_braking_frames'] == 0
    assert figures(table(range(1, N), state='tentative'), nothing)['false_braking_frames'] == 0
    # Planners use what goes on unseen, too.
    coasting = figures(table(range(1, N), state='coasting'), nothing)
    assert coasting['false_braking_frames'] == figures(table(range(1, N)), nothing)[
        'false_braking_frames'] > 0


@pytest.mark.parametrize(('px', 'false'), [(2.0, N - 15), (2.2, 0), (-2.2, 0)])
def test_what_goes_by_brakes_nobody_where_lengths_are_known(px, false):
    rows = table(range(1, N), px=px)
    assert figures(rows, None)['false_braking_frames'] == false
    unknown = COURSE._replace(scale=None)
    assert figures(rows, None, unknown)['false_braking_frames'] == N - 15
    half = COURSE._replace(scale=0.5)
    assert figures(rows, None, half)['false_braking_frames'] == N - 15


def test_what_crosses_is_ahead_by_where_it_will_be():
    rows = table([20], px=-8.0, vx=8.0 / 2.4)
    assert figures(rows, None)['false_braking_frames'] == 1
    rows = table([20], px=-8.0, vx=0.0)
    assert figures(rows, None)['false_braking_frames'] == 0


def test_a_camera_that_stands_brakes_for_nothing():
    still = COURSE.path.positions * 0.01
    course = COURSE._replace(path=Trajectory(STAMPS, still, COURSE.path.quaternions))
    assert figures(table(range(1, N)), None, course)['false_braking_frames'] == 0


def test_boxes_alone_tell_what_is_no_false_braking():
    boxes = {name: movers()[name] for name in ('stamp', 'id', 'x', 'y', 'width', 'height')}
    found = figures(table(range(1, N)), boxes)
    assert 'hazards' not in found
    assert found['false_braking_frames'] == 0


@pytest.mark.parametrize(('label', 'expected'), [(2, 0), (1, 10)])
def test_where_the_truth_has_points_these_tell_what_an_obstacle_is_on(label, expected):
    frames = range(N - 10, N)
    at = np.broadcast_to([40.0, 30.0], (1, N, 2))
    points = PointLabels(at, np.ones((1, N), bool), np.array([label]), 10.0)
    small = movers(frames, width=2.0, height=2.0)
    found = planner.figures(table(frames), STAMPS, small, COURSE, points)
    assert found['false_braking_frames'] == expected
