from dataclasses import replace
import os

import pytest

pytest.importorskip('rclpy')
pytest.importorskip('mv_slapse_msgs')

from mv_slapse import fields  # noqa: E402
from mv_slapse.codec import decoder as codec_decoder  # noqa: E402
from mv_slapse.nodes.conversions import to_message  # noqa: E402
from mv_slapse.nodes.decoder import DecoderNode  # noqa: E402
from mv_slapse.nodes.obstacle_tracker import ObstacleTrackerNode  # noqa: E402
from mv_slapse.nodes.plane_extraction import PlaneExtractionNode  # noqa: E402
from mv_slapse.nodes.slam import SlamNode  # noqa: E402
from mv_slapse.nodes.supervision import Tracebacks  # noqa: E402
from mv_slapse.ros_frames import RosFrames  # noqa: E402
from mv_slapse_msgs.msg import (  # noqa: E402
    Correspondences,
    ObstacleArray,
    PlaneHandover,
    PlaneMap,
    PlaneObservations,
)
from nav_msgs.msg import Odometry  # noqa: E402
from nodes import clips, drives  # noqa: E402
from nodes.bench import BEST_EFFORT, LATCHED, messages_of, value_of  # noqa: E402
import numpy as np  # noqa: E402
from rcl_interfaces.msg import Parameter  # noqa: E402
from rcl_interfaces.srv import SetParameters  # noqa: E402
from rclpy.serialization import serialize_message  # noqa: E402
from sensor_msgs.msg import CameraInfo, Image  # noqa: E402

FRAMES = RosFrames(camera='cam')


def correspondences(pair, **values):
    return to_message(Correspondences, {**fields.correspondences_to_fields(pair, FRAMES),
                                        **values})


def observations(step, **values):
    return to_message(PlaneObservations, {**fields.extraction_to_fields(step.extraction, FRAMES),
                                          **values})


def garbage(message):
    """Return bytes that are no such message, and some that are cut."""
    data = bytes(serialize_message(message))
    rng = np.random.default_rng(0)
    return [data[:len(data) // 2], data[:3], rng.bytes(300), b'\0\1\0\0' + b'\xff' * 64]


def extraction_node(bench):
    node = bench.start(PlaneExtractionNode)
    bench.peer.create_publisher(CameraInfo, 'camera_info', LATCHED).publish(drives.camera_info())
    assert bench.spin(lambda: 'no camera_info' not in messages_of(node))
    return node


def test_poison_on_correspondences_is_dropped_and_counted_and_the_rest_is_used(bench):
    received = bench.listen(PlaneObservations, 'planes/observations')
    node = extraction_node(bench)
    publisher = bench.advertise(Correspondences, 'correspondences')
    pairs = drives.pairs(2)
    poison = [correspondences(pairs[0], sigma=np.ones(1, np.float32)),
              correspondences(pairs[0], kind=99),
              correspondences(pairs[0], x_prev=pairs[0].x_prev[:, 0] * np.nan),
              correspondences(pairs[0], width=2**32 - 1, height=2**32 - 1),
              *garbage(correspondences(pairs[0]))]
    for message in poison:
        publisher.publish(message)
    rejected = 'rejected on correspondences'
    # some of the garbage is already dropped by the middleware
    assert bench.spin(lambda: int(value_of(node, rejected) or 0) >= 4)
    assert received == []
    assert node.health.status().level == b'\x02'
    for pair in pairs:
        publisher.publish(correspondences(pair))
    assert bench.spin(lambda: len(received) == 2, 20)
    assert 4 <= int(value_of(node, rejected)) <= len(poison)
    assert value_of(node, 'faults') == ''


def test_a_rejected_message_is_told_with_field_and_value(bench):
    node = extraction_node(bench)
    publisher = bench.advertise(Correspondences, 'correspondences')
    publisher.publish(correspondences(drives.pairs(1)[0], kind=99))
    assert bench.spin(lambda: 'correspondences: kind = 99: must be one of' in messages_of(node))


def test_bytes_that_are_no_message_are_counted(bench):
    node = extraction_node(bench)
    publisher = bench.advertise(Correspondences, 'correspondences')
    before = correspondences(drives.pairs(1)[0])
    for data in garbage(before):
        publisher.publish(data)
    assert bench.spin(lambda: 'bytes are no Correspondences' in messages_of(node))


@pytest.mark.parametrize(('message_type', 'topic', 'profile'), [
    (PlaneHandover, 'planes/handover', 10), (Odometry, 'wheel_odometry', BEST_EFFORT)])
def test_poison_on_a_side_input_hinders_nothing(bench, message_type, topic, profile):
    odometry = bench.listen(Odometry, 'odometry')
    node = bench.start(SlamNode, scene__camera_height=drives.HEIGHT, tf_wait=0.0)
    side = bench.advertise(message_type, topic, profile)
    message = message_type()
    if message_type is Odometry:
        message.twist.twist.linear.x = float('nan')
    else:
        message.plane[:] = float('nan')
    side.publish(message)
    assert bench.spin(lambda: value_of(node, f'rejected on {topic}') == '1')
    publisher = bench.advertise(PlaneObservations, 'planes/observations')
    for step in drives.steps(3 + drives.WITHOUT_POSE):
        publisher.publish(observations(step))
    assert bench.spin(lambda: len(odometry) == 3, 20)


def test_poison_in_the_map_and_the_pose_does_not_end_the_tracker(bench):
    obstacles = bench.listen(ObstacleArray, 'obstacles')
    node = bench.start(ObstacleTrackerNode, tf_wait=0.0)
    topics = {PlaneObservations: 'planes/observations', Odometry: 'odometry'}
    publishers = {kind: bench.advertise(kind, topic) for kind, topic in topics.items()}
    maps = bench.advertise(PlaneMap, 'planes/map', LATCHED)
    step = drives.steps(1 + drives.WITHOUT_POSE)[-1]
    pose = to_message(Odometry, fields.odometry_to_fields(step.scene, FRAMES))
    plane_map = to_message(PlaneMap, fields.plane_map_to_fields(step.scene, FRAMES))
    pose.pose.pose.orientation.w = 9.0
    publishers[PlaneObservations].publish(observations(step))
    publishers[Odometry].publish(pose)
    maps.publish(plane_map)
    assert bench.spin(lambda: 'pose.orientation' in messages_of(node))
    plane_map.tracking = 77
    maps.publish(plane_map)
    assert bench.spin(lambda: 'tracking = 77' in messages_of(node))
    pose.pose.pose.orientation = to_message(Odometry, fields.odometry_to_fields(
        step.scene, FRAMES)).pose.pose.orientation
    plane_map.tracking = 1
    publishers[Odometry].publish(pose)
    maps.publish(plane_map)
    assert bench.spin(lambda: obstacles)


@pytest.mark.parametrize('values', [
    {'width': 2**32 - 1, 'height': 2**32 - 1}, {'encoding': 'no such'}, {'step': 1}])
def test_a_picture_that_is_none_is_dropped(bench, values):
    node = bench.start(DecoderNode)
    bench.peer.create_publisher(CameraInfo, 'camera_info', LATCHED).publish(clips.camera_info())
    publisher = bench.advertise(Image, 'video')
    message = {'width': 8, 'height': 8, 'step': 8, 'encoding': 'mono8', 'data': b'\0' * 64}
    publisher.publish(Image(**{**message, **values}))
    assert bench.spin(lambda: node.health.status().level == b'\x02')
    assert 'video: ' in messages_of(node)


def test_a_foreign_error_restarts_its_part_and_is_told_once_with_its_traceback(
        bench, monkeypatch, capfd):
    received = bench.listen(PlaneObservations, 'planes/observations')
    node = extraction_node(bench)
    publisher = bench.advertise(Correspondences, 'correspondences')
    first = node._extractor

    def fail(_):
        raise KeyError('made up')

    monkeypatch.setattr(first, 'extract', fail)
    publisher.publish(correspondences(drives.pairs(1)[0]))
    assert bench.spin(lambda: "KeyError: 'made up'" in messages_of(node))
    assert node.health.status().level == b'\x02'
    assert node._extractor is not first
    assert value_of(node, 'faults') == '1'
    for pair in drives.pairs(2):
        publisher.publish(correspondences(pair))
    assert bench.spin(lambda: len(received) == 2, 20)
    assert 'KeyError' not in messages_of(node)
    assert capfd.readouterr().err.count('in fail') == 1


def test_a_decoder_that_fails_is_made_anew_while_the_node_goes_on(bench, monkeypatch):
    module = pytest.importorskip('ffmpeg_image_transport_msgs.msg')
    from mv_slapse.video_messages import packet_to_fields
    packets = clips.packets('h264')
    received = bench.listen(Correspondences, 'correspondences')
    node = bench.start(DecoderNode)
    bench.peer.create_publisher(CameraInfo, 'camera_info', LATCHED).publish(clips.camera_info())
    publisher = bench.advertise(module.FFMPEGPacket, 'video')

    def send(chosen):
        for i, packet in enumerate(chosen):
            publisher.publish(to_message(module.FFMPEGPacket, packet_to_fields(
                packet, clips.SIZE, i, 'cam')))

    with monkeypatch.context() as patch:
        patch.setattr(codec_decoder.CorrespondenceDecoder, 'feed',
                      lambda *_: (_ for _ in ()).throw(KeyError(17)))
        send(packets[:1])
        assert bench.spin(lambda: 'KeyError: 17' in messages_of(node))
    later = [replace(p, stamp=p.stamp + 10**9) for p in packets]
    send(later)
    assert bench.spin(lambda: len(received) >= 2)
    assert bench.spin(lambda: 'KeyError' not in messages_of(node))


def test_a_parameter_of_no_type_does_not_end_a_node(bench):
    node = bench.start(SlamNode, tf_wait=0.0)
    client = bench.peer.create_client(SetParameters, '/slam/set_parameters')
    assert bench.spin(client.service_is_ready)
    strange = Parameter(name='publish_tf')
    strange.value.type = 99
    client.call_async(SetParameters.Request(parameters=[strange]))
    assert bench.spin(lambda: bench.escaped)
    assert 'set_parameters' in bench.escaped[0][0]
    bench.escaped.clear()
    client = bench.peer.create_client(SetParameters, '/slam/set_parameters')
    assert bench.spin(client.service_is_ready)
    done = client.call_async(SetParameters.Request(parameters=[]))
    assert bench.spin(done.done)
    assert node.get_name() == 'slam'


def test_a_traceback_is_told_once_for_each_place():
    told = Tracebacks()

    def caught(kind):
        try:
            raise kind('x')
        except Exception as error:
            return error

    assert 'caught' in told.first(caught(KeyError))
    assert told.first(caught(KeyError)) == ''
    assert 'ValueError' in told.first(caught(ValueError))


def test_random_bytes_on_every_input_end_no_node(bench):
    rng = np.random.default_rng(int(os.environ.get('MV_SLAPSE_SEED', '0')))
    nodes = [bench.start(SlamNode, tf_wait=0.0), bench.start(ObstacleTrackerNode, tf_wait=0.0)]
    publisher = bench.advertise(PlaneObservations, 'planes/observations', subscribers=2)
    good = np.frombuffer(serialize_message(observations(drives.steps(1)[0])), np.uint8)
    for _ in range(60):
        spoilt = good.copy()
        spoilt[rng.integers(4, len(good), 8)] = rng.integers(0, 256, 8)
        publisher.publish(spoilt.tobytes())
        bench.spin(lambda: False, 0.01)
    bench.spin(lambda: False, 0.5)
    assert all(value_of(node, 'faults') == '' for node in nodes)
