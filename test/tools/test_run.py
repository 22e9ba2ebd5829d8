from dataclasses import replace
import json

import av
import cv2
from mv_slapse.codec.encoding.encoder import Encoding, write_video
from mv_slapse.config import Settings
from mv_slapse.errors import UnusableInput, UsageError
from mv_slapse.geometry.camera import Camera
from mv_slapse.storage.bag_reader import BagReader
from mv_slapse.storage.camera_info import read_camera, write_camera
from mv_slapse.storage.tum import read_trajectory
from mv_slapse.tools import run as tool
from mv_slapse.tools.bag import make_bag
from mv_slapse.tools.inputs import pictures
from mv_slapse.tools.run import CpuClock
from mv_slapse.tools.run_summary import lost_message, Summary
import numpy as np
from pictures import sliding
import pytest

N_FRAMES = 21


@pytest.fixture(scope='module')
def summary(clip):
    return json.loads((clip.out / 'summary.json').read_text())


def test_the_summary_tells_what_was_done(clip, summary):
    assert (summary['frames'], summary['input']) == (N_FRAMES, str(clip.video))
    assert summary['poses'] == len(read_trajectory(clip.out / 'trajectory.tum'))
    assert summary['poses'] <= summary['key_frames'] <= N_FRAMES
    assert summary['fps'] == pytest.approx(15)
    assert summary['settings']['scene']['camera_height'] == 1.65
    assert summary['scale_status'] in ('metric', 'unknown')
    assert summary['scale_source']
    assert sum(summary['statuses'].values()) == summary['key_frames'] - 1
    assert {'python', 'av', 'numpy'} <= set(summary['versions'])


def test_each_stage_has_its_share_of_cpu(summary):
    seconds = dict(summary['cpu_seconds'])
    assert seconds.pop('total') == pytest.approx(sum(seconds.values()))
    assert set(seconds) == {'decode', 'extract', 'filter', 'obstacles', 'write'}
    assert all(value > 0 for value in seconds.values())


def test_a_run_stops_where_it_is_told(clip, tmp_path):
    seen = []
    summary = tool.run(clip.video, read_camera(clip.camera), Settings(), tmp_path,
                       tool.Options(max_frames=5),
                       progress=lambda done, total: seen.append((done, total)))
    assert summary.frames == 5
    assert [done for done, _ in seen] == [1, 2, 3, 4, 5]


def test_the_rate_is_right_where_the_last_pictures_are_missing(clip, tmp_path):
    # the packets of a B frame's two neighbours come before it
    summary = tool.run(clip.video, read_camera(clip.camera), Settings(), tmp_path,
                       tool.Options(max_frames=6))
    assert summary.fps == pytest.approx(15)


def test_two_runs_write_the_same_files(clip, tmp_path):
    for name in ('a', 'b'):
        tool.run(clip.video, read_camera(clip.camera), Settings(), tmp_path / name,
                 tool.Options(max_frames=9))
    for name in ('trajectory.tum', 'planes.csv', 'obstacles.csv', 'labels.npz', 'map.json',
                 'results.mcap'):
        assert (tmp_path / 'a' / name).read_bytes() == (tmp_path / 'b' / name).read_bytes(), name


def test_an_interrupted_run_keeps_what_it_has(clip, tmp_path):
    def interrupt(done, _):
        if done == 12:
            raise KeyboardInterrupt

    summary = tool.run(clip.video, read_camera(clip.camera), Settings(), tmp_path,
                       progress=interrupt)
    assert summary.interrupted
    assert json.loads((tmp_path / 'summary.json').read_text())['interrupted']
    assert len(read_trajectory(tmp_path / 'trajectory.tum')) > 2
    assert (tmp_path / 'results.mcap').exists()


def test_an_interrupted_run_keeps_what_waited_for_a_known_map(clip, tmp_path):
    def interrupt(done, _):
        if done == 12:
            raise KeyboardInterrupt

    tool.run(clip.video, read_camera(clip.camera), Settings(), tmp_path,
             tool.Options(known_map=clip.out / 'map.json'), interrupt)
    assert len(read_trajectory(tmp_path / 'trajectory.tum')) > 2


@pytest.mark.parametrize('given', ['results.mcap', '.'])
def test_a_run_does_not_take_the_place_of_its_input(clip, tmp_path, given):
    tool.run(clip.video, read_camera(clip.camera), Settings(), tmp_path,
             tool.Options(max_frames=6, with_packets=True))
    before = (tmp_path / 'results.mcap').read_bytes()
    with pytest.raises(UsageError, match='would be lost; choose another output folder'):
        tool.run(tmp_path / given, None, Settings(), tmp_path)
    with pytest.raises(UsageError, match='would be lost'):
        tool.run(clip.video, read_camera(clip.camera), Settings(), tmp_path,
                 tool.Options(known_map=tmp_path / 'map.json'))
    assert (tmp_path / 'results.mcap').read_bytes() == before


def test_a_report_of_an_earlier_run_goes_with_it(clip, tmp_path):
    (tmp_path / 'report.html').write_text('of another run')
    tool.run(clip.video, read_camera(clip.camera), Settings(), tmp_path,
             tool.Options(max_frames=6))
    assert not (tmp_path / 'report.html').exists()


def test_results_end_where_the_pictures_change_their_size(rng, tmp_path):
    parts = []
    for size in ((320, 240), (160, 120)):
        parts.append(tmp_path / f'{size[0]}.mpg')
        images = sliding(rng, 24, (3, 1), size)
        write_video(parts[-1], images, 25, Encoding('mpeg2video', b_frames=0, gop=12))
    whole = tmp_path / 'both.mpg'
    whole.write_bytes(b''.join(part.read_bytes() for part in parts))
    K = np.array([[300.0, 0, 159.5], [0, 300, 119.5], [0, 0, 1]])
    with pytest.raises(UnusableInput, match='160x120 from .* cut the video there'):
        tool.run(whole, Camera(320, 240, K), Settings(), tmp_path / 'out')
    summary = json.loads((tmp_path / 'out' / 'summary.json').read_text())
    assert 'the results end there' in summary['warnings'][-1]
    assert 2 < summary['key_frames'] <= 24


def test_a_video_without_vectors_is_refused(rng, tmp_path):
    pictures = rng.integers(0, 256, (6, 96, 128), np.uint8)
    write_video(tmp_path / 'intra.mpg', pictures, 25.0, Encoding(b_frames=0, gop=1))
    camera_file = tmp_path / 'camera.yaml'
    camera_file.write_text('image_width: 128\nimage_height: 96\n'
                           'camera_matrix: [100, 0, 64, 0, 100, 48, 0, 0, 1]\n')
    with pytest.raises(UnusableInput, match='none of 5 key frame pairs has motion vectors'):
        tool.run(tmp_path / 'intra.mpg', read_camera(camera_file), Settings(), tmp_path / 'out')


def test_pictures_without_stamps_are_not_to_be_encoded_again(clip, tmp_path):
    images = list(pictures(clip.video))[:4]
    for i, image in enumerate(images):
        cv2.imwrite(str(tmp_path / f'{i}.png'), image)
    (tmp_path / 'times.txt').write_text('0.0\n' * 4)
    with pytest.raises(UnusableInput, match='none of 3 key frame pairs can be used: time stamps '
                                            'do not increase; what publishes') as refusal:
        tool.run(tmp_path, read_camera(clip.camera), Settings(), tmp_path / 'out')
    assert 're-encode' not in str(refusal.value)


def test_a_video_needs_a_calibration(clip, tmp_path):
    with pytest.raises(UsageError, match='--camera camera.yaml'):
        tool.run(clip.video, None, Settings(), tmp_path)


@pytest.mark.parametrize(('poses', 'lost'), [(4, True), (5, False), (10, False)])
def test_a_run_is_lost_where_most_key_frames_have_no_pose(poses, lost):
    assert Summary('a.mp4', key_frames=10, poses=poses).is_lost is lost


def test_a_lost_run_says_why():
    summary = Summary('a.mp4', key_frames=10, reasons={'too few vectors': 7, 'no plane': 1})
    assert '0 of 10 key frames have a pose (most often: too few vectors)' in (
        lost_message(summary))


def test_the_clock_charges_time_to_the_stage_that_took_it():
    clock = CpuClock()
    assert clock.charge(lambda n: sum(range(n)), 'filter')(300_000) > 0
    assert clock.seconds['filter'] > 0
    assert clock.seconds['decode'] == 0


@pytest.fixture
def odd(clip, tmp_path):
    """Return a folder of pictures of odd size, and its camera."""
    for i, image in enumerate(pictures(clip.video)):
        cv2.imwrite(str(tmp_path / f'{i:03d}.png'), image[:351, :479])
    write_camera(tmp_path / 'camera.yaml',
                 replace(read_camera(clip.camera), width=479, height=351))
    return tmp_path, tmp_path / 'camera.yaml'


def test_pictures_of_odd_size_are_run_without_their_last_column_and_row(odd, tmp_path, call):
    code, out, err = call('run', odd[0], '--camera', odd[1], '--set', 'encoder.rate=15',
                          '--packets', '-o', tmp_path / 'a', '--json', '--no-report')
    summary = json.loads(out)
    assert (code, err, summary['poses']) == (0, '', N_FRAMES)
    assert (summary['camera']['width'], summary['camera']['height']) == (478, 350)
    assert summary['camera']['K'] == read_camera(odd[1]).K.tolist()
    bag = tmp_path / 'a' / 'results.mcap'
    assert BagReader(bag).camera('/video').width == 478
    for camera in ([], ['--camera', odd[1]]):
        assert call('run', bag, *camera, '-o', tmp_path / 'b', '--quiet', '--no-report') == (
            0, '', '')


def test_an_odd_file_that_is_encoded_again_is_run(odd, tmp_path):
    images = [cv2.imread(str(path), cv2.IMREAD_GRAYSCALE) for path in sorted(odd[0].glob('*.png'))]
    with av.open(str(tmp_path / 'odd.avi'), 'w') as container:
        stream = container.add_stream('mjpeg', rate=15)
        stream.width, stream.height, stream.pix_fmt = 479, 351, 'yuvj420p'
        for frame in (*(av.VideoFrame.from_ndarray(image, 'gray') for image in images), None):
            container.mux(stream.encode(frame))
    summary = tool.run(tmp_path / 'odd.avi', read_camera(odd[1]), Settings(), tmp_path / 'out')
    assert summary.poses == N_FRAMES
    make_bag(str(tmp_path / 'odd.avi'), read_camera(odd[1]), None, tmp_path / 'bag')
    assert BagReader(tmp_path / 'bag').camera('/camera/image/ffmpeg').width == 478
    assert tool.run(tmp_path / 'bag', None, Settings(), tmp_path / 'out').poses == N_FRAMES


def test_results_with_packets_are_a_bag_that_gives_the_same_again(clip, tmp_path, call):
    assert call('run', clip.video, '--camera', clip.camera, '--camera-height', 1.65, '--packets',
                '-o', tmp_path / 'a', '--quiet', '--no-report')[0] == 0
    assert call('run', tmp_path / 'a' / 'results.mcap', '--camera-height', 1.65,
                '-o', tmp_path / 'b', '--quiet', '--no-report')[0] == 0
    for name in ('trajectory.tum', 'planes.csv', 'obstacles.csv'):
        assert (tmp_path / 'a' / name).read_bytes() == (tmp_path / 'b' / name).read_bytes()
    messages = list(BagReader(tmp_path / 'a' / 'results.mcap').messages(['/diagnostics']))
    assert 1 <= len(messages) <= 3
    assert messages[-1][1].status[0].name == 'mv_slapse'
