import made_up
from mv_slapse import fields
from mv_slapse.codec.source import open_source
from mv_slapse.config import Settings
from mv_slapse.errors import UnusableInput, UsageError
from mv_slapse.ros_frames import points_to_odom, Pose, pose_to_world, RosFrames
from mv_slapse.storage.bag_reader import BagReader
from mv_slapse.storage.camera_info import read_camera
from mv_slapse.storage.tum import read_trajectory, Trajectory
from mv_slapse.tools import bag as tool
from mv_slapse.tools.run import Options, run
import numpy as np
from numpy.testing import assert_allclose
import pytest
from scipy.spatial.transform import Rotation

START = 2_000_000_000


@pytest.fixture(scope='module')
def bag(clip, tmp_path_factory):
    path = tmp_path_factory.mktemp('bag') / 'bag'
    truth = read_trajectory(clip.truth / 'ground_truth.tum')
    content = tool.make_bag(clip.video, read_camera(clip.camera), truth, path, START)
    return BagReader(path), content


def test_a_bag_holds_packets_calibration_and_truth(bag):
    reader, content = bag
    assert (content.packets, content.true_poses, content.camera_infos) == (21, 21, 2)
    assert reader.counts == {tool.VIDEO_TOPIC: 21, tool.CAMERA_TOPIC: 2, tool.TRUTH_TOPIC: 21}


def test_packets_are_those_of_the_file_with_shifted_stamps(clip, bag):
    with open_source(clip.video) as source:
        expected = [(packet.stamp + START, packet.is_key, packet.codec, packet.data)
                    for packet in source.packets()]
    found = [(p.stamp, p.is_key, p.codec, p.data) for p in bag[0].packets(tool.VIDEO_TOPIC)]
    assert found == expected


def test_messages_count_packets_and_name_the_frame(bag):
    messages = [msg for _, msg in bag[0].messages([tool.VIDEO_TOPIC])]
    assert [msg.pts for msg in messages] == list(range(21))
    assert {(msg.header.frame_id, msg.width, msg.height, msg.encoding) for msg in messages} == {
        ('camera_optical', 480, 352, 'mpeg2video')}
    assert messages[0].flags == 1


def test_a_calibration_comes_before_the_first_packet(bag):
    order = [raw.topic for raw, _ in bag[0].messages([tool.VIDEO_TOPIC, tool.CAMERA_TOPIC])]
    assert order[0] == tool.CAMERA_TOPIC


def test_nothing_is_sent_before_its_picture_is_taken(bag):
    for raw, msg in bag[0].messages(bag[0].topics):
        assert raw.stamp >= fields.stamp_from_message(msg.header.stamp)


def test_true_poses_are_in_odom(clip, bag):
    truth = read_trajectory(clip.truth / 'ground_truth.tum')
    messages = [msg for _, msg in bag[0].messages([tool.TRUTH_TOPIC])]
    for k in (0, 7, 20):
        pose = messages[k].pose
        q = pose.orientation
        back = pose_to_world(Pose(Rotation.from_quat([q.x, q.y, q.z, q.w]).as_matrix(),
                                  np.array([pose.position.x, pose.position.y, pose.position.z])),
                             RosFrames())
        assert_allclose(back.t, truth.positions[k], atol=1e-8)
        assert_allclose(back.R, truth.rotations()[k], atol=1e-7)
    assert messages[-1].pose.position.x > 5  # the street is driven forwards
    assert messages[0].header.frame_id == 'odom'


def test_the_first_true_pose_is_the_origin_of_odom(clip, rng, tmp_path):
    truth = read_trajectory(clip.truth / 'ground_truth.tum')
    R, t = made_up.rotation(rng), rng.normal(size=3)
    elsewhere = Trajectory(truth.stamps, truth.positions @ R.T + t, (
        Rotation.from_matrix(R) * Rotation.from_quat(truth.quaternions)).as_quat())
    tool.make_bag(clip.video, read_camera(clip.camera), elsewhere, tmp_path / 'bag')
    x = [[(p := msg.pose.position).x, p.y, p.z]
         for _, msg in BagReader(tmp_path / 'bag').messages([tool.TRUTH_TOPIC])]
    expected = points_to_odom(truth.positions - truth.positions[0], RosFrames())
    assert_allclose(x, expected, atol=1e-7)


def test_a_run_on_the_bag_equals_the_run_on_the_file(clip, bag, tmp_path):
    camera = read_camera(clip.camera)
    run(clip.video, camera, Settings(), tmp_path / 'file',
        Options(max_frames=12))
    run(bag[0]._path, None, Settings(), tmp_path / 'bag', Options(max_frames=12))
    a, b = (read_trajectory(tmp_path / name / 'trajectory.tum') for name in ('file', 'bag'))
    np.testing.assert_array_equal(a.stamps + START, b.stamps)
    np.testing.assert_array_equal(a.positions, b.positions)


def test_a_bag_can_be_shorter_than_its_video(clip, tmp_path):
    truth = read_trajectory(clip.truth / 'ground_truth.tum')
    content = tool.make_bag(clip.video, read_camera(clip.camera), truth, tmp_path / 'b',
                            max_frames=7)
    assert (content.packets, content.true_poses) == (7, 7)


def test_what_cannot_become_a_bag_is_refused_and_leaves_none(clip, data, tmp_path):
    camera = read_camera(data / 'kitti00' / 'camera.yaml')
    with pytest.raises(UnusableInput, match='480x352.*1240x376'):
        tool.make_bag(clip.video, camera, None, tmp_path / 'b')
    assert not (tmp_path / 'b').exists()
    with pytest.raises(UsageError, match='exists already'):
        tool.make_bag(clip.video, read_camera(clip.camera), None, tmp_path)
