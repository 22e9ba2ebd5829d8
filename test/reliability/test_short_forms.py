"""A short form of each long test of this folder, with the seeds of the long ones."""

import pytest
from reliability import corpus, fuzz, interruptions, mutants, planted, soak


@pytest.mark.parametrize(('target', 'cases'), [
    ('streams', range(0, 1000, 67)), ('messages', range(0, 4000, 13)),
    ('bags', range(0, 600, 17)), ('files', range(0, 400, 7))])
def test_damaged_input_gives_values_or_own_errors(target, cases):
    found = fuzz.batch(target, cases, 0)
    assert not [item for item in found if 'took' not in item.text]


@pytest.mark.parametrize('path', sorted(corpus.FOLDER.iterdir()), ids=lambda path: path.stem)
def test_a_damaged_stream_that_was_kept_gives_values_or_own_errors(path):
    packets = corpus.read(path)
    assert packets
    fuzz.play(packets, (176, 144) if packets[0].codec == 'h263' else (192, 160))


@pytest.mark.parametrize('way', soak.WAYS)
def test_some_seconds_of_video_change_nothing_that_stays(way, data, ros_domain, tmp_path):
    if way == 'node':
        pytest.importorskip('ffmpeg_image_transport_msgs')
    found = soak.play(way, 0.3, tmp_path)
    assert found['threads and files constant']
    assert found['hours of video'] * 3600 >= 18


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
