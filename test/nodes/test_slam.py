from contextlib import suppress
from dataclasses import replace
from pathlib import Path

import pytest

pytest.importorskip('rclpy')
pytest.importorskip('mv_slapse_msgs')

from geometry_msgs.msg import PoseWithCovarianceStamped, TwistWithCovarianceStamped  # noqa: E402
import made_up  # noqa: E402
from mv_slapse import fields, view_fields  # noqa: E402
from mv_slapse.config import SceneSettings  # noqa: E402
from mv_slapse.nodes.conversions import stamp_to_msg, to_message  # noqa: E402
from mv_slapse.nodes.placement import Placement  # noqa: E402
from mv_slapse.nodes.scene_output import SceneOutput  # noqa: E402
from mv_slapse.nodes.shell import Shell  # noqa: E402
from mv_slapse.nodes.slam import SlamNode  # noqa: E402
from mv_slapse.records import Label, MapPlane, Speed, TrackingStatus  # noqa: E402
from mv_slapse.ros_frames import R_BODY_FROM_OPTICAL, RosFrames  # noqa: E402
from mv_slapse.scene.filter import SceneFilter  # noqa: E402
from mv_slapse_msgs.msg import PlaneHandover, PlaneMap, PlaneObservations  # noqa: E402
from nav_msgs.msg import Odometry  # noqa: E402
from nav_msgs.msg import Path as PathMsg
from nodes import drives  # noqa: E402
from nodes.bench import BEST_EFFORT, LATCHED, messages_of, value_of  # noqa: E402
import numpy as np  # noqa: E402
from std_srvs.srv import Trigger  # noqa: E402
from visualization_msgs.msg import Marker, MarkerArray  # noqa: E402

N = 4  # poses
PAIRS = N + drives.WITHOUT_POSE
PARAMETERS = {'scene__camera_height': drives.HEIGHT, 'tf_wait': 0.0}


class Output(Shell):
    def __init__(self, **kwargs):
        super().__init__('slam', **kwargs)
        self.output, self.placement = SceneOutput(self), Placement(self)

    def publish(self, scene):
        self.output.publish(scene, RosFrames(), self.placement)


def feed(bench, n=PAIRS, later=0.0):
    publisher = bench.advertise(PlaneObservations, 'planes/observations')
    for step in drives.steps(n):
        publisher.publish(observations(step.extraction, later))
    return publisher


def observations(extraction, later=0.0):
    """Return the message of an extraction, some seconds later."""
    ns = round(later * 1e9)
    extraction = replace(extraction, stamp=extraction.stamp + ns,
                         previous_stamp=extraction.previous_stamp + ns)
    return to_message(PlaneObservations, fields.extraction_to_fields(
        extraction, RosFrames(camera='cam')))


def position(msg):
    p = msg.pose.pose.position
    return np.array([p.x, p.y, p.z])


def expected_positions(n=PAIRS):
    """Return where the base is in odom, which stands on the ground."""
    return np.array([pose.t for pose in drives.in_odom([step.scene for step in drives.steps(n)])])


def test_observations_give_the_poses_and_the_map_of_the_filter(bench):
    odometry = bench.listen(Odometry, 'odometry')
    poses = bench.listen(PoseWithCovarianceStamped, 'pose')
    twists = bench.listen(TwistWithCovarianceStamped, 'twist')
    maps = bench.listen(PlaneMap, 'planes/map', LATCHED)
    bench.start(SlamNode, **PARAMETERS)
    feed(bench)
    assert bench.spin(lambda: len(odometry) == N and len(maps) == PAIRS and len(twists) == N, 30)
    np.testing.assert_allclose([position(m) for m in odometry], expected_positions(), atol=1e-9)
    assert [m.pose for m in poses] == [m.pose for m in odometry]
    assert odometry[0].header.frame_id == maps[0].header.frame_id == 'odom'
    assert odometry[0].child_frame_id == twists[0].header.frame_id == 'base_link'
    scene = drives.steps(PAIRS)[-1].scene
    assert [p.id for p in maps[-1].planes] == [p.id for p in scene.planes]
    velocity = odometry[-1].twist.twist.linear
    forward = scene.R_world_from_cam.T @ scene.velocity_world
    assert velocity.x == pytest.approx(forward[2])


def test_the_transform_is_the_pose(bench):
    tf2_msgs = pytest.importorskip('tf2_msgs.msg')
    transforms = bench.listen(tf2_msgs.TFMessage, '/tf')
    odometry = bench.listen(Odometry, 'odometry')
    bench.start(SlamNode, odom_frame='o', base_frame='b', **PARAMETERS)
    feed(bench)
    assert bench.spin(lambda: len(odometry) == N and len(transforms) == N, 30)
    for msg, pose in zip(transforms, odometry, strict=True):
        transform = msg.transforms[0]
        assert transform.header == pose.header
        assert (transform.header.frame_id, transform.child_frame_id) == ('o', 'b')
        t = transform.transform.translation
        np.testing.assert_array_equal([t.x, t.y, t.z], position(pose))
        assert transform.transform.rotation == pose.pose.pose.orientation


def test_the_pose_is_that_of_the_base_where_the_camera_has_a_place_on_it(bench):
    odometry = bench.listen(Odometry, 'odometry')
    place = [1.0, 0.0, 1.6, -0.5, 0.5, -0.5, 0.5]
    bench.start(SlamNode, base_from_camera=place, **PARAMETERS)
    feed(bench)
    assert bench.spin(lambda: len(odometry) == N, 30)
    scene = drives.steps(PAIRS)[-1].scene
    R = R_BODY_FROM_OPTICAL @ scene.R_world_from_cam @ R_BODY_FROM_OPTICAL.T
    camera_in_odom = position(odometry[-1]) + R @ place[:3]
    t = scene.t_world_from_cam  # x forward is z of {W}, y left is -x, z up is -y
    np.testing.assert_allclose(camera_in_odom, [t[2] + 1.0, -t[0], 1.6 - t[1]], atol=1e-9)


def test_trajectory_and_map_are_saved_where_the_parameter_says(bench, tmp_path):
    odometry = bench.listen(Odometry, 'odometry')
    bench.start(SlamNode, output_directory=str(tmp_path / 'saved'), **PARAMETERS)
    feed(bench)
    assert bench.spin(lambda: len(odometry) == N, 30)
    response = bench.call(Trigger, '/slam/save_trajectory')
    assert response.success
    rows = np.loadtxt(Path(response.message))
    np.testing.assert_allclose(rows[0], [0, 0, 0, 0, 0, 0, 0, 1])
    np.testing.assert_allclose(rows[1:, 1:4], [step.scene.t_world_from_cam
                                               for step in drives.steps(PAIRS)[-N:]], atol=1e-8)
    assert rows[0, 0] == drives.steps(1)[0].extraction.previous_stamp / 1e9
    assert bench.call(Trigger, '/slam/save_map').success
    assert (tmp_path / 'saved' / 'map.json').read_text().startswith('{')


def test_a_folder_that_cannot_be_written_is_said(bench, tmp_path):
    (tmp_path / 'file').write_text('')
    odometry = bench.listen(Odometry, 'odometry')
    bench.start(SlamNode, output_directory=str(tmp_path / 'file'), **PARAMETERS)
    feed(bench)
    assert bench.spin(lambda: len(odometry) == N, 30)
    response = bench.call(Trigger, '/slam/save_map')
    assert not response.success
    assert 'output_directory' in response.message


def test_a_file_that_cannot_be_written_is_said(bench, tmp_path):
    odometry = bench.listen(Odometry, 'odometry')
    bench.start(SlamNode, output_directory=str(tmp_path), **PARAMETERS)
    feed(bench)
    assert bench.spin(lambda: len(odometry) == N, 30)
    for name in ('map.json.part', 'trajectory.tum.part'):
        (tmp_path / name).mkdir()
    for service in ('save_map', 'save_trajectory'):
        response = bench.call(Trigger, f'/slam/{service}')
        assert not response.success
        assert 'output_directory' in response.message


def test_a_full_disk_costs_the_trajectory_to_save_and_no_pose(bench, tmp_path, monkeypatch):
    odometry = bench.listen(Odometry, 'odometry')
    node = bench.start(SlamNode, output_directory=str(tmp_path), **PARAMETERS)
    with suppress(OSError), Path('/dev/full').open('w', buffering=1) as full:
        monkeypatch.setattr(node._archive._rows, '_file', full)
        feed(bench)
        assert bench.spin(lambda: len(odometry) == N, 30)
        response = bench.call(Trigger, '/slam/save_trajectory')
    assert not response.success
    assert 'No space left' in response.message
    assert not (tmp_path / 'trajectory.tum').exists()
    assert value_of(node, 'faults') == ''


def test_nothing_to_save_is_said_and_no_file_is_left(bench, tmp_path):
    bench.start(SlamNode, output_directory=str(tmp_path / 'saved'), **PARAMETERS)
    for service, missing in (('save_map', 'no plane'), ('save_trajectory', 'no pose')):
        response = bench.call(Trigger, f'/slam/{service}')
        assert not response.success
        assert response.message.startswith('nothing to save: there is ' + missing)
    assert not (tmp_path / 'saved').exists()


def test_reset_begins_a_new_trajectory(bench):
    odometry = bench.listen(Odometry, 'odometry')
    bench.start(SlamNode, **PARAMETERS)
    feed(bench)
    assert bench.spin(lambda: len(odometry) == N, 30)
    assert bench.call(Trigger, '/slam/reset').success
    feed(bench)
    assert bench.spin(lambda: len(odometry) == 2 * N, 30)
    np.testing.assert_allclose(position(odometry[-1]), position(odometry[N - 1]), atol=1e-9)


def test_a_bag_played_again_begins_a_new_trajectory(bench):
    odometry = bench.listen(Odometry, 'odometry')
    node = bench.start(SlamNode, **PARAMETERS)
    feed(bench, later=2.0)
    feed(bench)
    assert bench.spin(lambda: len(odometry) == 2 * N, 30)
    np.testing.assert_allclose(position(odometry[-1]), position(odometry[N - 1]), atol=1e-9)
    assert node.resets == 1


def test_a_clock_that_is_set_a_little_back_begins_nothing_anew(bench):
    odometry = bench.listen(Odometry, 'odometry')
    node = bench.start(SlamNode, **PARAMETERS)
    publisher = feed(bench)
    assert bench.spin(lambda: len(odometry) == N, 30)
    publisher.publish(observations(drives.steps(PAIRS + 1)[-1].extraction, later=-0.3))
    assert bench.spin(lambda: len(odometry) == N + 1, 30)
    assert node.resets == 0
    np.testing.assert_allclose(position(odometry[-1]), expected_positions(PAIRS + 1)[-1], atol=0.1)


@pytest.mark.parametrize('status', [TrackingStatus.LOST, TrackingStatus.INITIALISING])
def test_without_a_pose_only_the_map_goes_out_and_says_why(bench, status):
    odometry, maps = bench.listen(Odometry, 'odometry'), bench.listen(PlaneMap, 'planes/map')
    node = bench.start(Output)
    assert bench.spin(lambda: bench.peer.count_publishers('/odometry'))
    bench.spin(lambda: False, 0.3)
    scene = made_up.scene(np.random.default_rng(0), status=status)
    node.publish(scene)
    assert bench.spin(lambda: maps)
    bench.spin(lambda: False, 0.2)
    assert odometry == []
    assert (maps[0].tracking, maps[0].reason) == (status, 'why')
    assert f'{status.name.lower()}: why' in messages_of(node)
    assert (node.health.status().level == b'\x02') == (status == TrackingStatus.LOST)


def test_a_plane_handed_over_by_the_tracker_takes_effect_at_the_next_key_frame(bench):
    maps = bench.listen(PlaneMap, 'planes/map', LATCHED)
    bench.start(SlamNode, **PARAMETERS)
    handovers = bench.advertise(PlaneHandover, 'planes/handover')
    record = made_up.handover(np.random.default_rng(0), drives.steps(PAIRS)[1].scene.stamp)
    record = replace(record, id=77, to_label=Label.STATIONARY, plane=np.array([0, 0, -0.05]),
                     velocity=np.zeros(3), covariance=1e-6 * np.eye(6))
    handovers.publish(to_message(PlaneHandover, fields.handover_to_fields(record, RosFrames())))
    bench.spin(lambda: False, 0.3)
    feed(bench)
    assert bench.spin(lambda: len(maps) == PAIRS, 30)
    has_joined = [77 in [plane.id for plane in msg.planes] for msg in maps]
    assert has_joined == [False] * 2 + [True] * 4


def test_where_a_message_was_lost_the_robot_does_as_a_replay_of_the_rest(bench):
    odometry = bench.listen(Odometry, 'odometry')
    node = bench.start(SlamNode, **PARAMETERS)
    publisher = bench.advertise(PlaneObservations, 'planes/observations')
    steps = drives.steps(8)
    rest = [step.extraction for step in [*steps[:4], *steps[5:]]]
    # The depths of the pair that follows are compared with those of the one that was lost.
    assert np.isfinite(rest[4].baseline_ratio_sigma)
    for extraction in rest:
        publisher.publish(to_message(PlaneObservations, fields.extraction_to_fields(
            extraction, RosFrames(camera='cam'))))
    assert bench.spin(lambda: len(odometry) == 7 - drives.WITHOUT_POSE, 30)
    filter_ = SceneFilter(SceneSettings(camera_height=drives.HEIGHT))
    replayed = drives.in_odom([filter_.step(extraction)[0] for extraction in rest])
    np.testing.assert_allclose([position(msg) for msg in odometry],
                               [pose.t for pose in replayed], atol=1e-5)
    np.testing.assert_allclose(position(odometry[-1]), expected_positions(8)[-1], atol=0.15)
    assert 'gaps' in str(node.health.status().values)


def wheel_odometry(stamp, forward):
    msg = Odometry()
    msg.header.stamp = stamp_to_msg(stamp)
    msg.twist.twist.linear.x = forward
    return msg


def drive_with_wheels(bench, offset=0):
    """Feed the drive after speeds at its key frames; return its node, odometry and map."""
    received = bench.listen(Odometry, 'odometry'), bench.listen(PlaneMap, 'planes/map')
    node = bench.start(SlamNode, tf_wait=0.0)
    publisher = bench.advertise(Odometry, 'wheel_odometry', BEST_EFFORT)
    speeds = [Speed(extraction.stamp, 7.5) for extraction in extractions()]
    for speed in [Speed(extractions()[0].previous_stamp, 7.5), *speeds]:
        publisher.publish(wheel_odometry(speed.stamp + offset, speed.value))
    assert bench.spin(lambda: 'messages on wheel_odometry' in str(node.health.status().values))
    bench.spin(lambda: False, 0.3)
    feed(bench)
    assert bench.spin(lambda: len(received[0]) == len(received[1]) == PAIRS, 30)
    return node, speeds, *received


def extractions():
    return [step.extraction for step in drives.steps(PAIRS)]


def test_the_speed_of_wheels_makes_the_scale_metric_as_in_a_replay(bench):
    _, speeds, odometry, maps = drive_with_wheels(bench)
    filter_ = SceneFilter(SceneSettings())
    first = Speed(extractions()[0].previous_stamp, 7.5)
    replayed = [filter_.step(extraction, (), [first, speed] if i == 0 else [speed])[0]
                for i, (extraction, speed) in enumerate(zip(extractions(), speeds, strict=True))]
    np.testing.assert_allclose([position(msg) for msg in odometry],
                               [pose.t for pose in drives.in_odom(replayed)], atol=1e-9)
    assert {(msg.scale_status, msg.scale_source) for msg in maps} == {(1, 'speed')}


def test_wheels_of_another_clock_are_not_used_and_it_is_said(bench):
    node, _, _, maps = drive_with_wheels(bench, offset=10**12)
    assert maps[-1].scale_status == 0
    assert 'stamp both with one clock' in messages_of(node)


def test_the_path_is_bounded(bench):
    paths = bench.listen(PathMsg, 'path')
    bench.start(SlamNode, path_length=3, path_period=0.0, **PARAMETERS)
    feed(bench)
    assert bench.spin(lambda: len(paths) == N, 30)
    assert [len(path.poses) for path in paths] == [1, 2, 3, 3]


def test_markers_are_made_for_who_looks_also_once_nothing_comes_any_more(bench, monkeypatch):
    made = []
    show = view_fields.MarkerBoard.show
    monkeypatch.setattr(view_fields.MarkerBoard, 'show', lambda *args: (
        made.append(args[1]) or show(*args)))
    node = bench.start(Output)
    stamps = 10**10, 2 * 10**10  # far more than a second apart
    for stamp in stamps:
        node.publish(made_up.scene(np.random.default_rng(0), stamp=stamp))
    bench.spin(lambda: made, 1.5)
    assert made == []
    arrays = bench.listen(MarkerArray, 'planes/map_markers', LATCHED)
    assert bench.spin(lambda: arrays)
    assert made == [stamps[-1]]
    assert arrays[0].markers[0].header.stamp.sec == 20
    bench.spin(lambda: len(arrays) > 1, 1.5)
    assert len(arrays) == 1


def test_nobody_is_asked_for_what_is_held_back_once_it_has_passed(bench):
    node = bench.start(SlamNode, **PARAMETERS)
    timer, = (t for t in node.timers if t.timer_period_ns == 100_000_000)
    bench.spin(timer.is_canceled, 0.3)
    assert not timer.is_canceled()
    feed(bench, 1)
    assert bench.spin(timer.is_canceled)


def test_markers_of_planes_that_left_the_map_are_deleted(bench):
    arrays = bench.listen(MarkerArray, 'planes/map_markers', LATCHED)
    node = bench.start(Output)
    scene = made_up.scene(np.random.default_rng(0))
    node.publish(scene)
    assert bench.spin(lambda: len(arrays) == 1)
    shown = arrays[0].markers[0]
    assert (shown.ns, shown.id, shown.action) == ('planes', 7, Marker.ADD)
    assert len(shown.points) == 6  # an outline of four corners is two triangles
    other = MapPlane(**{**vars(scene.planes[0]), 'id': 8})
    node.publish(replace(scene, planes=(other,)))
    assert bench.spin(lambda: len(arrays) == 2)
    assert [(m.id, m.action) for m in arrays[1].markers] == [(8, Marker.ADD), (7, Marker.DELETE)]
    assert all(m.pose.orientation.w == 1.0 for array in arrays for m in array.markers)


def test_a_publisher_that_does_not_fit_hinders_nothing_where_another_one_does(bench):
    node = bench.start(SlamNode, tf_wait=0.0)
    good = bench.advertise(PlaneObservations, 'planes/observations')
    good.publish(PlaneObservations())
    assert bench.spin(lambda: value_of(node, 'rejected on planes/observations'))
    bench.peer.create_publisher(PlaneObservations, 'planes/observations', BEST_EFFORT)
    assert not bench.spin(lambda: 'qos' in str(node.health.status().values), 1.0)
