"""What slam publishes: pose, twist, path, transform and map."""

from collections import deque
from functools import partial

from geometry_msgs.msg import PoseStamped, PoseWithCovarianceStamped, TwistWithCovarianceStamped
from mv_slapse import fields, view_fields
from mv_slapse.nodes.conversions import bounded_covariance, stamp_to_msg, to_message
from mv_slapse.nodes.extrinsics import tf_message_type
from mv_slapse.nodes.health import every
from mv_slapse.nodes.placement import Placement
from mv_slapse.nodes.qos import is_heard, LATCHED, RELIABLE
from mv_slapse.nodes.settings import FrameSettings, SceneOutputSettings
from mv_slapse.nodes.shell import Shell
from mv_slapse.plane_messages import PlaneMessages
from mv_slapse.records import ScaleStatus, SceneEstimate, TrackingStatus, WITH_POSE
from mv_slapse.ros_frames import RosFrames
from mv_slapse.states import CONDITIONS
from mv_slapse_msgs.msg import MapPlane as MapPlaneMsg
from mv_slapse_msgs.msg import PlaneMap
from nav_msgs.msg import Odometry, Path
import numpy as np
from visualization_msgs.msg import MarkerArray

STATES = {'initialising': TrackingStatus.INITIALISING, 'predicted': TrackingStatus.PREDICTED,
          'lost': TrackingStatus.LOST}
LATCHED_PERIOD = 1_000_000_000  # [ns] between two latched maps while nobody listens
LOOK = 1.0  # [s] between two looks whether somebody wants markers where no pictures come


class SceneOutput:
    """Publishes scene estimates, and no pose that is not known.

    While INITIALISING or LOST there is no odometry, pose, twist or transform: only ``planes/map``
    goes on and says so.
    """

    def __init__(self, node: Shell):
        """Advertise the topics."""
        self._node = node
        self._odometry = node.create_publisher(Odometry, 'odometry', RELIABLE)
        self._pose = node.create_publisher(PoseWithCovarianceStamped, 'pose', RELIABLE)
        self._twist = node.create_publisher(TwistWithCovarianceStamped, 'twist', RELIABLE)
        self._path = node.create_publisher(Path, 'path', RELIABLE)
        self._map = node.create_publisher(PlaneMap, 'planes/map', LATCHED)
        self._markers = node.create_publisher(MarkerArray, 'planes/map_markers', LATCHED)
        self._tf_type = tf_message_type()
        if self._tf_type is None:
            node.get_logger().warning('no /tf: the package tf2_msgs is not installed (sudo apt '
                                      'install ros-jazzy-tf2-msgs)')
        else:
            self._tf = node.create_publisher(self._tf_type, '/tf', RELIABLE)
        self.restart()
        every(node, LOOK, self._publish_markers)

    @property
    def _settings(self) -> SceneOutputSettings:
        return self._node.settings[SceneOutputSettings]

    def restart(self):
        """Forget the path."""
        self._poses: deque[PoseStamped] = deque(maxlen=self._settings.path_length)
        self._path_due = self._map_due = self._anew = 0
        self._unshown: tuple[SceneEstimate, RosFrames] | None = None
        self._began: tuple[int, int] | None = None  # resets, and the stamp of the last [ns]
        self._planes = PlaneMessages(partial(to_message, MapPlaneMsg))
        self._shown = view_fields.MarkerBoard(
            self._node.settings[FrameSettings].odom_frame)

    def publish(self, scene: SceneEstimate, frames: RosFrames, placement: Placement):
        """Publish an estimate; the transform goes before the data of the same stamp."""
        self._count(scene)
        if scene.status in WITH_POSE:
            placement.note(scene, frames)
            self._publish_pose(scene, frames, placement)
            self._publish_path(scene, frames)
        beginning = self._beginning(scene.stamp)
        if is_heard(self._map) or scene.stamp >= self._map_due:
            self._map_due = scene.stamp + LATCHED_PERIOD
            self._map.publish(to_message(PlaneMap, self._planes.map_fields(
                scene, frames, *beginning)))
        self._unshown = scene, frames
        self._publish_markers()
        self._report(scene)

    def _beginning(self, stamp: int) -> tuple[int, int]:
        """Return how often the trajectory began anew, and when it did last."""
        if self._began is None or self._began[0] != self._node.resets:
            self._began = self._node.resets, stamp
            self._node.health.value('trajectory began', f'{stamp / 1e9:.3f} s')
        return self._began

    def _count(self, scene: SceneEstimate):
        """Add how often the filter began anew to the node's count; a new one counts from 0."""
        self._node.resets += max(scene.resets - self._anew, 0)
        self._anew = scene.resets
        self._node.health.value('resets', self._node.resets)
        self._node.health.value('covariances repaired', scene.repairs)

    def _publish_pose(self, scene: SceneEstimate, frames: RosFrames, placement: Placement):
        if self._tf_type is not None and self._settings.publish_tf and is_heard(self._tf):
            transform = fields.transform_to_fields(scene, frames)
            self._tf.publish(to_message(self._tf_type, {'transforms': [transform]}))
        if not is_heard(self._odometry, self._pose, self._twist):
            return
        odometry = fields.odometry_to_fields(scene, frames)
        pose, twist = odometry['pose'], odometry['twist']
        position = np.array([pose['pose']['position'][axis] for axis in 'xyz'])
        pose['covariance'] = bounded_covariance(placement.widened(pose['covariance'], position))
        twist['covariance'] = bounded_covariance(twist['covariance'])
        msg = to_message(Odometry, odometry)
        self._odometry.publish(msg)
        if is_heard(self._pose):
            self._pose.publish(PoseWithCovarianceStamped(header=msg.header, pose=msg.pose))
        if is_heard(self._twist):
            twist = TwistWithCovarianceStamped(twist=msg.twist)
            twist.header.stamp, twist.header.frame_id = msg.header.stamp, frames.base
            self._twist.publish(twist)

    def _publish_path(self, scene: SceneEstimate, frames: RosFrames):
        """Publish the path now and then: its cost grows with its length."""
        self._poses.append(to_message(PoseStamped, fields.pose_stamped_to_fields(scene, frames)))
        if scene.stamp < self._path_due or not is_heard(self._path):
            return
        self._path_due = scene.stamp + int(self._settings.path_period * 1e9)
        path = Path(poses=list(self._poses))
        path.header.frame_id, path.header.stamp = frames.odom, stamp_to_msg(scene.stamp)
        self._path.publish(path)

    def _publish_markers(self):
        """Publish the newest markers once somebody looks, also where no more pictures come."""
        if self._unshown is None or not is_heard(self._markers):
            return
        (scene, frames), self._unshown = self._unshown, None
        self._markers.publish(to_message(MarkerArray, self._shown.show(
            scene.stamp, view_fields.plane_markers(scene, frames))))

    def _report(self, scene: SceneEstimate):
        health, status = self._node.health, scene.status
        health.fresh('tracking', status.name)
        health.fresh('planes in the map', len(scene.planes))
        health.fresh('scale', f'{scene.scale_status.name.lower()} ({scene.scale_source})')
        for key, reported in STATES.items():
            to_do = CONDITIONS[key].next_step
            health.set(key, status == reported,
                       f'{status.name.lower()}: {scene.reason or "no reason given"}; {to_do}')
        health.set('no_scale', scene.scale_status == ScaleStatus.UNKNOWN)
        if status == TrackingStatus.OK:
            health.worked()
