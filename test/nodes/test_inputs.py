"""A real street as every type of topic: the pose of each picture, before the next but one.

MV_SLAPSE_PICTURES=200 pytest -s test/nodes/test_inputs.py    the whole street, with its figures
"""

from functools import cache
import os

import pytest

pytest.importorskip('rclpy')

import cv2  # noqa: E402
from mv_slapse.codec.source import open_source  # noqa: E402
from mv_slapse.evaluation.trajectory import evaluate, figures  # noqa: E402
from mv_slapse.fields import stamp_from_message  # noqa: E402
from mv_slapse.nodes.all_in_one import AllInOneNode  # noqa: E402
from mv_slapse.nodes.conversions import stamp_to_msg, to_message  # noqa: E402
from mv_slapse.storage.tum import read_trajectory, Trajectory  # noqa: E402
from mv_slapse.tools.inputs import pictures  # noqa: E402
from mv_slapse.video_messages import in_band, packet_to_fields  # noqa: E402
from nav_msgs.msg import Odometry  # noqa: E402
import numpy as np  # noqa: E402
import other_codecs  # noqa: E402
from sensor_msgs.msg import CompressedImage, Image  # noqa: E402

N = int(os.environ.get('MV_SLAPSE_PICTURES', '60'))
PERIOD, START = 100_000_000, 1_700_000_000_000_000_000
# The truth of the first 1.5 s has a constant speed, while the pictures show the car gather it.
WRONG = 15 if N < 200 else 0
NO_B = {'x265-params': 'log-level=none:bframes=0', 'crf': '18'}


@cache
def street(folder) -> list:
    """Return the first pictures, (376, 1240) uint8, in even size."""
    with_all = pictures(folder / 'mpeg2.mpg')
    return [image[:376, :1240] for image, _ in zip(with_all, range(N), strict=False)]


def packets_of(folder) -> list:
    with open_source(folder / 'h264_lowlatency.mp4') as source:
        return [packet for packet, _ in zip(source.packets(), range(N), strict=False)]


def raw(encoding, rows):
    def messages(folder):
        for image in street(folder):
            stored = rows(image)
            yield Image(encoding=encoding, height=image.shape[0], width=image.shape[1],
                        step=stored.shape[1] * (stored.shape[2] if stored.ndim > 2 else 1),
                        data=stored.tobytes())

    return messages


def nv12(image):
    return np.vstack([image, np.full((len(image) // 2, image.shape[1]), 128, np.uint8)])


def jpeg(folder):
    for image in street(folder):
        yield CompressedImage(format='jpeg', data=cv2.imencode(
            '.jpg', image, [cv2.IMWRITE_JPEG_QUALITY, 90])[1].tobytes())


def ffmpeg(folder):
    from ffmpeg_image_transport_msgs.msg import FFMPEGPacket
    for i, packet in enumerate(packets_of(folder)):
        yield to_message(FFMPEGPacket, packet_to_fields(packet, (1240, 376), i, 'cam'))


def foxglove(name):
    def messages(folder):
        from foxglove_msgs.msg import CompressedVideo
        coded = (packets_of(folder) if name == 'h264'
                 else other_codecs.coded(street(folder), 'hevc', **NO_B))
        for packet in coded:
            yield CompressedVideo(format=name, data=in_band(packet))

    return messages


def compressed_h264(folder):
    for packet in packets_of(folder):
        yield CompressedImage(format='h264', data=in_band(packet))


INPUTS = {'ffmpeg': ffmpeg, 'foxglove h264': foxglove('h264'), 'foxglove h265': foxglove('h265'),
          'compressed h264': compressed_h264, 'jpeg': jpeg, 'mono8': raw('mono8', lambda y: y),
          'bgr8': raw('bgr8', lambda y: cv2.cvtColor(y, cv2.COLOR_GRAY2BGR)),
          'nv12': raw('nv12', nv12), 'bayer': raw('bayer_rggb8', lambda y: y)}


def stamped(msg, stamp):
    if hasattr(msg, 'timestamp'):
        msg.timestamp, msg.frame_id = stamp_to_msg(stamp), 'cam'
    else:
        msg.header.stamp, msg.header.frame_id = stamp_to_msg(stamp), 'cam'
    return msg


def estimated(received) -> Trajectory:
    """Return odometry with stamps from zero, x forward as in odom."""
    p = [msg.pose.pose.position for msg in received]
    q = [msg.pose.pose.orientation for msg in received]
    return Trajectory(
        np.array([stamp_from_message(msg.header.stamp) - START for msg in received]),
        np.array([[v.x, v.y, v.z] for v in p]), np.array([[v.x, v.y, v.z, v.w] for v in q]))


@pytest.mark.parametrize('name', INPUTS)
def test_every_picture_of_a_street_gets_its_pose_in_time(bench, data, name):
    folder = data / 'kitti00'
    messages = list(INPUTS[name](folder))
    received = bench.listen(Odometry, 'odometry')
    bench.start(AllInOneNode, camera_info_url=str(folder / 'camera.yaml'), tf_wait=0.0,
                scene__camera_height=1.65)
    publisher = bench.advertise(type(messages[0]), 'video')
    stamps = [START + PERIOD * i for i in range(N)]
    late = 0
    for i, msg in enumerate(messages):
        publisher.publish(stamped(msg, stamps[i]))
        bench.spin(lambda i=i: i < 2 or received and stamp_from_message(
            received[-1].header.stamp) >= stamps[i - 1], 0.5 if i > 3 else 0.1)
        late += i > 3 and stamp_from_message(received[-1].header.stamp) < stamps[i - 1]
    assert len(received) >= 0.9 * N
    path = estimated(received[WRONG:])
    found = figures(evaluate(path, read_trajectory(folder / 'ground_truth.tum')))
    print(f'{name}: error {found["ate_mean_percent"]:.3f} %, {len(received)} poses of {N} '
          f'pictures, {late} later than one picture')
    assert found['ate_mean_percent'] < 0.5
    assert late <= 0.05 * N
