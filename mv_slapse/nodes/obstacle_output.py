"""What obstacle_tracker publishes: obstacles for planners and viewers."""

from geometry_msgs.msg import PolygonInstanceStamped
from mv_slapse import fields, planner_fields, view_fields
from mv_slapse.nodes.conversions import to_message
from mv_slapse.nodes.qos import is_heard, RELIABLE
from mv_slapse.nodes.settings import FrameSettings, ObstacleOutputSettings
from mv_slapse.nodes.shell import Shell
from mv_slapse.records import Obstacle, ScaleStatus
from mv_slapse.ros_frames import RosFrames
from mv_slapse_msgs.msg import ObstacleArray
from sensor_msgs.msg import PointCloud2
from visualization_msgs.msg import MarkerArray

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
        sure = planner_fields.sure(obstacles)
        if is_heard(self._obstacles):
            self._obstacles.publish(to_message(ObstacleArray, fields.obstacles_to_fields(
                stamp, obstacles, scale, frames)))
        if is_heard(self._points):
            self._points.publish(to_message(PointCloud2, planner_fields.cloud_to_fields(
                stamp, sure, frames, self._settings.point_spacing)))
        if is_heard(self._polygons):
            for polygon in planner_fields.polygons_to_fields(stamp, sure, frames,
                                                             self._settings.footprint_depth):
                self._polygons.publish(to_message(PolygonInstanceStamped, polygon))
        if is_heard(self._markers):
            self._markers.publish(to_message(MarkerArray, self._shown.show(
                stamp, view_fields.obstacle_markers(obstacles, frames))))
        self._node.health.fresh('obstacles', len(sure))
