"""Figures of confirmed obstacles against made-up movers: a key frame and a true row each 0.1 s."""

from mv_slapse.evaluation import tracking
from mv_slapse.storage.tum import Trajectory
import numpy as np
import pytest

PERIOD = 100_000_000
N = 20
MOVER = 100
NAMES = ('stamp', 'id', 'x', 'y', 'width', 'height', 'px', 'py', 'pz', 'vx', 'vy', 'vz', 'ttc',
         'n_macroblocks')
STAMPS = PERIOD * np.arange(N)


def table(rows, **columns):
    """Return rows of (key frame, id, x) with boxes of 64x32 px, 10 m ahead, at 5 m/s."""
    values = [(PERIOD * k, id_, x, 16, 64, 32, 0, 0, 10, 0, 0, 5, 4, 8) for k, id_, x in rows]
    found = dict(zip(NAMES, np.array(values, float).reshape(-1, len(NAMES)).T, strict=True))
    found.update({name: np.array(value, float) for name, value in columns.items()})
    return {**found, 'state': np.array(['confirmed'] * len(rows), str)}


def movers(frames=range(N), **columns):
    return table([(k, MOVER, 32) for k in frames], **columns)


def figures(obstacles, true=None, **more):
    return tracking.figures(obstacles, STAMPS, movers() if true is None else true, **more)


def test_a_mover_that_is_met_throughout_is_tracked_in_time_and_without_error():
    found = figures(table([(k, 5, 40) for k in range(4, N)]))
    expected = {'movers_tracked': 1, 'movers_trackable': 1, 'movers_confirmed_in_time': 1,
                'movers_due': 1, 'identity_switches': 0, 'relabels': 0,
                'false_obstacles_per_frame': 0, 'obstacle_position_error_m': 0,
                'obstacle_velocity_error_m_s': 0, 'obstacle_ttc_error_percent': 0}
    assert {name: found[name] for name in expected} == expected


@pytest.mark.parametrize(('first', 'in_time'), [(5, 1), (6, 0)])
def test_half_a_second_is_in_time(first, in_time):
    found = figures(table([(k, 5, 32) for k in range(first, N)]))
    assert found['movers_confirmed_in_time'] == in_time
    assert found['movers_tracked'] == 1


def test_a_mover_without_obstacle_is_missed():
    found = figures(table([]))
    assert (found['movers_tracked'], found['movers_trackable']) == (0, 1)
    assert (found['movers_confirmed_in_time'], found['movers_due']) == (0, 1)
    assert found['obstacle_position_error_m'] is None


def test_small_standing_or_brief_movers_are_not_due():
    for true in (movers(n_macroblocks=[5] * N), movers(vz=[0.1] * N), movers(range(5))):
        assert figures(table([]), true)['movers_due'] == 0


def test_a_passage_survives_a_flicker_but_not_a_long_gap():
    holds = np.ones(N, bool)
    holds[6] = False
    assert tracking.passages(movers(), holds) == [(MOVER, 0, PERIOD * (N - 1))]
    holds[6:9] = False
    assert tracking.passages(movers(), holds) == [(MOVER, 0, PERIOD * 5),
                                                  (MOVER, PERIOD * 9, PERIOD * (N - 1))]


def test_tentative_obstacles_do_not_count():
    rows = table([(k, 5, 32) for k in range(N)])
    rows['state'][:] = 'tentative'
    assert figures(rows)['movers_tracked'] == 0


def test_obstacles_away_from_movers_are_false():
    rows = [(k, 5, 40) for k in range(4, N)] + [(k, 6, 500) for k in range(3)]
    assert figures(table(rows))['false_obstacles_per_frame'] == 3 / N


def test_a_part_of_a_mover_is_not_false_and_a_large_box_around_it_is():
    rows = table([(k, 5, 32) for k in range(N)])
    small = {**rows, 'width': rows['width'] / 5, 'height': rows['height'] / 5}
    large = {**rows, 'width': 4 * rows['width'], 'height': 4 * rows['height']}
    assert figures(small)['false_obstacles_per_frame'] == 0
    assert figures(large)['false_obstacles_per_frame'] == 1


def test_who_is_narrower_than_a_macroblock_is_seen_to_a_macroblock():
    rows = table([(k, 5, 32) for k in range(N)])
    person, post = (movers(width=np.full(N, width), x=np.full(N, 58.0)) for width in (12.0, 2.0))
    assert figures(rows, person)['false_obstacles_per_frame'] == 0
    assert figures(rows, post)['false_obstacles_per_frame'] == 1


def test_obstacles_are_false_where_no_mover_is_visible():
    rows = [(k, 5, 32) for k in range(N)]
    assert figures(table(rows), movers(range(6)))['false_obstacles_per_frame'] == 14 / N


@pytest.mark.parametrize(('elsewhere', 'false'), [(False, 0), (True, 3)])
def test_an_obstacle_that_coasts_is_false_unless_its_mover_is_hidden(elsewhere, false):
    rows = table([(k, 5, 32) for k in range(9)])
    rows['state'] = np.where(np.arange(9) < 6, 'confirmed', 'coasting')
    places = [(k, MOVER, 32) for k in range(6)] + [(k, MOVER, 500) for k in range(6, N)
                                                   if elsewhere]
    found = figures(rows, table(places))
    assert found['false_obstacles_per_frame'] == false / N
    rows['id'][6:] = 7  # nobody saw what this one is
    assert figures(rows, table(places))['false_obstacles_per_frame'] == 3 / N


def test_an_obstacle_before_another_car_is_not_that_car_too():
    true = table([(k, MOVER + i, 32 + 20 * i) for k in range(N) for i in (0, 1)])
    found = figures(table([(k, 5, 52) for k in range(N)]), true)
    assert (found['movers_tracked'], found['movers_trackable']) == (1, 2)
    both = figures(table([(k, 5 + i, 32 + 20 * i) for k in range(N) for i in (0, 1)]), true)
    assert both['movers_tracked'] == 2


def test_a_change_of_identity_is_counted_within_a_passage_only():
    rows = table([(k, 5 if k < 10 else 7, 32) for k in range(N)])
    assert figures(rows)['identity_switches'] == 1
    assert figures(rows, movers([*range(7), *range(12, N)]))['identity_switches'] == 0


def test_a_car_that_starts_is_due_from_then_on():
    true = movers(vz=[0.0] * 6 + [5.0] * (N - 6))
    found = figures(table([(k, 5, 32) for k in range(10, N)]), true)
    assert (found['relabelled_in_time'], found['relabels']) == (1, 1)
    assert found['relabel_time_s'] == pytest.approx(0.4)
    late = figures(table([(k, 5, 32) for k in range(18, N)]), true)
    assert (late['relabelled_in_time'], late['relabels']) == (0, 1)
    never = figures(table([]), true)
    assert (never['relabelled_in_time'], never['relabels']) == (0, 1)


def test_a_car_that_stops_may_be_an_obstacle_for_a_second():
    true = movers(vz=[5.0] * 6 + [0.0] * (N - 6))
    for last, in_time in ((16, 1), (17, 0)):
        found = figures(table([(k, 5, 32) for k in range(last + 1)]), true)
        assert (found['relabelled_in_time'], found['relabels']) == (in_time, 1)
        assert found['relabel_time_s'] == pytest.approx(0.1 * (last - 6))


def test_errors_are_medians_and_a_share_of_the_range():
    rows = [(k, 5, 32) for k in range(N)]
    obstacles = table(rows, px=[3.0] * N, vy=[-4.0] * N, ttc=[4.4] * N)
    path = Trajectory(STAMPS, np.tile([0, 0, -10.0], (N, 1)), np.tile([0, 0, 0, 1.0], (N, 1)))
    found = figures(obstacles, path=path)
    assert found['obstacle_position_error_m'] == pytest.approx(3)
    assert found['obstacle_position_error_percent'] == pytest.approx(100 * 3 / 20)
    assert found['obstacle_velocity_error_m_s'] == pytest.approx(4)
    assert found['obstacle_ttc_error_percent'] == pytest.approx(10)


def test_lengths_are_compared_in_metres():
    rows = [(k, 5, 32) for k in range(N)]
    half = table(rows, pz=[5.0] * N, vz=[2.5] * N)
    found = figures(half, scale=2.0)
    assert found['obstacle_position_error_m'] == pytest.approx(0)
    assert found['obstacle_velocity_error_m_s'] == pytest.approx(0)


def test_normalised_errors_use_the_covariance_of_each_obstacle():
    rows = [(k, 5, 32) for k in range(N)]
    obstacles = table(rows, px=[1.0] * N, vx=[2.0] * N)
    covariances = {(int(stamp), 5): np.diag([0.5, 1, 1, 1, 1, 1]) for stamp in STAMPS}
    assert figures(obstacles, covariances=covariances)['obstacle_nees'] == pytest.approx(6)
    assert figures(obstacles)['obstacle_nees'] is None
