"""What obstacle_tracker publishes: obstacles for planners and viewers."""

from geometry_msgs.msg import Point32, PolygonInstanceStamped
from mv_slapse import fields, view_fields
from mv_slapse.geometry import ros_frames
from mv_slapse.geometry.ros_frames import RosFrames
from mv_slapse.nodes.conversions import column, stamp_to_msg, to_message
from mv_slapse.nodes.qos import RELIABLE
from mv_slapse.nodes.settings import FrameSettings, ObstacleOutputSettings
from mv_slapse.nodes.shapes import footprint, sample
from mv_slapse.nodes.shell import Shell
from mv_slapse.records import Obstacle, ObstacleState, ScaleStatus
from mv_slapse_msgs.msg import ObstacleArray
import numpy as np
from sensor_msgs.msg import PointCloud2, PointField
from visualization_msgs.msg import MarkerArray

COLUMNS = ('x', 'y', 'z', 'vx', 'vy', 'vz')
POINT = np.dtype([*((name, np.float32) for name in COLUMNS), ('id', np.int32)])
POINT_FIELDS = [PointField(name=name, offset=4 * i, count=1, datatype=(
    PointField.INT32 if name == 'id' else PointField.FLOAT32))
    for i, name in enumerate(POINT.names)]
MARKER_LIFETIME = 0.5  # [s]


class ObstacleOutput:
    """Publishes obstacles; what planners read holds none that is not confirmed."""

    def __init__(self, node: Shell):
        """Advertise the topics."""
        self._node = node
        self._obstacles = node.create_publisher(ObstacleArray, 'obstacles', RELIABLE)
        self._points = node.create_publisher(PointCloud2, 'obstacles/points', RELIABLE)
        self._polygons = node.create_publisher(PolygonInstanceStamped, 'obstacles/polygons',
                                               RELIABLE)
        self._markers = node.create_publisher(MarkerArray, 'obstacles/markers', RELIABLE)
        self._shown = view_fields.MarkerBoard(
            node.settings[FrameSettings].odom_frame, MARKER_LIFETIME)

    @property
    def _settings(self) -> ObstacleOutputSettings:
        return self._node.settings[ObstacleOutputSettings]

    def publish(self, stamp: int, obstacles: list[Obstacle], scale: ScaleStatus,
                frames: RosFrames):
        """Publish the obstacles of a key frame, an empty list as well."""
        self._obstacles.publish(to_message(ObstacleArray, fields.obstacles_to_fields(
            stamp, obstacles, scale, frames)))
        sure = [o for o in obstacles if o.state != ObstacleState.TENTATIVE]
        self._points.publish(self._cloud(stamp, sure, frames))
        for obstacle in sure:
            if len(obstacle.outline) > 2:
                self._polygons.publish(self._polygon(stamp, obstacle, frames))
        if self._markers.get_subscription_count():
            self._markers.publish(to_message(MarkerArray, self._shown.show(
                stamp, view_fields.obstacle_markers(obstacles, frames))))
        self._node.health.fresh('obstacles', len(sure))

    def _cloud(self, stamp: int, obstacles: list[Obstacle], frames: RosFrames) -> PointCloud2:
        parts = [self._points_of(obstacle, frames) for obstacle in obstacles]
        points = np.concatenate(parts) if parts else np.zeros(0, POINT)
        msg = PointCloud2(height=1, width=len(points), fields=POINT_FIELDS,
                          point_step=POINT.itemsize, row_step=points.nbytes, is_dense=True,
                          data=column('B', points.view(np.uint8)))
        msg.header.frame_id, msg.header.stamp = frames.odom, stamp_to_msg(stamp)
        return msg

    def _points_of(self, obstacle: Obstacle, frames: RosFrames) -> np.ndarray:
        X = sample(ros_frames.points_to_odom(obstacle.outline, frames),
                   self._settings.point_spacing)
        points = np.zeros(len(X), POINT)
        velocity = ros_frames.vectors_to_odom(obstacle.velocity, frames)
        for i, name in enumerate(COLUMNS):
            points[name] = X[:, i] if i < 3 else velocity[i - 3]
        points['id'] = obstacle.id
        return points

    def _polygon(self, stamp: int, obstacle: Obstacle,
                 frames: RosFrames) -> PolygonInstanceStamped:
        corners = footprint(ros_frames.points_to_odom(obstacle.outline, frames),
                            self._settings.footprint_depth)
        msg = PolygonInstanceStamped()
        msg.header.frame_id, msg.header.stamp = frames.odom, stamp_to_msg(stamp)
        msg.polygon.id = obstacle.id
        msg.polygon.polygon.points = [Point32(x=x, y=y) for x, y in corners.tolist()]
        return msg
