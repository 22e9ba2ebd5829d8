import pytest

pytest.importorskip('rclpy')
pytest.importorskip('mv_slapse_msgs')

import made_up  # noqa: E402
from mv_slapse import fields  # noqa: E402
from mv_slapse.config import ExtractionSettings  # noqa: E402
from mv_slapse.extraction.extractor import PlaneExtractor  # noqa: E402
from mv_slapse.nodes import numbering, plane_extraction  # noqa: E402
from mv_slapse.nodes.conversions import to_message  # noqa: E402
from mv_slapse.nodes.plane_extraction import PlaneExtractionNode  # noqa: E402
from mv_slapse.ros_frames import RosFrames  # noqa: E402
from mv_slapse_msgs.msg import Correspondences, PlaneMap, PlaneObservations  # noqa: E402
from nodes import drives  # noqa: E402
from nodes.bench import BEST_EFFORT, LATCHED, messages_of  # noqa: E402
import numpy as np  # noqa: E402
from sensor_msgs.msg import CameraInfo  # noqa: E402
from std_srvs.srv import Trigger  # noqa: E402


@pytest.fixture(scope='module')
def pairs():
    return drives.pairs(4)


def publish_pairs(bench, pairs):
    publisher = bench.advertise(Correspondences, 'correspondences')
    for pair in pairs:
        publisher.publish(to_message(Correspondences, fields.correspondences_to_fields(
            pair, RosFrames(camera='cam'))))
    return publisher


def assert_extracted(received, pairs):
    extractor = PlaneExtractor(drives.camera(), ExtractionSettings())
    for msg, pair in zip(received, pairs, strict=True):
        found, expected = fields.extraction_from_message(msg), extractor.extract(pair)
        np.testing.assert_array_equal(found.motion.R_cur_from_prev,
                                      expected.motion.R_cur_from_prev)
        np.testing.assert_array_equal(found.label, expected.label)
        assert [p.id % numbering.BLOCK if p.id >= 0 else p.id for p in found.planes] == [
            p.id for p in expected.planes]
        for plane, other in zip(found.planes, expected.planes, strict=True):
            np.testing.assert_array_equal(plane.plane, other.plane)


def test_pairs_give_the_planes_of_the_extractor(bench, pairs):
    received = bench.listen(PlaneObservations, 'planes/observations')
    node = bench.start(PlaneExtractionNode)
    bench.peer.create_publisher(CameraInfo, 'camera_info', LATCHED).publish(drives.camera_info())
    publish_pairs(bench, pairs)
    assert bench.spin(lambda: len(received) == len(pairs), 20)
    assert_extracted(received, pairs)
    assert any(msg.planes for msg in received)
    assert received[0].header.frame_id == 'cam'
    assert node.health.status().level == b'\x00'


def test_the_height_of_the_camera_reaches_the_extractor(bench, monkeypatch):
    heights = []
    monkeypatch.setattr(plane_extraction, 'PlaneExtractor',
                        lambda camera, settings, height: heights.append(height))
    node = bench.start(PlaneExtractionNode, scene__camera_height=0.4)
    bench.peer.create_publisher(CameraInfo, 'camera_info', LATCHED).publish(drives.camera_info())
    assert bench.spin(lambda: len(heights) == 1, 20)
    node.restart()
    assert heights == [0.4, 0.4]


def test_pairs_wait_for_the_camera(bench, pairs):
    received = bench.listen(PlaneObservations, 'planes/observations')
    node = bench.start(PlaneExtractionNode)
    publish_pairs(bench, pairs[:2])
    bench.spin(lambda: False, 0.3)
    assert received == []
    assert 'no camera_info yet' in messages_of(node)
    bench.peer.create_publisher(CameraInfo, 'camera_info', 10)
    volatile = bench.advertise(CameraInfo, 'camera_info', BEST_EFFORT)
    volatile.publish(drives.camera_info())
    assert bench.spin(lambda: len(received) == 2, 20)
    assert_extracted(received, pairs[:2])


def test_reset_forgets_the_planes(bench, pairs):
    received = bench.listen(PlaneObservations, 'planes/observations')
    bench.start(PlaneExtractionNode)
    bench.peer.create_publisher(CameraInfo, 'camera_info', LATCHED).publish(drives.camera_info())
    publish_pairs(bench, pairs[:2])
    assert bench.spin(lambda: len(received) == 2, 20)
    assert bench.call(Trigger, '/plane_extraction/reset').success
    publish_pairs(bench, pairs[:2])
    assert bench.spin(lambda: len(received) == 4, 20)
    assert_extracted(received[2:], pairs[:2])
    # slam still has those that it was told of before
    before, after = ({plane.id for msg in half for plane in msg.planes if plane.id >= 0}
                     for half in (received[:2], received[2:]))
    assert before
    assert not before & after


def test_planes_of_a_node_that_was_started_again_are_not_taken_for_those_in_the_map(bench, pairs):
    received = bench.listen(PlaneObservations, 'planes/observations')
    scene = made_up.scene(np.random.default_rng(0))  # its plane has the id 7
    maps = bench.peer.create_publisher(PlaneMap, 'planes/map', LATCHED)
    maps.publish(to_message(PlaneMap, fields.plane_map_to_fields(scene, RosFrames())))
    bench.start(PlaneExtractionNode)
    bench.peer.create_publisher(CameraInfo, 'camera_info', LATCHED).publish(drives.camera_info())
    publish_pairs(bench, pairs)
    assert bench.spin(lambda: len(received) == len(pairs), 20)
    assert_extracted(received, pairs)
    for msg in received:
        ids = {plane.id for plane in msg.planes}
        assert all(id_ >= numbering.BLOCK or id_ < -1 for id_ in ids)
        assert set(msg.plane_id) <= {-1} | ids
    assert any(max(msg.macroblock_plane) >= numbering.BLOCK for msg in received)


def test_a_broken_pair_is_passed_on_with_its_reason(bench):
    received = bench.listen(PlaneObservations, 'planes/observations')
    node = bench.start(PlaneExtractionNode)
    bench.peer.create_publisher(CameraInfo, 'camera_info', LATCHED).publish(drives.camera_info())
    publish_pairs(bench, [drives.broken()])
    assert bench.spin(lambda: len(received) == 1)
    assert received[0].motion_status == PlaneObservations.MOTION_UNKNOWN
    assert 'a packet was lost' in received[0].reason
    assert 'a packet was lost' in messages_of(node)


def test_a_best_effort_publisher_of_correspondences_is_named_with_the_cure(bench):
    node = bench.start(PlaneExtractionNode)
    bench.peer.create_publisher(Correspondences, 'correspondences', BEST_EFFORT)
    assert bench.spin(lambda: 'make the publisher reliable' in messages_of(node))
    assert '/correspondences' in messages_of(node)
