"""A level ``odom``: where nothing is known of the base, the ground tells how the camera is held.

A camera without extrinsics is taken as the base, and it looks down by some degrees. Were odom's x
where the camera looked at first, the ground would rise by 17 m in 100 m at 10 degrees, and
planners drop what is higher than the robot.
"""

from collections.abc import Iterable
from dataclasses import replace
from typing import Any

from mv_slapse import fields
from mv_slapse import message_checks as check
from mv_slapse.field_values import read_xyz
from mv_slapse.geometry import rotation
from mv_slapse.quaternion import to_matrix
from mv_slapse.records import MapPlane
from mv_slapse.ros_frames import RosFrames
import numpy as np

START = '_start'  # what the name of {W}, the first key frame's camera, ends with on /tf_static
STEEPEST = 0.1  # least cosine between the ground's normal and the camera's up: a wall is no ground


def levelled(frames: RosFrames, planes: Iterable[MapPlane]) -> RosFrames:
    """Return frames whose odom stands on the ground below the base at its start, z being up.

    Its x is where the base looks, as seen from above. ``planes`` are in {W}, that of the first
    key frame; without a ground among them the frames stay as they are.
    """
    ground = next((plane for plane in planes if plane.is_ground), None)
    if ground is None:
        return frames
    up, z = frames.R_base_from_cam @ ground.normal, np.array([0.0, 0.0, 1.0])
    if up @ z < STEEPEST:
        return frames
    turn = rotation.skew(np.cross(up, z))
    R = np.eye(3) + turn + turn @ turn / (1 + up @ z)
    height = ground.depth - up @ frames.t_base_from_cam
    return replace(frames, R_odom_from_start=R, t_odom_from_start=np.array([0.0, 0.0, height]))


def start_to_fields(stamp: int, frames: RosFrames) -> fields.Fields:
    """Return geometry_msgs/TransformStamped odom -> {W}, for /tf_static."""
    return fields.camera_transform_to_fields(stamp, RosFrames(
        base=frames.odom, camera=frames.camera + START, R_base_from_cam=frames.R_odom_from_world,
        t_base_from_cam=frames.t_odom_from_world))


def frames_from_transforms(transforms: Iterable[Any]) -> RosFrames:
    """Return the frames of a run without extrinsics by the messages of its /tf_static.

    Where they do not say where {W} lies it lies in the origin of odom.
    """
    frames = RosFrames()
    for one in transforms:
        if one.child_frame_id.endswith(START):
            R = to_matrix(check.quaternion(one.transform.rotation, 'rotation'))
            return replace(frames, R_odom_from_start=R @ frames.R_base_from_cam.T,
                           t_odom_from_start=read_xyz(one.transform.translation, 'translation'))
    return frames
