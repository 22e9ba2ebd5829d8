"""odom stands level on the ground where that is all that tells how the camera is held."""

from types import SimpleNamespace

from mv_slapse import level
from mv_slapse.records import MapPlane
from mv_slapse.ros_frames import points_to_odom, Pose, pose_to_odom, RosFrames
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

HEIGHT, PITCH, ROLL = 1.65, np.deg2rad(10), np.deg2rad(-3)
# A level camera's axes in those of one that looks down and leans.
R_CAM_FROM_LEVEL = Rotation.from_euler('xz', [PITCH, ROLL]).as_matrix()


def plane(normal, depth, is_ground=True):
    return MapPlane(3, np.array(normal), depth, np.eye(4), np.zeros((3, 3)), 0, 0, 1, 1,
                    is_ground)


GROUND = plane(R_CAM_FROM_LEVEL @ (0, -1, 0), HEIGHT)


def on_the_ground(x, y):
    """Return points of {W} on the road: right of and before the camera, as seen from above."""
    return np.c_[x, np.full(len(x), HEIGHT), y] @ R_CAM_FROM_LEVEL.T


def test_the_ground_is_where_z_is_0_and_the_base_stands_above_it():
    frames = level.levelled(RosFrames(), [plane((0.0, 0, -1), 9, False), GROUND])
    x, y = np.array([-3.0, 0.0, 4.0]), np.array([5.0, 100.0, 20.0])
    found = points_to_odom(on_the_ground(x, y), frames)
    np.testing.assert_allclose(found[:, 2], 0, atol=1e-9)
    pose = pose_to_odom(Pose(np.eye(3), np.zeros(3)), frames)
    np.testing.assert_allclose(pose.t, [0, 0, HEIGHT], atol=1e-12)
    # the base looks down: its x falls by the sine of the pitch, and it has not turned to a side
    assert pose.R[2, 0] == pytest.approx(-np.sin(PITCH), abs=5e-3)
    np.testing.assert_allclose(np.linalg.norm(found, axis=1), np.hypot(x, y), atol=1e-9)
    ahead = np.array([1.0, 0, 0]) - pose.R[:, 0]
    assert abs(ahead[1]) < 5e-3


def test_a_camera_above_the_base_is_taken_off_the_height():
    above = RosFrames(t_base_from_cam=np.array([0.0, 0, 0.4]))
    level_ground = plane((0.0, -1, 0), HEIGHT)
    frames = level.levelled(above, [level_ground])
    np.testing.assert_allclose(frames.R_odom_from_start, np.eye(3), atol=1e-12)
    assert frames.t_odom_from_start[2] == pytest.approx(HEIGHT - 0.4)


@pytest.mark.parametrize('planes', [[], [plane((0.0, -1, 0), 2.0, False)],
                                    [plane((0.0, 0, -1), 2.0)]])
def test_without_a_ground_that_can_be_one_nothing_changes(planes):
    frames = RosFrames()
    assert level.levelled(frames, planes) is frames


def test_messages_tell_where_the_first_camera_is_in_odom():
    frames = level.levelled(RosFrames(), [GROUND])
    fields = level.start_to_fields(7, frames)
    assert (fields['header']['frame_id'], fields['child_frame_id']) == (
        'odom', 'camera_optical_start')
    msg = SimpleNamespace(child_frame_id=fields['child_frame_id'], transform=SimpleNamespace(
        **{name: SimpleNamespace(**value) for name, value in fields['transform'].items()}))
    found = level.frames_from_transforms([SimpleNamespace(child_frame_id='other'), msg])
    np.testing.assert_allclose(found.R_odom_from_start, frames.R_odom_from_start, atol=1e-12)
    np.testing.assert_allclose(found.t_odom_from_start, frames.t_odom_from_start, atol=1e-12)
    assert found.camera == 'camera_optical'
    nothing = level.frames_from_transforms([])
    np.testing.assert_array_equal(nothing.R_odom_from_start, np.eye(3))
