"""What the nodes would publish in a run, as one MCAP file."""

from collections import deque
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any, Protocol

from mv_slapse import fields, planner_fields, view_fields
from mv_slapse.codec.packet import Packet
from mv_slapse.geometry.camera import Camera
from mv_slapse.level import levelled, start_to_fields
from mv_slapse.plane_messages import PlaneMessages
from mv_slapse.records import (
    Correspondences,
    Extraction,
    Obstacle,
    PlaneHandover,
    SceneEstimate,
    WITH_POSE,
)
from mv_slapse.ros_frames import RosFrames
from mv_slapse.step_diagnostics import StepDiagnostics
from mv_slapse.storage import messages
from mv_slapse.storage.bag_writer import McapFile
from mv_slapse.video_messages import (
    compressed_to_fields,
    COMPRESSED_VIDEO,
    FFMPEG_PACKET,
    packet_to_fields,
)

MAP_PLANE = 'mv_slapse_msgs/msg/MapPlane'
POSE = 'geometry_msgs/msg/PoseStamped'
MARKERS = 'visualization_msgs/msg/MarkerArray'
VIDEO = '/video'
PATH_LENGTH = 1000  # poses of a path
SLOW = 1_000_000_000  # [ns] between two paths or markers of planes: their cost grows with the way


class Step(Protocol):
    """What the pipeline returns for a key frame pair."""

    correspondences: Correspondences
    extraction: Extraction
    scene: SceneEstimate
    obstacles: Sequence[Obstacle]
    handovers: Sequence[PlaneHandover]


class MessageLog:
    """The messages that the nodes would publish, in one MCAP file."""

    def __init__(self, path: Path, frames: RosFrames, camera: Camera | None = None):
        """Make the file; the camera's calibration goes to its beginning."""
        self._camera = camera
        self._bag, self._frames = McapFile(path), frames
        self._surfaces = view_fields.MarkerBoard(frames.odom)
        self._obstacles = view_fields.MarkerBoard(frames.odom)
        self._poses: deque[Any] = deque(maxlen=PATH_LENGTH)
        self._path_due = self._surfaces_due = self._packets = 0
        self._planes = PlaneMessages(partial(messages.to_message, MAP_PLANE))
        self._diagnostics = StepDiagnostics()
        self._began: tuple[int, int] | None = None  # resets, and the stamp of the last [ns]

    def close(self):
        """Complete the file."""
        self._bag.close()

    def write_packet(self, packet: Packet, size: tuple[int, int]):
        """Write a packet of the video, so that the file can be run or played again.

        H.264 as the type that Foxglove shows.
        """
        self._write_camera(packet.stamp)
        frame, is_shown = self._frames.camera, packet.codec == 'h264'
        self._bag.write(VIDEO, COMPRESSED_VIDEO if is_shown else FFMPEG_PACKET, (
            compressed_to_fields(packet, frame) if is_shown
            else packet_to_fields(packet, size, self._packets, frame)), packet.stamp)
        self._packets += 1

    def _write_camera(self, stamp: int):
        if self._camera:
            self._bag.write('/camera_info', 'sensor_msgs/msg/CameraInfo', fields.camera_to_fields(
                self._camera, stamp, self._frames.camera), stamp, True)
            self._camera = None

    def write(self, step: Step):
        """Write the messages of a key frame pair, the transform before what needs it."""
        scene, stamp, put = step.scene, step.scene.stamp, self._bag.write
        self._write_camera(stamp)
        if self._began is None or self._began[0] != scene.resets:
            self._began = scene.resets, stamp
        if scene.status in WITH_POSE:
            self._write_pose(scene)
        frames = self._frames
        put('/correspondences', 'mv_slapse_msgs/msg/Correspondences',
            fields.correspondences_to_fields(step.correspondences, frames), stamp)
        put('/planes/observations', 'mv_slapse_msgs/msg/PlaneObservations',
            fields.extraction_to_fields(step.extraction, frames), stamp)
        put('/planes/map', 'mv_slapse_msgs/msg/PlaneMap',
            self._planes.map_fields(scene, frames, *self._began), stamp, True)
        put('/obstacles', 'mv_slapse_msgs/msg/ObstacleArray',
            fields.obstacles_to_fields(stamp, step.obstacles, scene.scale_status, frames), stamp)
        sure = planner_fields.sure(step.obstacles)
        put('/obstacles/points', 'sensor_msgs/msg/PointCloud2',
            planner_fields.cloud_to_fields(stamp, sure, frames), stamp)
        for polygon in planner_fields.polygons_to_fields(stamp, sure, frames):
            put('/obstacles/polygons', 'geometry_msgs/msg/PolygonInstanceStamped', polygon, stamp)
        for handover in step.handovers:
            put('/planes/handover', 'mv_slapse_msgs/msg/PlaneHandover',
                fields.handover_to_fields(handover, frames), stamp)
        if stamp >= self._surfaces_due:
            self._surfaces_due = stamp + SLOW
            put('/planes/map_markers', MARKERS, self._surfaces.show(
                stamp, view_fields.plane_markers(scene, frames)), stamp, True)
        obstacles = view_fields.obstacle_markers(step.obstacles, frames)
        put('/obstacles/markers', MARKERS, self._obstacles.show(stamp, obstacles), stamp)
        state = self._diagnostics.add(step)
        if state:
            put('/diagnostics', 'diagnostic_msgs/msg/DiagnosticArray', state, stamp)

    def _write_pose(self, scene: SceneEstimate):
        frames, put, stamp = self._frames, self._bag.write, scene.stamp
        if not self._poses:
            frames = self._frames = levelled(frames, scene.planes)
            put('/tf_static', 'tf2_msgs/msg/TFMessage', {'transforms': [
                fields.camera_transform_to_fields(stamp, frames),
                start_to_fields(stamp, frames)]}, stamp, True)
        put('/tf', 'tf2_msgs/msg/TFMessage',
            {'transforms': [fields.transform_to_fields(scene, frames)]}, stamp)
        put('/odometry', 'nav_msgs/msg/Odometry', fields.odometry_to_fields(scene, frames), stamp)
        put('/pose', 'geometry_msgs/msg/PoseWithCovarianceStamped',
            fields.pose_to_fields(scene, frames), stamp)
        put('/twist', 'geometry_msgs/msg/TwistWithCovarianceStamped',
            fields.twist_to_fields(scene, frames), stamp)
        self._poses.append(messages.to_message(
            POSE, fields.pose_stamped_to_fields(scene, frames)))
        if stamp >= self._path_due:
            self._path_due = stamp + SLOW
            put('/path', 'nav_msgs/msg/Path',
                view_fields.path_to_fields(stamp, self._poses, frames), stamp)
