from mv_slapse.nodes.gate import Gate
import pytest


def test_calls_are_held_until_the_gate_opens_and_then_pass_in_order():
    is_open, passed = [], []
    gate = Gate(lambda *_: bool(is_open), lambda *args: passed.append(args), 10)
    gate(1, 'a')
    gate(2, 'b')
    assert passed == []
    is_open.append(True)
    gate(3, 'c')
    assert passed == [(1, 'a'), (2, 'b'), (3, 'c')]


def test_only_the_newest_are_kept():
    is_open, passed = [], []
    gate = Gate(lambda *_: bool(is_open), passed.append, 2)
    for i in range(5):
        gate(i)
    is_open.append(True)
    gate.drain()
    assert passed == [3, 4]


def test_what_is_cleared_does_not_pass():
    is_open, passed = [], []
    gate = Gate(lambda *_: bool(is_open), passed.append, 2)
    gate(1)
    gate.clear()
    is_open.append(True)
    gate.drain()
    assert passed == []


def test_it_is_done_once_it_has_opened_and_holds_nothing():
    is_open, passed = [], []

    def take(i):
        """Fail at the first."""
        passed.append(i)
        if i == 1:
            raise ValueError

    gate = Gate(lambda *_: bool(is_open), take, 10)
    assert not gate.is_done
    gate(1)
    gate(2)
    assert not gate.is_done
    is_open.append(True)
    with pytest.raises(ValueError):  # noqa: PT011 (our own)
        gate.drain()
    assert not gate.is_done
    gate.drain()
    assert gate.is_done
    assert passed == [1, 2]
