"""A short form of each long test of this folder, with the seeds of the long ones."""

import pytest
from reliability import fuzz, mutants, planted, soak


@pytest.mark.parametrize(('target', 'cases'), [
    ('streams', range(0, 1000, 67)), ('messages', range(0, 4000, 13)),
    ('bags', range(0, 600, 17)), ('files', range(0, 400, 7))])
def test_damaged_input_gives_values_or_own_errors(target, cases):
    found = fuzz.batch(target, cases, 0)
    assert not [item for item in found if 'took' not in item.text]


def test_half_a_minute_of_video_changes_nothing_that_stays(tmp_path):
    found = soak.play(0.2, str(tmp_path))
    assert found['threads and files constant']
    assert found['pairs'] > 30


@pytest.mark.parametrize('number', range(len(planted.PLANTED)))
def test_a_mistake_can_be_planted_at_one_place(number):
    path, old, new, tests = planted.PLANTED[number]
    assert (mutants.ROOT / path).read_text().count(old) == 1
    assert old != new
    assert all((mutants.ROOT / 'test' / name).exists() for name in tests.split())
