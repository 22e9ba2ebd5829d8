"""Where the trajectory lies: publish_tf, initialpose, ~/pause, ~/reset, the counter of resets."""

from dataclasses import replace

import pytest

pytest.importorskip('rclpy')
pytest.importorskip('mv_slapse_msgs')

from geometry_msgs.msg import PoseWithCovarianceStamped  # noqa: E402
from mv_slapse import fields  # noqa: E402
from mv_slapse.nodes.conversions import to_message  # noqa: E402
from mv_slapse.nodes.obstacle_tracker import ObstacleTrackerNode  # noqa: E402
from mv_slapse.nodes.slam import SlamNode  # noqa: E402
from mv_slapse.ros_frames import Pose, pose_to_odom, RosFrames  # noqa: E402
from mv_slapse_msgs.msg import PlaneMap, PlaneObservations  # noqa: E402
from nav_msgs.msg import Odometry  # noqa: E402
from nodes import drives  # noqa: E402
from nodes.bench import LATCHED, messages_of, value_of  # noqa: E402
import numpy as np  # noqa: E402
from scipy.spatial.transform import Rotation  # noqa: E402
from std_srvs.srv import SetBool, Trigger  # noqa: E402

MAPS = LATCHED
W = drives.WITHOUT_POSE
PAIRS = 6 + 2 * W


class Drive:
    """A slam node that is fed with the key frames of a drive."""

    def __init__(self, bench, **parameters):
        self.bench = bench
        self.odometry = bench.listen(Odometry, 'odometry')
        self.maps = bench.listen(PlaneMap, 'planes/map', MAPS)
        self.node = bench.start(SlamNode, tf_wait=0.0, scene__camera_height=drives.HEIGHT,
                                **parameters)
        self.publisher = bench.advertise(PlaneObservations, 'planes/observations')

    def begin(self):
        """Go as far as to the third pose."""
        return self.go(0, W + 3, W)

    def go(self, begin, end, waits=0):
        """Feed pairs, the first of which give no pose yet; return all positions so far."""
        n, n_maps = len(self.odometry) + end - begin - waits, len(self.maps) + end - begin
        for step in drives.steps(PAIRS)[begin:end]:
            self.publisher.publish(to_message(PlaneObservations, fields.extraction_to_fields(
                step.extraction, RosFrames(camera='cam'))))
        assert self.bench.spin(
            lambda: len(self.odometry) == n and len(self.maps) == n_maps, 20), n
        return np.array([position(msg) for msg in self.odometry])


def position(msg):
    p = msg.pose.pose.position
    return p.x, p.y, p.z


def rotation(msg):
    q = msg.pose.pose.orientation
    return Rotation.from_quat([q.x, q.y, q.z, q.w]).as_matrix()


def initial_pose(x, y, yaw, frame='odom', sigma=0.1):
    msg = PoseWithCovarianceStamped()
    msg.header.frame_id = frame
    msg.pose.pose.position.x, msg.pose.pose.position.y = x, y
    msg.pose.pose.orientation.z = float(np.sin(yaw / 2))
    msg.pose.pose.orientation.w = float(np.cos(yaw / 2))
    msg.pose.covariance[:] = np.diag(np.full(6, sigma**2)).ravel()
    return msg


def test_without_publish_tf_there_is_odometry_but_no_transform(bench):
    tf2_msgs = pytest.importorskip('tf2_msgs.msg')
    transforms = bench.listen(tf2_msgs.TFMessage, '/tf')
    Drive(bench, publish_tf=False).begin()
    bench.spin(lambda: False, 0.3)
    assert transforms == []


def test_pause_goes_on_from_the_last_pose_and_counts_a_reset(bench):
    drive = Drive(bench)
    before = drive.begin()
    assert bench.call(SetBool, '/slam/pause', data=True).success
    assert bench.call(SetBool, '/slam/pause', data=False).success
    after = drive.go(W + 4, 2 * W + 6, W)  # what came meanwhile was not used
    way = np.linalg.norm(after[3] - before[2])
    usual = np.linalg.norm(before[2] - before[1])
    assert way == pytest.approx((W + 1) * usual, rel=0.2)
    assert np.linalg.norm(after[4] - after[3]) == pytest.approx(usual, rel=0.2)
    assert drive.maps[W + 2].resets == 0
    assert drive.maps[-1].resets == 1
    first, *_, last = drive.maps
    began = drive.maps[W + 2].began, last.began
    assert began == (first.header.stamp, drive.maps[W + 3].header.stamp)
    assert value_of(drive.node, 'resets') == '1'
    variances = [msg.pose.covariance[0] for msg in drive.odometry]
    assert variances[3] > variances[2]


def test_a_gap_that_no_prediction_bridges_counts_a_reset(bench):
    drive, hour = Drive(bench), 3600 * 10**9
    drive.begin()
    late = drives.steps(PAIRS)[W + 4].extraction
    drive.publisher.publish(to_message(PlaneObservations, fields.extraction_to_fields(replace(
        late, stamp=late.stamp + hour, previous_stamp=late.previous_stamp + hour),
        RosFrames(camera='cam'))))
    assert bench.spin(lambda: len(drive.odometry) == 4 and len(drive.maps) >= W + 4, 20)
    assert [msg.resets for msg in drive.maps] == [0] * (W + 3) + [1]
    assert value_of(drive.node, 'resets') == '1'
    assert np.linalg.norm(np.subtract(position(drive.odometry[3]),
                                      position(drive.odometry[2]))) < 5


def test_reset_begins_at_the_origin(bench):
    drive = Drive(bench)
    before = drive.begin()
    assert bench.call(Trigger, '/slam/reset').success
    after = drive.begin()
    np.testing.assert_allclose(after[3:], before, atol=1e-9)
    assert drive.maps[-1].resets == 1


def expected():
    """Return the poses of the base where nobody has placed it."""
    return drives.in_odom([step.scene for step in drives.steps(PAIRS)])


def test_a_pose_on_initialpose_is_the_pose_now(bench):
    drive = Drive(bench)
    drive.begin()
    publisher = bench.advertise(PoseWithCovarianceStamped, 'initialpose')
    publisher.publish(initial_pose(10.0, -5.0, np.pi / 2))
    assert bench.spin(lambda: value_of(drive.node, 'resets') == '1')
    after = drive.go(W + 3, W + 5)
    plain, turn = expected(), Rotation.from_euler('z', np.pi / 2).as_matrix()
    for i in (3, 4):
        moved = plain[2].R.T @ (plain[i].t - plain[2].t)
        np.testing.assert_allclose(after[i], [10, -5, 0] + turn @ moved, atol=1e-6)
        np.testing.assert_allclose(rotation(drive.odometry[i]),
                                   turn @ plain[2].R.T @ plain[i].R, atol=1e-6)
    assert drive.odometry[3].pose.covariance[0] > 0.1**2
    # turning by 0.1 rad moves what is far
    assert drive.odometry[4].pose.covariance[0] > drive.odometry[3].pose.covariance[0]
    assert drive.maps[-1].resets == 1


def test_a_pose_that_is_given_during_a_pause_counts(bench):
    drive = Drive(bench)
    drive.begin()
    publisher = bench.advertise(PoseWithCovarianceStamped, 'initialpose')
    bench.call(SetBool, '/slam/pause', data=True)
    publisher.publish(initial_pose(10.0, -5.0, 0.0))
    assert bench.spin(lambda: value_of(drive.node, 'resets') == '1')
    bench.call(SetBool, '/slam/pause', data=False)
    after = drive.go(W + 3, 2 * W + 4, W)
    plain = expected()
    moved = plain[2].R.T @ (plain[W + 3].t - plain[2].t)
    np.testing.assert_allclose(after[3], [10, -5, 0] + moved, atol=0.1)


def test_the_map_moves_with_the_trajectory(bench):
    drive = Drive(bench)
    drive.begin()
    publisher = bench.advertise(PoseWithCovarianceStamped, 'initialpose')
    publisher.publish(initial_pose(0.0, 0.0, 0.0))
    assert bench.spin(lambda: value_of(drive.node, 'resets') == '1')
    drive.go(W + 3, W + 4)
    ground = next(plane for plane in drive.maps[-1].planes if plane.is_ground)
    at = drive.odometry[3].pose.pose.position
    normal = ground.normal
    height = abs(normal.x * at.x + normal.y * at.y + normal.z * at.z + ground.depth)
    assert height == pytest.approx(drives.HEIGHT, rel=0.05)


def test_a_pose_before_the_first_key_frame_is_where_the_trajectory_begins(bench):
    drive = Drive(bench)
    publisher = bench.advertise(PoseWithCovarianceStamped, 'initialpose')
    publisher.publish(initial_pose(100.0, 0.0, 0.0, frame=''))
    assert bench.spin(lambda: value_of(drive.node, 'resets') == '1')
    after = drive.go(0, W + 2, W)
    first, *others = (step.scene for step in drives.steps(W + 2)[W:])
    plain = [pose_to_odom(Pose(scene.R_world_from_cam, scene.t_world_from_cam), RosFrames()).t
             for scene in (first, *others)]
    np.testing.assert_allclose(after - [100, 0, 0], plain, atol=1e-6)


@pytest.mark.parametrize('values', [
    {'frame': 'map'}, {'x': float('nan')}, {'sigma': float('inf')}])
def test_a_pose_that_cannot_be_used_changes_nothing(bench, values):
    drive = Drive(bench)
    publisher = bench.advertise(PoseWithCovarianceStamped, 'initialpose')
    publisher.publish(initial_pose(**{'x': 1.0, 'y': 0.0, 'yaw': 0.0, **values}))
    assert bench.spin(lambda: value_of(drive.node, 'rejected on initialpose') == '1')
    assert 'initialpose: ' in messages_of(drive.node)
    after = drive.go(0, W + 2, W)
    np.testing.assert_allclose(after, [pose.t for pose in expected()[:2]], atol=1e-6)


def test_the_saved_trajectory_and_map_are_in_one_frame_over_a_pause(bench, tmp_path):
    drive = Drive(bench, output_directory=str(tmp_path))
    drive.begin()
    for pause in (True, False):
        bench.call(SetBool, '/slam/pause', data=pause)
    drive.go(W + 4, 2 * W + 6, W)
    assert bench.call(Trigger, '/slam/save_trajectory').success
    rows = np.loadtxt(tmp_path / 'trajectory.tum')
    assert len(rows) == 6
    # the camera's poses in {W}, over the pause, are those of odometry but for where odom begins
    ways = np.linalg.norm(rows[1:, 1:4] - rows[1, 1:4], axis=1)
    at = np.array([position(msg) for msg in drive.odometry])
    np.testing.assert_allclose(ways, np.linalg.norm(at - at[0], axis=1), atol=1e-6)
    assert bench.call(Trigger, '/slam/save_map').success


@pytest.mark.parametrize('after', [(8, 1), (7, 2)])  # after a reset; by a slam started again
def test_the_tracker_begins_anew_where_slam_has(bench, after):
    node = bench.start(ObstacleTrackerNode, tf_wait=0.0)
    observations = bench.advertise(PlaneObservations, 'planes/observations')
    odometry = bench.advertise(Odometry, 'odometry')
    maps = bench.advertise(PlaneMap, 'planes/map', LATCHED)
    frames = RosFrames(camera='cam')
    for i, step in enumerate(drives.steps(W + 3)[W:]):
        observations.publish(to_message(PlaneObservations, fields.extraction_to_fields(
            step.extraction, frames)))
        odometry.publish(to_message(Odometry, fields.odometry_to_fields(step.scene, frames)))
        maps.publish(to_message(PlaneMap, fields.plane_map_to_fields(
            step.scene, frames, *(after if i == 2 else (7, 1)))))
        assert bench.spin(lambda: value_of(node, 'state') == 'working')
        bench.spin(lambda: False, 0.3)
        assert node.resets == (i == 2)
