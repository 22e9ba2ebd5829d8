"""Scenes as another {W} sees them; free of ROS."""

from dataclasses import replace

from mv_slapse.geometry import ros_frames
from mv_slapse.geometry.ros_frames import Pose, RosFrames
from mv_slapse.records import MapPlane, SceneEstimate
import numpy as np


def in_frames(scene: SceneEstimate, frames: RosFrames, others: RosFrames) -> SceneEstimate:
    """Return a scene, given in the {W} of ``frames``, in the {W} of others with the same odom."""
    if np.array_equal(frames.R_odom_from_start, others.R_odom_from_start) and np.array_equal(
            frames.t_odom_from_start, others.t_odom_from_start):
        return scene
    pose = ros_frames.pose_to_world(ros_frames.pose_to_odom(Pose(
        scene.R_world_from_cam, scene.t_world_from_cam, scene.pose_covariance), frames), others)
    turn = np.eye(6)
    turn[:3, :3] = others.R_odom_from_world.T @ frames.R_odom_from_world
    return replace(
        scene, R_world_from_cam=pose.R, t_world_from_cam=pose.t, pose_covariance=pose.covariance,
        velocity_world=turn[:3, :3] @ scene.velocity_world,
        twist_covariance=turn @ scene.twist_covariance @ turn.T,
        planes=tuple(_plane(plane, frames, others) for plane in scene.planes))


def _plane(plane: MapPlane, frames: RosFrames, others: RosFrames) -> MapPlane:
    normal, depth, covariance = ros_frames.normal_depth_to_odom(*ros_frames.normal_depth_to_odom(
        plane.normal, plane.depth, plane.covariance, frames), others.inverse())
    outline = ros_frames.points_to_world(ros_frames.points_to_odom(plane.outline, frames), others)
    return replace(plane, normal=normal, depth=depth, covariance=covariance, outline=outline)
