"""Scenes, and all that a key frame gives, as another {W} sees them."""

from dataclasses import replace
from typing import Any

from mv_slapse import ros_frames
from mv_slapse.geometry.rotation import skew
from mv_slapse.records import MapPlane, Obstacle, PlaneHandover, SceneEstimate
from mv_slapse.ros_frames import Pose, RosFrames
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


def step_in(step: Any, other_from_world: Pose) -> Any:
    """Return a ``pipeline.Step`` in another {W}, in which its own is known by a pose.

    That pose's error adds to that of the camera's poses, as it is the same for all of them.
    """
    # With optical axes for the base what maps {W} to odom maps it to the other {W}.
    frames = RosFrames('', '', '', np.eye(3), np.zeros(3), other_from_world.R, other_from_world.t)
    scene = in_frames(step.scene, frames, RosFrames(
        '', '', '', np.eye(3), np.zeros(3)))
    arm = np.eye(6)
    arm[:3, 3:] = -skew(scene.t_world_from_cam - other_from_world.t)
    widened = scene.pose_covariance + arm @ other_from_world.covariance @ arm.T
    return replace(
        step, scene=replace(scene, pose_covariance=widened),
        obstacles=tuple(_obstacle(obstacle, frames) for obstacle in step.obstacles),
        handovers=tuple(_handover(handover, frames) for handover in step.handovers))


def _obstacle(obstacle: Obstacle, frames: RosFrames) -> Obstacle:
    return replace(
        obstacle, plane=ros_frames.plane_to_odom(obstacle.plane, frames),
        position=ros_frames.points_to_odom(obstacle.position, frames),
        velocity=ros_frames.vectors_to_odom(obstacle.velocity, frames),
        covariance=ros_frames.state_covariance_to_odom(obstacle.covariance, frames),
        outline=ros_frames.points_to_odom(obstacle.outline, frames))


def _handover(handover: PlaneHandover, frames: RosFrames) -> PlaneHandover:
    return replace(
        handover, plane=ros_frames.plane_to_odom(handover.plane, frames),
        velocity=ros_frames.vectors_to_odom(handover.velocity, frames),
        covariance=ros_frames.plane_velocity_covariance_to_odom(
            handover.plane, handover.covariance, frames))


def _plane(plane: MapPlane, frames: RosFrames, others: RosFrames) -> MapPlane:
    normal, depth, covariance = ros_frames.normal_depth_to_odom(*ros_frames.normal_depth_to_odom(
        plane.normal, plane.depth, plane.covariance, frames), others.inverse())
    outline = ros_frames.points_to_world(ros_frames.points_to_odom(plane.outline, frames), others)
    return replace(plane, normal=normal, depth=depth, covariance=covariance, outline=outline)
