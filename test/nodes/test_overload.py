import pytest

pytest.importorskip('rclpy')
pytest.importorskip('mv_slapse_msgs')

from types import SimpleNamespace  # noqa: E402

from mv_slapse import fields  # noqa: E402
from mv_slapse.nodes import latency  # noqa: E402
from mv_slapse.nodes.all_in_one import AllInOneNode  # noqa: E402
from mv_slapse.nodes.conversions import to_message  # noqa: E402
from mv_slapse.nodes.latency import Latency  # noqa: E402
from mv_slapse.nodes.plane_extraction import PlaneExtractionNode  # noqa: E402
from mv_slapse.nodes.settings import LatencySettings  # noqa: E402
from mv_slapse.nodes.slam import SlamNode  # noqa: E402
from mv_slapse.records import SegmentKind, TrackingStatus  # noqa: E402
from mv_slapse.ros_frames import RosFrames  # noqa: E402
from mv_slapse_msgs.msg import Correspondences, PlaneMap, PlaneObservations  # noqa: E402
from nav_msgs.msg import Odometry  # noqa: E402
from nodes import drives  # noqa: E402
from nodes.bench import held_up, LATCHED, messages_of, value_of  # noqa: E402
import numpy as np  # noqa: E402
from sensor_msgs.msg import CameraInfo  # noqa: E402

FRAMES = RosFrames(camera='cam')
N = 8
FAST, SLOW = 0.0, 40.0  # [s] behind, of at most
MOST = 60.0


@pytest.fixture
def clock(monkeypatch):
    """Return a clock that stands still until it is set."""
    made = SimpleNamespace(now=1000.0)
    monkeypatch.setattr(latency.time, 'monotonic', lambda: made.now)
    return made


class Told:
    """A node that only counts what a Latency says."""

    def __init__(self):
        self.settings = {LatencySettings: LatencySettings(max_latency=1.0)}
        self.health, self.counts = self, {}

    def count(self, name):
        self.counts[name] = self.counts.get(name, 0) + 1

    def enter(self, *_, **__):
        """Nothing is kept."""


def test_segments_are_dropped_from_half_the_bound_until_a_quarter_of_it(clock):
    node = Told()
    behind, decisions = Latency(node), []
    for waited in (0.0, 0.49, 0.51, 0.4, 0.26, 0.24, 0.4, 0.6):
        behind.begin(waited)
        decisions.append(behind.is_behind())
    assert decisions == [False, False, True, True, True, False, False, True]
    assert node.counts == {'segments dropped by overload': 4}


def test_what_was_held_back_for_something_else_is_not_late(clock):
    behind = Latency(Told())
    behind.begin(20.0)
    came = behind.came
    assert behind.is_behind(came)
    behind.opened()
    assert not behind.is_behind(came)
    clock.now += 0.6  # that it takes long then is its own fault
    assert behind.is_behind(came)


def test_a_clock_that_went_back_makes_nothing_early(clock):
    behind = Latency(Told())
    behind.begin(-5.0)
    assert behind.waited() == 0.0


def seen(step):
    return to_message(PlaneObservations, fields.extraction_to_fields(step.extraction, FRAMES))


def test_extraction_passes_broken_pairs_on_for_those_that_it_drops(bench):
    received = bench.listen(PlaneObservations, 'planes/observations')
    node = bench.start(PlaneExtractionNode, max_latency=MOST)
    bench.peer.create_publisher(CameraInfo, 'camera_info', LATCHED).publish(drives.camera_info())
    publisher = bench.advertise(Correspondences, 'correspondences')
    for i, pair in enumerate(drives.pairs(4)):
        held_up(node, SLOW if i in (1, 2) else FAST)
        publisher.publish(to_message(Correspondences,
                                     fields.correspondences_to_fields(pair, FRAMES)))
        assert bench.spin(lambda n=i: len(received) == n + 1, 20)
        assert ('fed faster than it can work' in str(node.health.status())) == (i > 0)
    assert [m.kind == SegmentKind.BROKEN for m in received] == [False, True, True, False]
    assert [m.reason for m in received[1:3]] == ['overload'] * 2
    assert value_of(node, 'segments dropped by overload') == '2'
    stamps = [p.stamp for p in drives.pairs(4)]
    assert [fields.stamp_from_message(m.header.stamp) for m in received] == stamps


def test_slam_predicts_over_what_it_drops_and_is_right_afterwards(bench):
    odometry = bench.listen(Odometry, 'odometry')
    maps = bench.listen(PlaneMap, 'planes/map', LATCHED)
    node = bench.start(SlamNode, tf_wait=0.0, scene__camera_height=drives.HEIGHT,
                       max_latency=MOST)
    publisher = bench.advertise(PlaneObservations, 'planes/observations')
    steps = drives.steps(N)
    for i, step in enumerate(steps):
        held_up(node, SLOW if i in (4, 5) else FAST)
        publisher.publish(seen(step))
        assert bench.spin(lambda n=i: len(maps) == n + 1, 20)
    assert bench.spin(lambda: len(odometry) == N - drives.WITHOUT_POSE)
    told = [TrackingStatus(m.tracking) for m in maps]
    assert told[:drives.WITHOUT_POSE] == [TrackingStatus.INITIALISING] * drives.WITHOUT_POSE
    assert told[4:6] == [TrackingStatus.PREDICTED] * 2
    posed = (*told[drives.WITHOUT_POSE:4], *told[6:])
    assert all(status is TrackingStatus.OK for status in posed)
    assert all('overload' in m.reason for m in maps[4:6])
    true = np.array([step.scene.t_world_from_cam[2] for step in steps])[drives.WITHOUT_POSE:]
    x = np.array([msg.pose.pose.position.x for msg in odometry])
    np.testing.assert_allclose(x, true, atol=0.4)
    sigma = np.sqrt([msg.pose.covariance[0] for msg in odometry])
    assert np.all(np.abs(x - true) < 3 * sigma)
    assert sigma[5 - drives.WITHOUT_POSE] > sigma[3 - drives.WITHOUT_POSE]


def test_all_in_one_accounts_for_every_pair_and_never_calls_a_dropped_one_ok(bench):
    pairs = bench.listen(Correspondences, 'correspondences')
    maps = bench.listen(PlaneMap, 'planes/map', LATCHED)
    node = bench.start(AllInOneNode, tf_wait=0.0, scene__camera_height=drives.HEIGHT,
                       max_latency=MOST)
    node._on_camera(drives.camera())
    for i, pair in enumerate(drives.pairs(N)):
        held_up(node, SLOW if i in (3, 4) else FAST)
        node.attempt('video', node._take, pair, 'cam')
        assert bench.spin(lambda n=i: len(maps) == n + 1, 20), messages_of(node)
    assert bench.spin(lambda: len(pairs) == N)
    assert [m.kind == SegmentKind.BROKEN for m in pairs] == [i in (3, 4) for i in range(N)]
    with_pose = [i >= drives.WITHOUT_POSE and i not in (3, 4) for i in range(N)]
    assert [m.tracking == TrackingStatus.OK for m in maps] == with_pose
    assert value_of(node, 'segments dropped by overload') == '2'
