"""Decisions of plane management on made-up evidence."""

from dataclasses import replace

from mv_slapse.config import ObstacleSettings
from mv_slapse.obstacles import lifecycle
from mv_slapse.obstacles.lifecycle import Evidence
import pytest

SETTINGS = ObstacleSettings()
PAIR = 100_000_000  # ns


def evidence(statistics, nis=1.5, speed=5.0, pair=PAIR, overlap=0.9):
    """Return evidence of successive pairs; the first one starts the track."""
    return [Evidence(i * pair, (i + 1) * pair, statistic, nis * (i > 0), 6 * (i > 0), speed,
                     overlap) for i, statistic in enumerate(statistics)]


def test_steady_motion_confirms():
    assert lifecycle.confirms(evidence([50, 50]), True, SETTINGS)


def test_what_all_pairs_together_show_confirms():
    assert lifecycle.confirms(evidence([5, 10, 50]), True, SETTINGS)


@pytest.mark.parametrize(('case', 'why'), [
    (evidence([50]), 'too few pairs'),
    (evidence([50] * 5, pair=PAIR // 10), 'too short'),
    (evidence([3] * 6), 'velocity may be zero'),
    (evidence([50, 50, 50, 3]), 'the newest pair shows none'),
    (evidence([50] * 4, nis=30), 'detections do not move as the vectors say'),
    (evidence([50] * 4, overlap=0.5), 'the outline is another one each time'),
    (evidence([50] * 4, speed=0.1), 'too slow'),
    ([], 'nothing')], ids=lambda x: x if isinstance(x, str) else '')
def test_less_does_not_confirm(case, why):
    assert not lifecycle.confirms(case, True, SETTINGS)


def test_an_outline_that_lasts_makes_up_for_what_its_vectors_say():
    beside = evidence([50] * 8, nis=15, overlap=0.95)
    assert not lifecycle.confirms(beside[:2], True, SETTINGS)
    assert lifecycle.confirms(beside, True, SETTINGS)


def test_what_the_labels_do_not_call_moving_is_not_confirmed_yet():
    before = [item._replace(called=False) for item in evidence([50] * 4)]
    assert not lifecycle.confirms(before, True, SETTINGS)
    assert lifecycle.confirms([*before[:-1], before[-1]._replace(called=True)], True, SETTINGS)
    assert not lifecycle.confirms([*evidence([50] * 4)[:-1], before[-1]], True, SETTINGS)


def test_a_bad_beginning_is_forgotten():
    good = evidence([50] * 4)
    bad = [item._replace(nis=90.0, overlap=0.1) for item in good[1:]]
    later = [item._replace(start=item.start + 3 * PAIR, stamp=item.stamp + 3 * PAIR)
             for item in good[1:]]
    assert lifecycle.one_body(bad) == 0
    assert lifecycle.one_body([*bad, *later]) == lifecycle.one_body(later) > 0


def test_a_region_whose_score_lasts_needs_no_outline_if_it_is_alone():
    jumps = evidence([50] * 4, overlap=0.5)
    lasting = [item._replace(score=10.0 * i) for i, item in enumerate(jumps, 1)]
    assert lifecycle.confirms(lasting, True, SETTINGS)
    assert not lifecycle.confirms(lasting, True, SETTINGS, alone=False)
    assert not lifecycle.confirms(lasting[:2], True, SETTINGS), 'wrong vectors score as much'
    assert not lifecycle.confirms([*lasting, jumps[-1]], True, SETTINGS), 'the newest counts'


@pytest.mark.parametrize(('score', 'speed', 'confirmed'), [
    (20.0, 5.0, True), (5.0, 5.0, False), (20.0, 0.1, False)],
    ids=['labelled', 'hardly', 'too slow'])
def test_a_region_s_score_tells_that_it_moves_before_its_speed_does(score, speed, confirmed):
    starting = [item._replace(score=score) for item in evidence([5, 5], speed=speed)]
    assert lifecycle.confirms(starting, True, SETTINGS) == confirmed


def test_a_score_does_not_tell_of_motion_and_of_a_body_at_once():
    jumps = [item._replace(score=90.0) for item in evidence([5] * 4, overlap=0.5)]
    assert not lifecycle.confirms(jumps, True, SETTINGS)
    assert lifecycle.confirms([item._replace(statistic=50.0) for item in jumps], True, SETTINGS)


def test_what_two_short_pairs_show_counts_as_one_of_their_time():
    short = evidence([50] * 3, pair=PAIR // 2)
    assert lifecycle.one_body(short) == pytest.approx(lifecycle.one_body(evidence([50] * 2)))


def test_unknown_scale_has_no_least_speed():
    assert lifecycle.confirms(evidence([50] * 4, speed=0.1), False, SETTINGS)


def test_old_evidence_does_not_confirm():
    late = [*evidence([50]), Evidence(20 * PAIR, 21 * PAIR, 50, 1, 6, 5)]
    assert not lifecycle.confirms(late, True, SETTINGS)


def test_what_two_pairs_of_a_fast_stream_show_may_suffice():
    assert lifecycle.confirms(evidence([12, 12], nis=0.5, pair=2 * PAIR // 3), True, SETTINGS)
    assert not lifecycle.confirms(evidence([10, 10], nis=0.5), True, SETTINGS)


def test_half_a_second_at_rest_is_a_standstill():
    assert lifecycle.stands_still(evidence([50, 50] + [2] * 6, speed=0.3), 1.0, SETTINGS)


@pytest.mark.parametrize('case', [
    evidence([2] * 4, speed=0.3), evidence([2] * 8, speed=3.0),
    evidence([2] * 5 + [30] + [2] * 2, speed=0.3), []],
    ids=['too short', 'too fast', 'moved in between', 'nothing'])
def test_less_is_no_standstill(case):
    assert not lifecycle.stands_still(case, 1.0, SETTINGS)


def test_a_slow_obstacle_whose_place_turns_stationary_has_stopped():
    assert lifecycle.melts_into_scene(1.5, 0.5, 0.8, 1.0, SETTINGS)
    assert not lifecycle.melts_into_scene(6.0, 0.5, 0.8, 1.0, SETTINGS)
    assert not lifecycle.melts_into_scene(1.5, 0.5, 0.3, 1.0, SETTINGS)


def test_at_free_scale_the_least_speed_follows_the_camera():
    slow = evidence([2] * 8, speed=0.3)
    assert not lifecycle.stands_still(slow, 0.2, SETTINGS)
    assert not lifecycle.melts_into_scene(1.5, 0.5, 0.8, 0.2, SETTINGS)


def test_settings_decide():
    eager = replace(SETTINGS, confirm_pairs=1, confirm_time=0.0)
    assert lifecycle.confirms(evidence([50]), True, eager)
    assert not lifecycle.confirms(evidence([50] * 4), True, replace(SETTINGS, min_speed=6.0))
