import json

import cv2
from mv_slapse.codec.encoding.recoder import Recoder
from mv_slapse.codec.packet import Packet, Picture
from mv_slapse.codec.source import open_source
from mv_slapse.errors import UnusableInput, UsageError
from mv_slapse.fields import camera_to_fields, header
from mv_slapse.storage.bag_writer import BagWriter
from mv_slapse.storage.camera_info import read_camera
from mv_slapse.tools import inputs
from mv_slapse.video_messages import COMPRESSED_IMAGE, FFMPEG_PACKET, IMAGE, packet_to_fields
import numpy as np
import pytest

PERIOD = 40_000_000


def pictures(n=6):
    scene = np.kron(np.random.default_rng(0).integers(0, 256, (16, 24)), np.ones((8, 8)))
    return [scene[:96, 3 * k:3 * k + 128].astype(np.uint8) for k in range(n)]


def test_a_file_is_opened_with_its_size(clip):
    with inputs.open_input(str(clip.video)) as video:
        stamps = sorted(packet.stamp for packet in video.packets)
    assert video.size == (480, 352)
    assert (len(stamps), stamps[0]) == (21, 0)


def test_pictures_are_coded_and_keep_their_stamps():
    items = [Picture(image, PERIOD * k) for k, image in enumerate(pictures())]
    packets = list(inputs.through(Recoder(), iter(items)))
    assert sorted(packet.stamp for packet in packets) == [PERIOD * k for k in range(6)]
    assert {packet.codec for packet in packets} == {'mpeg2video'}


def test_packets_pass_as_they_are():
    packets = [Packet(b'x', 0, True, 'h264'), Packet(b'y', 1, False, 'h264')]
    assert list(inputs.through(Recoder(), iter(packets))) == packets


def test_raw_pictures_come_out_of_a_bag(tmp_path):
    with BagWriter(tmp_path / 'bag') as bag:
        for k, image in enumerate(pictures()):
            bag.write('/image', IMAGE, {
                'header': header(PERIOD * k, 'eye'), 'height': 96, 'width': 128,
                'encoding': 'mono8', 'is_bigendian': 0, 'step': 128, 'data': image.ravel()},
                PERIOD * k)
    with inputs.open_input(str(tmp_path / 'bag')) as video:
        assert len(list(video.packets)) == 6
        assert (video.n_frames, video.camera, video.warning) == (6, None, '')


@pytest.fixture
def uncalibrated(clip, tmp_path):
    """Return the clip as a bag whose driver knows no calibration."""
    nothing = camera_to_fields(read_camera(clip.camera), 0, 'eye') | {
        'width': 0, 'height': 0, 'k': np.zeros(9), 'd': np.zeros(0)}
    with open_source(clip.video) as source, BagWriter(tmp_path / 'bag') as bag:
        bag.write('/camera_info', 'sensor_msgs/msg/CameraInfo', nothing, 0)
        for k, packet in enumerate(source.packets()):
            bag.write('/video', FFMPEG_PACKET, packet_to_fields(packet, (480, 352), k, 'eye'),
                      PERIOD * k)
    return tmp_path / 'bag'


def test_a_bag_that_is_not_calibrated_is_used_with_a_calibration(call, clip, uncalibrated):
    out = uncalibrated.parent / 'out'
    assert call('inspect', uncalibrated)[0] == 0
    assert call('run', uncalibrated, '--camera', clip.camera, '-o', out, '--quiet',
                '--no-report', '--max-frames', 9) == (0, '', '')
    code, _, err = call('run', uncalibrated, '-o', out)
    assert code == 3
    assert 'of topic /camera_info can be used; of the first: camera_info: the picture size' in err


def test_bad_messages_of_a_bag_end_no_run(call, clip, tmp_path):
    zero = {'x': 0.0, 'y': 0.0, 'z': 0.0}
    pose = {'pose': {'position': zero, 'orientation': {**zero, 'w': 1.0}},
            'covariance': np.zeros(36)}
    with BagWriter(tmp_path / 'bag') as bag:
        for k, image in enumerate(inputs.pictures(clip.video)):
            head, data = header(PERIOD * k, 'eye'), cv2.imencode('.jpg', image)[1]
            bag.write('/video', COMPRESSED_IMAGE, {
                'header': head, 'format': 'jpeg', 'data': data[:k % 10 and None]}, PERIOD * k)
            speed = {**zero, 'x': np.nan if k == 5 else 10.0}
            bag.write('/odom', 'nav_msgs/msg/Odometry', {
                'header': head, 'child_frame_id': 'base_link', 'pose': pose, 'twist': {
                    'twist': {'linear': speed, 'angular': zero}, 'covariance': np.zeros(36)}},
                PERIOD * k)
    code, out, err = call('run', tmp_path / 'bag', '--camera', clip.camera, '--speed', '/odom',
                          '-o', tmp_path / 'out', '--json', '--no-report')
    summary = json.loads(out)
    assert (code, err, summary['frames']) == (0, '', 18)
    recoded, odom = sorted(summary['warnings'], reverse=True)
    assert 'topic /video: 3 of its messages cannot be used' in recoded
    assert 'topic /odom: 1 of its messages cannot be used' in odom
    code, out, _ = call('inspect', tmp_path / 'bag', '--json')
    assert 'topic /video: 3 of its messages' in json.loads(out)['reasons'][-1]


def test_a_cut_bag_comes_with_a_warning(clip, tmp_path):
    with open_source(clip.video) as source, BagWriter(tmp_path / 'bag') as bag:
        for k, packet in enumerate(source.packets()):
            bag.write('/video', FFMPEG_PACKET, packet_to_fields(packet, (480, 352), k, 'eye'),
                      PERIOD * k)
            for filler in range(3):  # so that the bag has several chunks
                bag.write(f'/noise{filler}', 'std_msgs/msg/UInt8MultiArray', {
                    'layout': {'dim': [], 'data_offset': 0}, 'data': np.zeros(2**17)}, PERIOD * k)
    whole = (tmp_path / 'bag' / 'bag.mcap').read_bytes()
    (tmp_path / 'cut.mcap').write_bytes(whole[:len(whole) // 2])
    with inputs.open_input(str(tmp_path / 'cut.mcap'), '/video') as video:
        assert 3 < len(list(video.packets)) < 21
        assert 'has no end' in video.warning


def test_a_topic_is_for_bags_only(clip):
    with pytest.raises(UsageError, match='--topic /video names a topic, but .* is not a bag'):
        inputs.is_from_bag(str(clip.video), '/video')


def test_a_missing_input_is_refused(tmp_path):
    for name in ('a.mp4', 'a.mcap'):
        with pytest.raises(UnusableInput, match='no such'), inputs.open_input(
                str(tmp_path / name)):
            pass
