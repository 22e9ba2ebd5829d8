"""The main job: a bag replayed over DDS into the four nodes, each a process of its own."""

from contextlib import contextmanager
import os
import signal
import subprocess
import sys
from typing import NamedTuple

import pytest

pytest.importorskip('rclpy')
pytest.importorskip('mv_slapse_msgs')
pytest.importorskip('ffmpeg_image_transport_msgs')

from conftest import DATA, ROOT  # noqa: E402
import endings  # noqa: E402
from mv_slapse.codec.encoding.encoder import write_video  # noqa: E402
from mv_slapse.config import SceneSettings, Settings  # noqa: E402
from mv_slapse.evaluation import trajectory as evaluation  # noqa: E402
from mv_slapse.fields import stamp_from_message  # noqa: E402
from mv_slapse.records import TrackingStatus  # noqa: E402
from mv_slapse.ros_frames import RosFrames  # noqa: E402
from mv_slapse.scene.scale.height import ENOUGH  # noqa: E402
from mv_slapse.simulation.street import Street, StreetSettings  # noqa: E402
from mv_slapse.simulation.truth import film  # noqa: E402
from mv_slapse.storage.bag_reader import BagReader  # noqa: E402
from mv_slapse.storage.camera_info import read_camera, write_camera  # noqa: E402
from mv_slapse.storage.tum import read_trajectory, Trajectory  # noqa: E402
from mv_slapse.tools.bag import make_bag  # noqa: E402
from mv_slapse.tools.eval import frames_of  # noqa: E402
from mv_slapse.tools.run import run  # noqa: E402
import numpy as np  # noqa: E402
import rclpy  # noqa: E402
from scipy.spatial.transform import Rotation  # noqa: E402
from system.recorded import messages, trajectory  # noqa: E402
from system.recorder import Recorder  # noqa: E402

CAMERA_HEIGHT = 1.65
N_FRAMES = 60
SOURCE_TIMEOUT = 2.0  # [s], of the collision monitor in docs/nav2.md
START = 100_000_000_000  # [ns] a robot's clock is not at 0
TOPICS = {
    '/correspondences': 'mv_slapse_msgs/msg/Correspondences',
    '/planes/observations': 'mv_slapse_msgs/msg/PlaneObservations',
    '/odometry': 'nav_msgs/msg/Odometry',
    '/pose': 'geometry_msgs/msg/PoseWithCovarianceStamped',
    '/twist': 'geometry_msgs/msg/TwistWithCovarianceStamped',
    '/path': 'nav_msgs/msg/Path',
    '/tf': 'tf2_msgs/msg/TFMessage',
    '/planes/map': 'mv_slapse_msgs/msg/PlaneMap',
    '/planes/map_markers': 'visualization_msgs/msg/MarkerArray',
    '/obstacles': 'mv_slapse_msgs/msg/ObstacleArray',
    '/obstacles/points': 'sensor_msgs/msg/PointCloud2',
    '/diagnostics': 'diagnostic_msgs/msg/DiagnosticArray',
}
LATCHED = ('/planes/map', '/planes/map_markers')
REMAPPED = ('video:=/camera/image/ffmpeg', 'camera_info:=/camera/camera_info')
FOUR = ('decoder', 'plane_extraction', 'slam', 'obstacle_tracker')
#: what must be connected before the first picture: a node and what it reads from another
READ = {('plane_extraction', '/correspondences'), ('slam', '/planes/observations'),
        ('obstacle_tracker', '/planes/observations'), ('obstacle_tracker', '/odometry'),
        ('obstacle_tracker', '/planes/map')}
#: that read the calibration
CAMERAS = {'decoder', 'plane_extraction', 'all_in_one'}


class Drive(NamedTuple):
    """A bag, what the command line makes of it, and the truth."""

    bag: str
    expected: Trajectory
    truth: Trajectory
    frames: RosFrames


@pytest.fixture(scope='module')
def drive(tmp_path_factory):
    folder = tmp_path_factory.mktemp('drive')
    video, camera_file, truth_file = _kitti() if DATA.is_dir() else _rendered(folder)
    camera, truth = read_camera(camera_file), read_trajectory(truth_file)
    make_bag(str(video), camera, truth, folder / 'bag', START, N_FRAMES)
    settings = Settings(scene=SceneSettings(camera_height=CAMERA_HEIGHT))
    run(str(folder / 'bag'), None, settings, folder / 'run')
    moved = Trajectory(truth.stamps + START, truth.positions, truth.quaternions)
    return Drive(str(folder / 'bag'), read_trajectory(folder / 'run' / 'trajectory.tum'), moved,
                 frames_of(folder / 'run' / 'results.mcap'))


def _kitti():
    folder = DATA / 'kitti00'
    return folder / 'mpeg2.mpg', folder / 'camera.yaml', folder / 'ground_truth.tum'


def _rendered(folder):
    street = Street(StreetSettings(n_frames=N_FRAMES))
    write_camera(folder / 'camera.yaml', street.camera)
    write_video(folder / 'street.mpg', film(street, folder), street.settings.fps)
    return folder / 'street.mpg', folder / 'camera.yaml', folder / 'ground_truth.tum'


@contextmanager
def running(names, folder):
    """Run nodes as processes; they must end cleanly on SIGINT."""
    command = [sys.executable, '-m']
    options = ['--ros-args', '-p', f'scene.camera_height:={CAMERA_HEIGHT}',
               # a busy machine must not change what is compared
               '-p', 'max_latency:=3600.0']
    for pair in REMAPPED:
        options += ['-r', pair]
    env = {**os.environ, 'PYTHONPATH': str(ROOT), 'ROS_LOG_DIR': str(folder)}
    logs = [folder / f'{name}.log' for name in names]
    nodes = [subprocess.Popen([*command, f'mv_slapse.nodes.{name}', *options], env=env,
                              cwd=folder, stdout=log.open('wb'), stderr=subprocess.STDOUT)
             for name, log in zip(names, logs, strict=True)]
    try:
        yield
    finally:
        for node in nodes:
            node.send_signal(signal.SIGINT)
        codes = [node.wait(20) for node in nodes]
    for code, log in zip(codes, logs, strict=True):
        endings.check(code, log.read_text())


def replay(bag, names, folder) -> BagReader:
    """Play a bag into nodes and return what they published."""
    rclpy.init()
    try:
        with Recorder(folder / 'recorded', TOPICS, LATCHED) as recorder, running(names, folder):
            assert recorder.spin(lambda: connected(recorder, names), 30), recorder.nodes
            command = [sys.executable, ROOT / 'test/system/player.py', bag, '1.0']
            player = subprocess.Popen([*command, str(len(CAMERAS & {*names}))])
            assert recorder.spin(lambda: player.poll() is not None, 90)
            assert player.returncode == 0
            assert recorder.spin(lambda: recorder.silent_for(3), 60)
    finally:
        rclpy.shutdown()
    bag = BagReader(folder / 'recorded')
    assert len(messages(bag, '/planes/map')) > 0.9 * len(messages(bag, '/odometry'))
    return bag


def connected(recorder, names) -> bool:
    """Return whether the nodes have found each other, as they say, and the recorder them."""
    wanted = {(name, topic) for name, topic in READ if name in names}
    return (recorder.finds_all() and {*recorder.nodes} >= {*names}
            and all(recorder.nodes[name].get(f'publishers of {topic}', '0') != '0'
                    for name, topic in wanted))


@pytest.fixture(scope='module')
def recorded(drive, ros_domain, tmp_path_factory):
    return replay(drive.bag, FOUR, tmp_path_factory.mktemp('four'))


@pytest.fixture(scope='module')
def recorded_in_one(drive, ros_domain, tmp_path_factory):
    return replay(drive.bag, ('all_in_one',), tmp_path_factory.mktemp('one'))


def assert_same_trajectory(found: Trajectory, expected: Trajectory):
    """Compare with the command line's, which also has the first key frame and the end."""
    assert found.stamps[0] == expected.stamps[1]
    assert len(found) >= len(expected) - 3
    expected_at = dict(zip(expected.stamps.tolist(), range(len(expected)), strict=True))
    rows = [expected_at[stamp] for stamp in found.stamps.tolist()]
    assert rows == list(range(1, len(rows) + 1))
    np.testing.assert_allclose(found.positions, expected.positions[rows], atol=1e-6)
    turn = (Rotation.from_quat(found.quaternions)
            * Rotation.from_quat(expected.quaternions[rows]).inv()).magnitude()
    assert turn.max() < 1e-6


def test_the_four_nodes_give_the_trajectory_of_the_command_line(drive, recorded):
    assert_same_trajectory(trajectory(recorded, drive.frames), drive.expected)


def test_all_in_one_gives_the_same_trajectory(drive, recorded_in_one):
    assert_same_trajectory(trajectory(recorded_in_one, drive.frames), drive.expected)


def test_the_recorded_odometry_is_near_the_truth(drive, recorded):
    ours = trajectory(recorded, drive.frames)
    found = evaluation.figures(evaluation.evaluate(ours, drive.truth))
    same = slice(1, 1 + len(ours))  # without the origin, which is no message
    expected = evaluation.figures(evaluation.evaluate(Trajectory(
        drive.expected.stamps[same], drive.expected.positions[same],
        drive.expected.quaternions[same]), drive.truth))
    assert found['ate_mean_percent'] < 3.0
    assert found['ate_mean_percent'] == pytest.approx(expected['ate_mean_percent'], rel=0.2)


def test_no_message_is_lost_between_the_nodes(recorded):
    pairs = messages(recorded, '/correspondences')
    stamps = sorted(pairs)
    assert [stamp_from_message(pairs[s].previous_stamp) for s in stamps[1:]] == stamps[:-1]
    for topic in ('/planes/observations', '/planes/map'):
        assert sorted(messages(recorded, topic)) == stamps, topic
    with_pose = [s for s, m in messages(recorded, '/planes/map').items()
                 if m.tracking in (TrackingStatus.OK, TrackingStatus.PREDICTED)]
    assert sorted(with_pose) == stamps[ENOUGH - 1:]  # the camera's height tells metres by then
    for topic in ('/odometry', '/pose', '/twist', '/obstacles', '/obstacles/points'):
        assert sorted(messages(recorded, topic)) == sorted(with_pose), topic


def test_the_transform_comes_before_the_odometry_of_its_stamp(recorded):
    pytest.importorskip('tf2_msgs')
    known = set()
    for raw, msg in recorded.messages(['/tf', '/odometry']):
        if raw.topic == '/tf':
            transform = msg.transforms[0]
            known.add(stamp_from_message(transform.header.stamp))
            assert (transform.header.frame_id, transform.child_frame_id) == ('odom', 'base_link')
        else:
            assert stamp_from_message(msg.header.stamp) in known


def test_clouds_are_what_costmap_and_collision_monitor_ask_for(recorded):
    """As docs/nav2.md has it: no cloud is older than source_timeout, none lacks its transform."""
    pytest.importorskip('tf2_msgs')
    known, stamps = set(), []
    with_pose = set(messages(recorded, '/odometry'))
    for raw, msg in recorded.messages(['/tf', '/obstacles/points']):
        if raw.topic == '/tf':
            known.add(stamp_from_message(msg.transforms[0].header.stamp))
            continue
        stamps.append(stamp_from_message(msg.header.stamp))
        assert stamps[-1] in known or stamps[-1] not in with_pose
        assert [(f.name, f.datatype) for f in msg.fields[:3]] == [(axis, 7) for axis in 'xyz']
        assert len(msg.data) == msg.row_step == msg.point_step * msg.width
        assert msg.header.frame_id == 'odom'
        points = np.frombuffer(msg.data, np.float32).reshape(msg.width, msg.point_step // 4)
        assert np.isfinite(points[:, :6]).all()
    assert np.diff(stamps).min() > 0
    assert np.diff(stamps).max() < SOURCE_TIMEOUT * 1e9


def test_covariances_are_sound(recorded):
    for msg in messages(recorded, '/odometry').values():
        for covariance in (msg.pose.covariance, msg.twist.covariance):
            values = np.linalg.eigvalsh(np.reshape(covariance, (6, 6)))
            assert values.min() > 0
            assert values.max() < 1e7


def test_odometry_points_forward_and_up(drive, recorded):
    found = list(messages(recorded, '/odometry').values())
    end = found[-1].pose.pose.position
    assert end.x > 0.9 * np.linalg.norm([end.x, end.y, end.z])
    speed = found[len(found) // 2].twist.twist.linear
    assert speed.x > 2.0
    assert abs(speed.z) < 0.3 * speed.x


def test_every_node_reports_its_state(recorded):
    names = {status.name for _, msg in recorded.messages(['/diagnostics'])
             for status in msg.status}
    assert names == set(FOUR)
