from mv_slapse.records import Speed
from mv_slapse.scene.scale.speed import HOLD, SpeedLog
import numpy as np
import pytest

S = 1_000_000_000


def log_of(*speeds):
    log = SpeedLog()
    log.feed(Speed(round(time * S), value) for time, value in speeds)
    return log


def test_the_way_is_the_area_below_the_speeds():
    log = log_of((0.0, 2.0), (0.1, 4.0), (0.3, 0.0))
    way, held = log.travelled(0, round(0.3 * S))
    assert way == pytest.approx(0.1 * 3 + 0.2 * 2)
    assert held == 0
    assert log.travelled(round(0.05 * S), round(0.2 * S)).way == pytest.approx(
        0.05 * 3.5 + 0.1 * 4)  # that it falls is not known yet


def test_order_does_not_matter_and_backwards_is_negative():
    speeds = [(0.1 * i, -1.0 - 0.1 * i) for i in range(6)]
    shuffled = [speeds[i] for i in np.random.default_rng(0).permutation(6)]
    ways = [log_of(*some).travelled(round(0.05 * S), round(0.5 * S)) for some in
            (speeds, shuffled)]
    assert ways[0] == ways[1]
    assert ways[0].way == pytest.approx(-0.45 * 1.275)


def test_speeds_after_the_end_do_not_count():
    known = log_of((0.0, 3.0), (0.2, 3.0)).travelled(0, round(0.3 * S))
    later = log_of((0.0, 3.0), (0.2, 3.0), (0.31, 9.0)).travelled(0, round(0.3 * S))
    assert known == later
    assert known.way == pytest.approx(0.9)
    assert known.held == pytest.approx(0.1)


def test_a_speed_is_held_for_a_while_only():
    log = log_of((0.0, 3.0))
    assert log.travelled(0, HOLD).way == pytest.approx(1.5)
    assert log_of((0.0, 3.0)).travelled(0, HOLD + 1) is None
    assert log_of((0.0, 3.0), (1.0, 3.0)).travelled(round(0.2 * S), S) is None
    assert log_of((1.0, 3.0)).travelled(0, 2 * S) is None
    assert log_of((0.4, 3.0), (0.8, 3.0)).travelled(0, S).held == pytest.approx(0.6)


def test_nothing_told_is_nothing_known():
    assert SpeedLog().travelled(0, S) is None
    assert log_of((0.5, np.nan), (0.6, np.inf)).travelled(0, S) is None
    assert log_of((0.0, 1.0), (0.1, 1.0)).travelled(S, S) is None


def test_what_is_past_is_forgotten():
    log = log_of(*((0.01 * i, 1.0) for i in range(1000)))
    for i in range(95):
        assert log.travelled(i * S // 10, (i + 1) * S // 10).way == pytest.approx(0.1)
    assert len(log._speeds) < 70
