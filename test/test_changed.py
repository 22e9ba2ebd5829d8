from dataclasses import dataclass

from mv_slapse.changed import replace
import pytest


@dataclass(frozen=True)
class Point:
    x: float
    y: float = 2.0


@dataclass(frozen=True)
class Checked(Point):
    def __post_init__(self):
        if self.x < 0:
            raise ValueError('x is negative')


def test_a_changed_record_is_another_one():
    before = Point(1.0)
    after = replace(before, y=3.0)
    assert after == Point(1.0, 3.0)
    assert before == Point(1.0)
    with pytest.raises(AttributeError):
        after.x = 0.0


def test_a_field_that_is_not_there_is_refused():
    with pytest.raises(TypeError, match='z'):
        replace(Point(1.0), z=0.0)


def test_a_record_that_checks_its_fields_still_does():
    with pytest.raises(ValueError, match='negative'):
        replace(Checked(1.0), x=-1.0)
