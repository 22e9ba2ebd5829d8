"""Where the trajectory lies in the odom frame: from its origin, a given pose, or the last one."""

from collections.abc import Iterable
from dataclasses import replace

from geometry_msgs.msg import PoseWithCovarianceStamped
from mv_slapse import fields
from mv_slapse.geometry.rotation import skew
from mv_slapse.known_map import about
from mv_slapse.level import levelled
from mv_slapse.message_checks import InvalidMessage
from mv_slapse.nodes.qos import subscribe
from mv_slapse.nodes.settings import FrameSettings
from mv_slapse.nodes.shell import Shell
from mv_slapse.records import MapPlane, SceneEstimate, WITH_POSE
from mv_slapse.ros_frames import ORIGIN, Pose, pose_to_odom, pose_to_world, RosFrames
import numpy as np

TOPIC = 'initialpose'


class Placement:
    """Keeps the pose in odom at which the trajectory of the filter begins.

    A pose on ``initialpose`` is the base's pose now, as for robot_localization: the trajectory is
    moved there, and how sure that pose is adds to how sure all later ones are.
    """

    def __init__(self, node: Shell):
        """Listen to ``initialpose``."""
        self._node = node
        self.restart()
        subscribe(node, PoseWithCovarianceStamped, TOPIC,
                  node.guarded(TOPIC, PoseWithCovarianceStamped, self._on_pose, proves=True,
                               comes_once=True))

    def restart(self):
        """Begin at the origin of odom."""
        self._start = self._anchor = ORIGIN
        self._level: Pose | None = None  # with the first pose
        self._is_given = False  # whether somebody has told where it is in odom
        self._moved = ORIGIN  # of the base since the start, without the start

    def go_on(self):
        """Begin where the last pose was."""
        self._start = self._anchor = self._last()
        self._moved = ORIGIN

    def settle(self, scene: SceneEstimate, frames: RosFrames, planes: Iterable[MapPlane]):
        """Let odom stand level on the ground among some planes, with the first pose.

        Where the camera's place on the base is known that says what is level.
        """
        if self._level is not None or scene.status not in WITH_POSE:
            return
        self._level = _level(frames, planes)
        if not self._is_given:
            self._start = self._anchor = self._level

    @property
    def level(self) -> Pose:
        """Where the base is in odom when it stands at odom's origin: over the ground, level."""
        return self._level or ORIGIN

    def place(self, frames: RosFrames) -> RosFrames:
        """Return the frames with the start in them."""
        return replace(frames, R_odom_from_start=self._start.R, t_odom_from_start=self._start.t)

    def note(self, scene: SceneEstimate, frames: RosFrames):
        """Take the pose of a key frame."""
        self._moved = pose_to_odom(
            Pose(scene.R_world_from_cam, scene.t_world_from_cam, scene.pose_covariance),
            _unplaced(frames))

    def widened(self, covariance: np.ndarray, position: np.ndarray) -> np.ndarray:
        """Return the covariance (6, 6) of a pose with the anchor's own error in it."""
        arm = np.eye(6)
        arm[:3, 3:] = -skew(position - self._anchor.t)
        return np.reshape(covariance, (6, 6)) + arm @ self._anchor.covariance @ arm.T

    def set(self, pose: Pose):
        """Move the trajectory so that the base is at a pose in odom now."""
        R = pose.R @ self._moved.R.T
        self._start = Pose(R, pose.t - R @ self._moved.t)
        self._anchor, self._is_given = pose, True

    def begin_at(self, known_from_world: Pose, frames: RosFrames, planes: Iterable[MapPlane]):
        """Move the trajectory so that its {W} lies there in the {W} of some planes of a map."""
        self._level = _level(frames, planes)
        self._start = self._anchor = _after(
            self._level, pose_to_odom(known_from_world, _unplaced(frames)))
        self._is_given = True

    def start(self, frames: RosFrames) -> Pose:
        """Return where the filter's {W} lies in that of odom's origin, as far as it is known."""
        start = Pose(self._start.R, self._start.t, self.widened(np.zeros((6, 6)), self._start.t))
        R, t = self.level.R.T, self.level.t
        world = pose_to_world(_after(Pose(R, -R @ t), start), _unplaced(frames))
        return world if self._is_given else about(world)

    def _last(self) -> Pose:
        last = _after(self._start, self._moved)
        return replace(last, covariance=self.widened(last.covariance, last.t))

    def _on_pose(self, msg: PoseWithCovarianceStamped):
        odom = self._node.settings[FrameSettings].odom_frame
        if msg.header.frame_id not in ('', odom):
            raise InvalidMessage(f'header.frame_id = {msg.header.frame_id!r}: must be {odom!r}; '
                                 'the pose is not used')
        self.set(fields.pose_with_covariance_from_message(msg))
        self._node.count_reset()
        self._node.get_logger().info(f'the pose is set to {self._anchor.t.round(3).tolist()}')


def _level(frames: RosFrames, planes: Iterable[MapPlane]) -> Pose:
    if frames.is_base_known:
        return ORIGIN
    level = levelled(_unplaced(frames), planes)
    return Pose(level.R_odom_from_start, level.t_odom_from_start)


def _after(pose: Pose, other: Pose) -> Pose:
    """Return a pose of the other in a frame that is known there itself."""
    turned = np.kron(np.eye(2), pose.R)
    return Pose(pose.R @ other.R, pose.R @ other.t + pose.t, turned @ other.covariance @ turned.T)


def _unplaced(frames: RosFrames) -> RosFrames:
    """Return the frames of a trajectory that begins at the origin of odom."""
    return replace(frames, R_odom_from_start=np.eye(3), t_odom_from_start=np.zeros(3))
