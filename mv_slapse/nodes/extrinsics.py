"""Where the camera sits on the robot: from a parameter, from /tf_static, or not known."""

from importlib import import_module
import time

from mv_slapse.field_values import read_xyz
from mv_slapse.message_checks import quaternion
from mv_slapse.nodes.qos import subscribe
from mv_slapse.nodes.settings import FrameSettings
from mv_slapse.nodes.shell import Shell
from mv_slapse.quaternion import to_matrix
from mv_slapse.ros_frames import R_BODY_FROM_OPTICAL, RosFrames
import numpy as np
from rclpy.qos import DurabilityPolicy, QoSProfile

TOPIC = '/tf_static'
FRAMES = 10_000  # kept at most
STATIC = QoSProfile(depth=100, durability=DurabilityPolicy.TRANSIENT_LOCAL)


def tf_message_type() -> type | None:
    """Return tf2_msgs/TFMessage, or None where tf2_msgs is not installed."""
    try:
        return import_module('tf2_msgs.msg').TFMessage
    except ImportError:
        return None


class Extrinsics:
    """The frames of the outputs, decided once and then kept."""

    def __init__(self, node: Shell):
        """Listen to /tf_static where the parameter does not say it."""
        self._node, self._settings = node, node.settings[FrameSettings]
        self._decided: RosFrames | None = None
        self._parents: dict[str, tuple[str, np.ndarray]] = {}
        self._deadline = time.monotonic()
        self._from_parameter = any(self._settings.base_from_camera)
        message_type = tf_message_type()
        if message_type is not None and not self._from_parameter:
            self._deadline += self._settings.tf_wait
            subscribe(node, message_type, TOPIC, node.guarded(
                TOPIC, message_type, self._on_static, proves=True, comes_once=True), STATIC)

    def frames(self, camera: str) -> RosFrames | None:
        """Return the frames for pictures in the frame ``camera``; None: ask again later."""
        if self._decided is None:
            pose = self._known(camera)
            if pose is None and time.monotonic() < self._deadline:
                base = self._settings.base_frame
                self._node.health.enter('no_extrinsics', f'no transform {base} -> {camera} on '
                                        '/tf_static yet; publish it, or set base_from_camera')
                return None
            self._node.health.leave('no_extrinsics')
            self._node.latency.opened()
            self._decided = self._decide(camera, pose)
        return self._decided

    def _known(self, camera: str) -> np.ndarray | None:
        if self._from_parameter:
            return _matrix(self._settings.base_from_camera)
        return chain(self._parents, camera, self._settings.base_frame)

    def _decide(self, camera: str, pose: np.ndarray | None) -> RosFrames:
        names = (self._settings.odom_frame, self._settings.base_frame, camera)
        if pose is not None:
            self._node.get_logger().info(f'camera {camera!r} on {names[1]!r}: {pose.tolist()}')
            return RosFrames(*names, pose[:3, :3], pose[:3, 3], is_base_known=True)
        message = (f'{names[1]} is taken as the camera with x forward and z up: there is no '
                   f'transform {names[1]} -> {camera} on /tf_static; publish it or set the '
                   'parameter base_from_camera, then restart')
        self._node.get_logger().warning(message)
        self._node.health.value('extrinsics', message)
        return RosFrames(*names, R_BODY_FROM_OPTICAL.copy(), np.zeros(3))

    def _on_static(self, msg):
        for transform in msg.transforms:
            if len(self._parents) < FRAMES or transform.child_frame_id in self._parents:
                pose = (*read_xyz(transform.transform.translation, 'translation'),
                        *quaternion(transform.transform.rotation, 'rotation'))
                self._parents[transform.child_frame_id] = (
                    transform.header.frame_id, _matrix(pose))


def chain(parents: dict[str, tuple[str, np.ndarray]], child: str, root: str) -> np.ndarray | None:
    """Return the pose (4, 4) of ``child`` in ``root``, or None where they are not joined.

    ``parents`` gives for each frame its parent and its pose (4, 4) in the parent.
    """
    root_from_child, frame = np.eye(4), child
    for _ in range(len(parents) + 1):
        if frame == root:
            return root_from_child
        if frame not in parents:
            return None
        frame, parent_from_frame = parents[frame]
        root_from_child = parent_from_frame @ root_from_child
    return None


def _matrix(pose: tuple[float, ...]) -> np.ndarray:
    matrix = np.eye(4)
    matrix[:3, :3] = to_matrix(pose[3:])
    matrix[:3, 3] = pose[:3]
    return matrix
