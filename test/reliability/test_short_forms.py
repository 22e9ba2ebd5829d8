"""A short form of each long test of this folder, with the seeds of the long ones."""

import pytest
from reliability import fuzz, interruptions, mutants, planted, soak


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


@pytest.fixture(scope='module')
def scene(tmp_path_factory):
    return interruptions.Scene(tmp_path_factory.mktemp('scene'), 24)


def test_a_full_disk_leaves_whole_files_and_says_so(scene):
    assert interruptions.full_disk(scene, 3) == []


def test_a_run_that_is_killed_leaves_whole_files(scene):
    assert interruptions.kills(scene, 4) == []


def test_a_cut_bag_is_read_as_far_as_it_goes(scene):
    assert interruptions.cuts(scene, 12) == []


@pytest.mark.parametrize('number', range(len(planted.PLANTED)))
def test_a_mistake_can_be_planted_at_one_place(number):
    path, old, new, tests = planted.PLANTED[number]
    assert (mutants.ROOT / path).read_text().count(old) == 1
    assert old != new
    assert all((mutants.ROOT / 'test' / name).exists() for name in tests.split())
