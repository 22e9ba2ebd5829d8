from dataclasses import replace

import pytest

pytest.importorskip('rclpy')
pytest.importorskip('mv_slapse_msgs')

from drawn_movers import Drive, Mover  # noqa: E402
from geometry_msgs.msg import PolygonInstanceStamped  # noqa: E402
import made_up  # noqa: E402
from mv_slapse import fields  # noqa: E402
from mv_slapse.config import ObstacleSettings  # noqa: E402
from mv_slapse.nodes.conversions import to_message  # noqa: E402
from mv_slapse.nodes.obstacle_output import ObstacleOutput  # noqa: E402
from mv_slapse.nodes.obstacle_tracker import ObstacleTrackerNode  # noqa: E402
from mv_slapse.nodes.shell import Shell  # noqa: E402
from mv_slapse.obstacles.tracker import ObstacleTracker  # noqa: E402
from mv_slapse.records import Label, Obstacle, ObstacleState, ScaleStatus  # noqa: E402
from mv_slapse.ros_frames import RosFrames  # noqa: E402
from mv_slapse_msgs.msg import (  # noqa: E402
    ObstacleArray,
    PlaneHandover,
    PlaneMap,
    PlaneObservations,
)
from nav_msgs.msg import Odometry  # noqa: E402
from nodes.bench import LATCHED  # noqa: E402
import numpy as np  # noqa: E402
from sensor_msgs.msg import PointCloud2  # noqa: E402
from std_srvs.srv import Trigger  # noqa: E402
from visualization_msgs.msg import Marker, MarkerArray  # noqa: E402

FRAMES = RosFrames()
N = 10


class Output(Shell):
    def __init__(self, **kwargs):
        super().__init__('obstacle_tracker', **kwargs)
        self.output = ObstacleOutput(self)


@pytest.fixture(scope='module')
def drive():
    """Return extractions and scenes: a car 15 m ahead, 4 m/s slower than the camera."""
    made, rng = Drive((Mover(5, (0.0, 15.0), (0.0, 6.0)),), scale_sigma=0.0), (
        np.random.default_rng(0))
    times = [(0.1 * i, 0.1 * (i + 1)) for i in range(N)]
    return [(made.extraction(*pair, rng), made.scene(*pair)) for pair in times]


class Feeder:
    def __init__(self, bench):
        self.observations = bench.advertise(PlaneObservations, 'planes/observations')
        self.odometry = bench.advertise(Odometry, 'odometry')
        self.maps = bench.advertise(PlaneMap, 'planes/map', LATCHED)

    def feed(self, drive):
        for extraction, scene in drive:
            self.observations.publish(to_message(
                PlaneObservations, fields.extraction_to_fields(extraction, FRAMES)))
            self.odometry.publish(to_message(
                Odometry, fields.odometry_to_fields(scene, FRAMES)))
            self.maps.publish(to_message(PlaneMap, fields.plane_map_to_fields(scene, FRAMES)))


def tracked(drive):
    tracker = ObstacleTracker(ObstacleSettings())
    return [tracker.step(extraction, scene)[0] for extraction, scene in drive]


def assert_tracked(received, drive):
    for msg, expected in zip(received, tracked(drive), strict=True):
        found = fields.obstacles_from_message(msg, FRAMES)
        assert [(o.id, o.state) for o in found] == [(o.id, o.state) for o in expected]
        for obstacle, other in zip(found, expected, strict=True):
            np.testing.assert_allclose(obstacle.position, other.position, rtol=1e-6)
            np.testing.assert_allclose(obstacle.velocity, other.velocity, atol=1e-5)


def test_observations_odometry_and_map_give_the_obstacles_of_the_tracker(bench, drive):
    received = bench.listen(ObstacleArray, 'obstacles')
    bench.start(ObstacleTrackerNode, tf_wait=0.0)
    Feeder(bench).feed(drive)
    assert bench.spin(lambda: len(received) == N, 20)
    assert_tracked(received, drive)
    car = received[-1].obstacles[0]
    assert car.state == ObstacleState.CONFIRMED
    assert received[-1].header.frame_id == 'odom'
    assert car.position.x == pytest.approx(21.0, rel=0.1)
    assert car.velocity.x == pytest.approx(6.0, abs=1.0)
    assert car.time_to_contact == pytest.approx(11 / 4, rel=0.3)


def test_reset_forgets_the_obstacles(bench, drive):
    received = bench.listen(ObstacleArray, 'obstacles')
    bench.start(ObstacleTrackerNode, tf_wait=0.0)
    feeder = Feeder(bench)
    feeder.feed(drive)
    assert bench.spin(lambda: len(received) == N, 20)
    assert bench.call(Trigger, '/obstacle_tracker/reset').success
    feeder.feed(drive)
    assert bench.spin(lambda: len(received) == 2 * N, 20)
    assert_tracked(received[N:], drive)


def test_where_slam_begins_anew_the_obstacles_do_too(bench, drive):
    received = bench.listen(ObstacleArray, 'obstacles')
    bench.start(ObstacleTrackerNode, tf_wait=0.0)
    feeder = Feeder(bench)
    far = [(e, replace(s, t_world_from_cam=s.t_world_from_cam + (0, 0, 500)))
           for e, s in drive[:5]]
    feeder.feed([*far, *drive[5:]])
    assert bench.spin(lambda: len(received) == N, 20)
    assert received[4].obstacles
    assert all(o.state == ObstacleState.TENTATIVE for o in received[5].obstacles)


def test_a_plane_handed_over_by_slam_becomes_an_obstacle(bench, drive):
    received = bench.listen(ObstacleArray, 'obstacles')
    bench.start(ObstacleTrackerNode, tf_wait=0.0)
    feeder = Feeder(bench)
    handovers = bench.advertise(PlaneHandover, 'planes/handover')
    extraction, scene = drive[0]
    record = made_up.handover(np.random.default_rng(0), extraction.stamp)
    record = type(record)(**{**vars(record), 'id': 5})
    handovers.publish(to_message(PlaneHandover, fields.handover_to_fields(record, FRAMES)))
    bench.spin(lambda: False, 0.2)
    feeder.feed(drive[:3])
    assert bench.spin(lambda: len(received) == 3, 20)
    tracker, given = ObstacleTracker(ObstacleSettings()), [record]
    for msg, (extraction, scene) in zip(received, drive, strict=False):
        expected, _ = tracker.step(extraction, scene, given)
        given = []
        assert [o.id for o in msg.obstacles] == [o.id for o in expected]


def test_the_handover_of_the_other_direction_is_left_alone(bench):
    node = bench.start(ObstacleTrackerNode, tf_wait=0.0)
    handovers = bench.advertise(PlaneHandover, 'planes/handover')
    record = made_up.handover(np.random.default_rng(0))
    for label in (Label.STATIONARY, Label.MOVING):
        handovers.publish(to_message(PlaneHandover, fields.handover_to_fields(
            type(record)(**{**vars(record), 'to_label': label}), FRAMES)))
    bench.spin(lambda: False, 0.3)
    assert [h.to_label for h in node._handovers.due(10**12, FRAMES)] == [Label.MOVING]


def car(id_, state):
    """Return an obstacle whose rear, 2 m wide and 1.5 m high, is seen 10 m ahead."""
    outline = np.array([[-1.0, 0, 10], [1, 0, 10], [1, 1.5, 10], [-1, 1.5, 10]])
    return Obstacle(id_, 5, state, np.array([0, 0, -0.1]), outline.mean(0),
                    np.array([0.0, 0, -3]), np.eye(6), 3.3, 0.1, np.zeros(4), outline, 9, 1.0, 5,
                    made_up.r.ScalePrior.GROUND_CONTACT)


def published(bench, message_type, topic, obstacles):
    received = bench.listen(message_type, topic)
    node = bench.start(Output)
    assert bench.spin(lambda: bench.peer.count_publishers(topic))
    bench.spin(lambda: False, 0.3)
    node.output.publish(5, obstacles, ScaleStatus.METRIC, FRAMES)
    assert bench.spin(lambda: received)
    bench.spin(lambda: False, 0.1)
    return node, received


def test_the_point_cloud_covers_confirmed_obstacles_only(bench):
    _, (cloud,) = published(bench, PointCloud2, '/obstacles/points',
                            [car(3, ObstacleState.CONFIRMED), car(4, ObstacleState.TENTATIVE)])
    assert [f.name for f in cloud.fields] == ['x', 'y', 'z', 'vx', 'vy', 'vz', 'id']
    offsets = {f.name: (f.offset, '<i4' if f.name == 'id' else '<f4') for f in cloud.fields}
    kind = np.dtype({'names': list(offsets), 'formats': [f for _, f in offsets.values()],
                     'offsets': [o for o, _ in offsets.values()], 'itemsize': cloud.point_step})
    points = np.frombuffer(cloud.data, kind)
    assert len(points) == cloud.width
    assert set(points['id']) == {3}
    np.testing.assert_allclose(points['x'], 10, atol=1e-5)
    assert points['y'].min() == pytest.approx(-1)
    assert points['z'].min() == pytest.approx(-1.5)
    np.testing.assert_allclose(points['vx'], -3)


def test_an_empty_cloud_is_sent_where_there_is_nothing(bench):
    _, (cloud,) = published(bench, PointCloud2, '/obstacles/points', [])
    assert (cloud.width, len(cloud.data), cloud.header.frame_id) == (0, 0, 'odom')


def test_each_confirmed_obstacle_has_a_polygon_on_the_ground(bench):
    _, polygons = published(bench, PolygonInstanceStamped, '/obstacles/polygons',
                            [car(3, ObstacleState.COASTING), car(4, ObstacleState.TENTATIVE)])
    assert [msg.polygon.id for msg in polygons] == [3]
    corners = np.array([(p.x, p.y, p.z) for p in polygons[0].polygon.polygon.points])
    np.testing.assert_allclose(corners.min(0), [9.75, -1, -1.5], atol=1e-5)
    np.testing.assert_allclose(corners.max(0), [10.25, 1, -1.5], atol=1e-5)


def test_markers_keep_their_ids_and_are_deleted(bench):
    node, arrays = published(bench, MarkerArray, '/obstacles/markers',
                             [car(3, ObstacleState.CONFIRMED)])
    assert {(m.ns, m.id) for m in arrays[0].markers} == {
        ('obstacles', 3), ('velocity', 3), ('time_to_contact', 3)}
    node.output.publish(6, [], ScaleStatus.METRIC, FRAMES)
    assert bench.spin(lambda: len(arrays) == 2)
    assert {m.action for m in arrays[1].markers} == {Marker.DELETE}
    assert len(arrays[1].markers) == 3


def test_a_handover_waits_for_its_key_frame_and_is_given_once(bench):
    node = bench.start(ObstacleTrackerNode, tf_wait=0.0)
    record = made_up.handover(np.random.default_rng(0), stamp=400)
    bench.advertise(PlaneHandover, 'planes/handover').publish(
        to_message(PlaneHandover, fields.handover_to_fields(record, FRAMES)))
    bench.spin(lambda: False, 0.3)
    assert node._handovers.due(399, FRAMES) == []
    assert [h.id for h in node._handovers.due(400, FRAMES)] == [record.id]
    assert node._handovers.due(401, FRAMES) == []
