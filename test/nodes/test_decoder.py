import time

import pytest

pytest.importorskip('rclpy')
pytest.importorskip('mv_slapse_msgs')

import cv2  # noqa: E402
from mv_slapse import fields  # noqa: E402
from mv_slapse.codec.decoder import CorrespondenceDecoder  # noqa: E402
from mv_slapse.codec.encoding.encoder import write_video  # noqa: E402
from mv_slapse.codec.encoding.recoder import Recoder  # noqa: E402
from mv_slapse.codec.packet import Picture  # noqa: E402
from mv_slapse.config import DecoderSettings  # noqa: E402
from mv_slapse.nodes.conversions import stamp_to_msg, to_message  # noqa: E402
from mv_slapse.nodes.decoder import DecoderNode  # noqa: E402
from mv_slapse.nodes.plane_extraction import PlaneExtractionNode  # noqa: E402
from mv_slapse.storage.camera_info import write_camera  # noqa: E402
from mv_slapse.video_messages import packet_to_fields  # noqa: E402
from mv_slapse_msgs.msg import Correspondences, PlaneObservations  # noqa: E402
from nodes import clips  # noqa: E402
from nodes.bench import BEST_EFFORT, held_up, LATCHED, messages_of, value_of  # noqa: E402
import numpy as np  # noqa: E402
import other_codecs  # noqa: E402
from sensor_msgs.msg import CameraInfo, CompressedImage, Image  # noqa: E402
from std_msgs.msg import String  # noqa: E402
from std_srvs.srv import SetBool, Trigger  # noqa: E402

START = 5_000_000_000


def expected_records(packets):
    camera = fields.camera_from_message(clips.camera_info())
    decoder = CorrespondenceDecoder(DecoderSettings(), camera)
    recoder = Recoder()
    return [record for item in packets for packet in recoder.feed(item)
            for record in decoder.feed(packet)]


def assert_arrived(received, expected):
    assert [fields.stamp_from_message(m.header.stamp) for m in received] == [
        r.stamp for r in expected]
    for msg, record in zip(received, expected, strict=True):
        back = fields.correspondences_from_message(msg)
        assert back.kind == record.kind
        np.testing.assert_array_equal(back.x_cur, record.x_cur)
        np.testing.assert_array_equal(back.x_prev, record.x_prev)


def publish_camera(bench, info=None):
    publisher = bench.peer.create_publisher(CameraInfo, 'camera_info', LATCHED)
    publisher.publish(info or clips.camera_info())
    return publisher


def ffmpeg_messages(packets):
    module = pytest.importorskip('ffmpeg_image_transport_msgs.msg')
    return module.FFMPEGPacket, [to_message(module.FFMPEGPacket, packet_to_fields(
        packet, clips.SIZE, i, 'cam_optical')) for i, packet in enumerate(packets)]


def compressed_video(packets):
    module = pytest.importorskip('foxglove_msgs.msg')
    # the format is wrong on purpose, as it sometimes is: the bitstream tells
    return module.CompressedVideo, [module.CompressedVideo(
        timestamp=stamp_to_msg(p.stamp), frame_id='cam_optical', data=p.data, format='h265')
        for p in packets]


def compressed_image(packets):
    messages = [CompressedImage(data=p.data, format='h264') for p in packets]
    for msg, packet in zip(messages, packets, strict=True):
        msg.header.stamp, msg.header.frame_id = stamp_to_msg(packet.stamp), 'cam_optical'
    return CompressedImage, messages


@pytest.mark.parametrize(('codec', 'kind'), [
    ('mpeg2video', ffmpeg_messages), ('h264', ffmpeg_messages), ('h264', compressed_video),
    ('h264', compressed_image)])
def test_encoded_video_gives_the_records_of_the_decoder(bench, codec, kind):
    packets = clips.packets(codec, START)
    message_type, messages = kind(packets)
    received = bench.listen(Correspondences, 'correspondences')
    bench.start(DecoderNode)
    publish_camera(bench)
    publisher = bench.advertise(message_type, 'video')
    for msg in messages:
        publisher.publish(msg)
    expected = expected_records(packets)
    assert len(expected) >= 2
    assert bench.spin(lambda: len(received) >= len(expected))
    assert_arrived(received, expected)
    assert received[0].header.frame_id == 'cam_optical'


def raw(picture):
    return Image(height=picture.shape[0], width=picture.shape[1], encoding='mono8',
                 step=picture.shape[1], data=picture.tobytes())


def png(picture):
    return CompressedImage(format='png', data=cv2.imencode('.png', picture)[1].tobytes())


@pytest.mark.parametrize(('message_type', 'make'), [(Image, raw), (CompressedImage, png)])
def test_pictures_are_coded_here_and_their_vectors_read(bench, message_type, make):
    received = bench.listen(Correspondences, 'correspondences')
    bench.start(DecoderNode)
    publish_camera(bench)
    publisher = bench.advertise(message_type, 'video', BEST_EFFORT)
    encoder, packets = Recoder(), []
    for i, picture in enumerate(clips.pictures()):
        msg = make(picture)
        msg.header.stamp = stamp_to_msg(START + i * 100_000_000)
        publisher.publish(msg)
        bench.spin(lambda: False, 0.02)
        shown = picture if make is raw else cv2.cvtColor(picture, cv2.COLOR_GRAY2BGR)
        packets += encoder.feed(Picture(shown, START + i * 100_000_000))
    expected = expected_records(packets)
    assert len(expected) >= 2
    assert bench.spin(lambda: len(received) >= len(expected))
    assert_arrived(received, expected)
    moved = np.median(fields.correspondences_from_message(received[0]).x_prev
                      - fields.correspondences_from_message(received[0]).x_cur, axis=0)
    pairs = (expected[0].stamp - expected[0].previous_stamp) / 1e8
    assert moved == pytest.approx([3.0 * pairs, 0.0], abs=0.3)


def test_of_odd_pictures_the_last_column_and_row_are_left_out(bench):
    received = bench.listen(PlaneObservations, 'planes/observations')
    decoder, extraction = bench.start(DecoderNode), bench.start(PlaneExtractionNode)
    info = clips.camera_info()
    info.width, info.height = 191, 127
    publish_camera(bench, info)
    publisher = bench.advertise(Image, 'video')
    for i, picture in enumerate(clips.pictures()):
        msg = raw(np.ascontiguousarray(picture[:127, :191]))
        msg.header.stamp = stamp_to_msg(START + i * 100_000_000)
        publisher.publish(msg)
    assert bench.spin(lambda: len(received) > 1)
    assert (received[0].width, received[0].height) == (190, 126)
    assert 'calibrated at' not in messages_of(decoder) + messages_of(extraction)


def test_packets_wait_for_a_late_camera_info(bench):
    message_type, messages = ffmpeg_messages(clips.packets('h264', START))
    received = bench.listen(Correspondences, 'correspondences')
    node = bench.start(DecoderNode)
    publisher = bench.advertise(message_type, 'video')
    for msg in messages:
        publisher.publish(msg)
    bench.spin(lambda: False, 0.5)
    assert received == []
    assert 'no camera_info yet' in messages_of(node)
    bench.peer.create_publisher(CameraInfo, 'camera_info', LATCHED).publish(clips.camera_info())
    expected = expected_records(clips.packets('h264', START))
    assert bench.spin(lambda: len(received) >= len(expected))
    assert_arrived(received, expected)


def test_packets_that_have_waited_too_long_are_dropped_up_to_a_key_picture(bench):
    packets = clips.packets('mpeg2video', START)
    message_type, messages = ffmpeg_messages(packets)
    received = bench.listen(Correspondences, 'correspondences')
    node = bench.start(DecoderNode, max_latency=60.0)
    publish_camera(bench)
    publisher = bench.advertise(message_type, 'video')
    key = [packet.is_key for packet in packets].index(True, 1)
    early = len(expected_records(packets[:6]))
    assert early
    for msg in messages[:6]:
        publisher.publish(msg)
    assert bench.spin(lambda: len(received) == early)
    held_up(node, 100.0)
    for msg in messages[6:key]:
        publisher.publish(msg)
    assert bench.spin(lambda: 's behind: fed faster than it can work' in messages_of(node))
    bench.spin(lambda: False, 0.2)
    assert len(received) == early
    held_up(node, 0.0)
    for msg in messages[key:]:
        publisher.publish(msg)
    later = expected_records(packets[key:])
    assert bench.spin(lambda: len(received) == early + 1 + len(later))
    gap = received[early]
    assert (gap.kind, gap.reason) == (Correspondences.BROKEN, 'overload')
    assert gap.previous_stamp == received[early - 1].header.stamp
    assert gap.header.stamp == received[early + 1].previous_stamp
    assert_arrived(received[early + 1:], later)
    assert value_of(node, 'packets dropped by overload') == str(key - 6)


def test_silence_is_reported_with_the_topic_and_what_to_do(bench):
    node = bench.start(DecoderNode)
    said = messages_of(node)
    assert '/video has no publisher' in said or 'no camera_info yet' in said
    publish_camera(bench)
    assert bench.spin(lambda: 'camera_info' not in messages_of(node))
    assert 'remap video' in messages_of(node)


def test_a_camera_info_latched_long_before_is_found(bench):
    publish_camera(bench)
    bench.spin(lambda: False, 0.3)
    node = bench.start(DecoderNode)
    assert bench.spin(lambda: 'camera_info' not in messages_of(node))


def test_an_uncalibrated_camera_is_an_error_that_says_so(bench):
    node = bench.start(DecoderNode)
    publish_camera(bench, clips.camera_info(0.0))
    assert bench.spin(lambda: 'not calibrated' in messages_of(node))
    assert node.health.status().level == b'\x02'


def test_a_camera_of_another_size_is_an_error_that_names_both(bench):
    message_type, messages = ffmpeg_messages(clips.packets('h264', START))
    node = bench.start(DecoderNode)
    info = clips.camera_info()
    info.width, info.height = 640, 480
    publish_camera(bench, info)
    publisher = bench.advertise(message_type, 'video')
    for msg in messages:
        publisher.publish(msg)
    assert bench.spin(lambda: '192x128' in messages_of(node) and '640x480' in messages_of(node))


def test_a_best_effort_publisher_is_matched_by_itself(bench):
    message_type, messages = ffmpeg_messages(clips.packets('h264', START))
    received = bench.listen(Correspondences, 'correspondences')
    bench.start(DecoderNode, input_type='ffmpeg')
    publish_camera(bench)
    publisher = bench.advertise(message_type, 'video', BEST_EFFORT)
    for msg in messages:
        publisher.publish(msg)
    assert bench.spin(lambda: len(received) > 1)


def test_a_clash_of_qos_names_topic_settings_and_cure(bench):
    message_type, _ = ffmpeg_messages([])
    node = bench.start(DecoderNode, input_type='ffmpeg', qos_reliability='reliable')
    bench.peer.create_publisher(message_type, 'video', BEST_EFFORT)
    assert bench.spin(lambda: 'best effort' in messages_of(node))
    said = messages_of(node)
    assert '/video' in said
    assert 'subscribed reliable' in said
    assert 'set qos_reliability to best_effort' in said


def test_a_topic_of_another_type_is_an_error_that_names_the_usable_ones(bench):
    node = bench.start(DecoderNode)
    bench.peer.create_publisher(String, 'video', 10)
    assert bench.spin(lambda: 'std_msgs/msg/String' in messages_of(node))
    assert 'FFMPEGPacket' in messages_of(node)


def test_a_codec_that_ffmpeg_does_not_know_is_an_error_that_names_the_cure(bench):
    module = pytest.importorskip('foxglove_msgs.msg')
    node = bench.start(DecoderNode)
    publish_camera(bench)
    publisher = bench.advertise(module.CompressedVideo, 'video')
    publisher.publish(module.CompressedVideo(format='mystery', data=b'\x82\x49\x83\x42'))
    assert bench.spin(lambda: 'send H.264' in messages_of(node))


@pytest.mark.parametrize(('codec', 'given'), [('hevc', 'h265'), ('vp9', 'vp9'), ('av1', 'av1')])
def test_a_codec_without_vectors_is_encoded_again(bench, codec, given):
    module = pytest.importorskip('foxglove_msgs.msg')
    packets = other_codecs.coded(clips.pictures(), codec, 100_000_000, START)
    received = bench.listen(Correspondences, 'correspondences')
    node = bench.start(DecoderNode)
    publish_camera(bench)
    publisher = bench.advertise(module.CompressedVideo, 'video')
    for packet in packets:
        publisher.publish(module.CompressedVideo(
            timestamp=stamp_to_msg(packet.stamp), format=given, data=packet.data))
        bench.spin(lambda: False, 0.02)
    expected = expected_records(packets)
    assert len(expected) >= 5
    assert bench.spin(lambda: len(received) >= len(expected))
    assert_arrived(received, expected)
    assert messages_of(node) == 'ok'


def test_reset_and_pause(bench):
    message_type, messages = ffmpeg_messages(clips.packets('h264', START))
    received = bench.listen(Correspondences, 'correspondences')
    node = bench.start(DecoderNode)
    publish_camera(bench)
    publisher = bench.advertise(message_type, 'video')
    assert bench.call(SetBool, '/decoder/pause', data=True).success
    for msg in messages:
        publisher.publish(msg)
    bench.spin(lambda: False, 0.5)
    assert received == []
    assert 'paused' in messages_of(node)
    assert bench.call(SetBool, '/decoder/pause', data=False).success
    for msg in messages:
        publisher.publish(msg)
    n = len(expected_records(clips.packets('h264', START)))
    assert bench.spin(lambda: len(received) == n)
    assert bench.call(Trigger, '/decoder/reset').success
    for msg in messages:
        publisher.publish(msg)
    assert bench.spin(lambda: len(received) == 2 * n)
    assert_arrived(received[n:], expected_records(clips.packets('h264', START)))


def test_a_video_that_starts_again_is_a_new_stream(bench):
    packets = clips.packets('h264', START)
    message_type, messages = ffmpeg_messages([*packets, *clips.packets('h264', 0)])
    received = bench.listen(Correspondences, 'correspondences')
    bench.start(DecoderNode)
    publish_camera(bench)
    publisher = bench.advertise(message_type, 'video')
    for msg in messages:
        publisher.publish(msg)
    n = len(expected_records(packets))
    assert bench.spin(lambda: len(received) >= 2 * n)
    assert_arrived(received[n:], expected_records(clips.packets('h264', 0)))


def test_a_file_is_decoded_to_its_end(bench, tmp_path):
    write_video(tmp_path / 'clip.mp4', clips.pictures(), clips.FPS)
    write_camera(tmp_path / 'camera.yaml', fields.camera_from_message(clips.camera_info()))
    received = bench.listen(Correspondences, 'correspondences')
    node = bench.start(DecoderNode, source=str(tmp_path / 'clip.mp4'), source_rate=0.0,
                       camera_info_url=f'file://{tmp_path}/camera.yaml', stamp_origin='stream',
                       camera_frame='front')
    assert bench.spin(lambda: 'ended' in str(node.health.status().values))
    bench.spin(lambda: False, 0.2)
    assert received[-1].header.stamp.sec == 1
    assert received[-1].header.stamp.nanosec == 500_000_000
    assert received[0].header.frame_id == 'front'


def test_a_file_gets_the_time_of_the_clock(bench, tmp_path):
    write_video(tmp_path / 'clip.mp4', clips.pictures(), clips.FPS)
    write_camera(tmp_path / 'camera.yaml', fields.camera_from_message(clips.camera_info()))
    received = bench.listen(Correspondences, 'correspondences')
    begin = time.time()
    bench.start(DecoderNode, source=str(tmp_path / 'clip.mp4'), source_rate=2.0,
                camera_info_url=str(tmp_path / 'camera.yaml'))
    assert bench.spin(lambda: len(received) >= 2)
    stamps = [fields.stamp_from_message(msg.header.stamp) / 1e9 for msg in received]
    assert begin < stamps[0] < stamps[1] < begin + 5
