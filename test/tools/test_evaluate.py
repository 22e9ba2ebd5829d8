"""The table of ``make evaluate``, on one short rendered street."""

import csv
from dataclasses import replace
from functools import partial
from types import SimpleNamespace

from mv_slapse.codec.encoding.encoder import LOW_LATENCY, write_video
from mv_slapse.codec.frames import FrameDecoder
from mv_slapse.codec.source import open_source
from mv_slapse.geometry.camera import Camera
from mv_slapse.simulation.flight import FISHEYE
from mv_slapse.storage.camera_info import write_camera
from mv_slapse.storage.tum import read_trajectory, write_poses
from mv_slapse.tools import cases, evaluate
from mv_slapse.tools.inputs import pictures
import numpy as np
import pytest

CAMERA = Camera(256, 192, np.array([[200.0, 0, 127.5], [0, 200.0, 95.5], [0, 0, 1]]))


def test_a_street_gives_a_row_for_each_encoding_with_its_errors(tmp_path):
    output = tmp_path / 'results.md'
    code = evaluate.main(['--data', str(tmp_path / 'none'), '--streets', '1', '--frames', '24',
                          '--only', 'street', '-o', str(output), '--jobs', '1',
                          '--cache', str(tmp_path / 'cache')])
    rows = list(csv.DictReader(output.with_suffix('.csv').open()))
    assert code == 0
    kinds = {'street': cases.ENCODINGS, 'several references, street': cases.REFERENCES}
    assert [row['sequence'].split('/')[0] for row in rows] == [
        f'{kind} 0' for kind, encodings in kinds.items() for _ in encodings]
    for row in rows:
        assert int(row['n_poses']) > 3
        assert 0 < float(row['ate_mean_percent']) < 5
    for kind, encodings in kinds.items():
        assert f'| {kind} | {len(encodings)} | ' in output.read_text()


def test_an_encoding_alone_is_rendered_for_each_kind_of_street(tmp_path):
    scenes = cases.streets(1, 4)
    assert [scene.name for scene in scenes] == [f'{kind} 0' for kind in cases.TRAFFIC]
    case, = scenes[0].make(tmp_path, 'mpeg2')
    assert (case.name, case.video.exists()) == ('street 0/mpeg2.mpg', True)
    assert not list(scenes[1].make(tmp_path, 'street'))


def test_vectors_of_videos_with_several_references_may_mean_several_pictures(tmp_path):
    for case in cases.references(1, 8)[0].make(tmp_path, ''):
        decoder = FrameDecoder(with_luma=False)
        with open_source(case.video) as source:
            frames = [frame for packet in source.packets() for frame in decoder.feed(packet)]
        assert max(frame.references for frame in frames) >= 3


def test_what_is_rendered_is_not_rendered_again(tmp_path, monkeypatch):
    scene = cases.streets(1, 4)[0]
    case, = scene.make(tmp_path, 'mpeg2')
    case.video.write_bytes(b'kept')
    monkeypatch.setattr(cases, 'film', None)
    assert next(scene.make(tmp_path, 'mpeg2')).video.read_bytes() == b'kept'


def test_scenes_of_other_content_differ(tmp_path):
    short, long = cases.streets(1, 4)[0], cases.streets(1, 5)[0]
    assert short.content == cases.streets(1, 4)[0].content != long.content


@pytest.mark.parametrize('rendered', [
    partial(cases.streets, 2, 4), partial(cases.references, 2, 4), cases.drives,
    partial(cases.hazards, 1), cases.flights])
def test_another_first_seed_gives_other_scenes_of_the_same_kinds(rendered):
    usual, other = rendered(first=0), rendered(first=100)
    assert [scene.content for scene in usual] == [scene.content for scene in rendered()]
    assert not {scene.content for scene in usual} & {scene.content for scene in other}

    def kinds(scenes):
        return [scene.name.rstrip('0123456789') for scene in scenes]

    assert kinds(usual) == kinds(other)


def test_noise_changes_the_pictures_and_not_the_truth(tmp_path):
    street = cases.streets(1, 4)[0]
    again, = cases.grainy(tmp_path, [street])
    (tmp_path / 'again').mkdir()
    plain, = street.make(tmp_path, 'mpeg2')
    noisy, = again.make(tmp_path / 'again', 'mpeg2')
    assert noisy.name == 'street 0, noise/mpeg2.mpg'
    poses = [read_trajectory(case.ground_truth / 'ground_truth.tum').positions
             for case in (plain, noisy)]
    np.testing.assert_array_equal(*poses)
    given, seen = (next(pictures(case.video)).astype(int) for case in (plain, noisy))
    assert 0.3 < np.std(given - seen) < 3


def test_a_refusal_is_a_row_that_says_why():
    line = evaluate.row('clip', {'error': 'not a video'})
    assert line.startswith('| clip | not a video |')
    assert line.count('|') == len(evaluate.COLUMNS) + 2


def test_a_flight_comes_with_its_poses_and_the_lens(tmp_path, monkeypatch):
    lens, settings = cases.FLIGHTS['flight, fisheye']
    monkeypatch.setitem(cases.FLIGHTS, 'flight, fisheye', (lens, replace(settings, n_frames=3)))
    case, = (case for scene in cases.flights() for case in scene.make(tmp_path, 'fisheye/mpeg2'))
    assert case.camera is FISHEYE
    assert len(read_trajectory(case.ground_truth / 'ground_truth.tum')) == 3
    assert len(list(pictures(case.video))) == 3


def made(scenes, folder):
    return [case for scene in scenes for case in scene.make(folder, '')]


@pytest.fixture
def data(tmp_path):
    """Return a folder like that of the sequences, with 40 pictures of noise at 10 Hz."""
    folder = tmp_path / 'data' / 'kitti00'
    folder.mkdir(parents=True)
    images = np.random.default_rng(0).integers(0, 256, (40, 192, 256), np.uint8)
    write_video(folder / 'h264_lowlatency.mp4', images, 10.0, LOW_LATENCY)
    write_camera(folder / 'camera.yaml', CAMERA)
    write_poses(folder / 'ground_truth.tum', [
        (i * 10**8, np.eye(3), np.array([0.0, 0.0, 0.5 * i])) for i in range(40)])
    return folder.parent


def test_clips_with_known_movers_come_altered_too(data, tmp_path):
    folder = (data / 'kitti00').rename(data / 'clip')
    (folder / 'boxes.csv').write_text('frame,x,y,width,height\n1,10,10,20,20\n')
    options = SimpleNamespace(data=data, streets=0, frames=0, hazards=0, first_seed=0)
    names = [case.name for scene in evaluate.all_scenes(options)
             for case in scene.make(tmp_path, 'clip, cut/mpeg2')]
    assert names == ['clip, cut/mpeg2.mp4']


def test_a_sequence_is_encoded_anew_with_fewer_bits_and_with_fewer_pictures(data, tmp_path):
    sizes = {}
    for case in made(cases.recoded(data), tmp_path):
        with open_source(case.video) as source:
            packets = list(source.packets())
        assert len(packets) == (20 if '5 Hz' in case.name else 40)
        assert max(packet.stamp for packet in packets) == pytest.approx(3.9e9, abs=1.01e8)
        assert case.height == 1.65
        sizes[case.name] = np.mean([len(packet.data) for packet in packets])
    low, slow = np.reshape(list(sizes.values()), (2, 3))
    assert np.all(low < 0.7 * slow)


def test_lost_packets_leave_a_gap_in_the_stamps(data, tmp_path, monkeypatch):
    monkeypatch.setattr(cases, 'LOST', range(10, 30))
    metric, told, free = made(cases.lossy(data), tmp_path)
    assert told.speeds
    assert (metric.height, free.height) == (1.65, 0.0)
    with open_source(metric.video) as source:
        stamps = [packet.stamp for packet in source.packets()]
    expected = [*range(10), *range(30, 40)]
    np.testing.assert_allclose(stamps, 1e8 * np.array(expected), atol=1e3)


def test_some_rows_come_again_without_a_height_and_with_a_speed_in_its_place(tmp_path):
    poses = [(i * 10**8, np.eye(3), np.array([0.0, 0.0, 0.5 * i])) for i in range(5)]
    write_poses(tmp_path / 'truth.tum', poses)
    given = [cases.Case(name, tmp_path, CAMERA, 1.65, tmp_path / 'truth.tum')
             for name in ('kitti00/a.mp4', 'parking/a.mp4')]
    first, free, told, last = cases.otherwise_scaled(given)
    assert [first, last] == given
    assert (free.name, free.height, free.speeds) == ('free scale, kitti00/a.mp4', 0.0, ())
    assert (told.name, told.height) == ('speed given, kitti00/a.mp4', 0.0)
    np.testing.assert_allclose([speed.value for speed in told.speeds], 5.0, rtol=0.05)
    assert [speed.stamp for speed in told.speeds] == [stamp for stamp, _, _ in poses]


def test_a_video_without_a_calibration_gets_a_guessed_one(tmp_path):
    folder = tmp_path / 'original_codec'
    folder.mkdir()
    write_video(folder / 'a.mp4', np.zeros((3, 96, 128), np.uint8), 10.0, LOW_LATENCY)
    case, = made(cases.cameraless(tmp_path), tmp_path)
    np.testing.assert_allclose(case.camera.K[:2], [[102.4, 0, 63.5], [0, 102.4, 47.5]])
    assert case.ground_truth is None
