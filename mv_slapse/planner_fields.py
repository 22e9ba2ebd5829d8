"""Obstacles as what planners read: fields of PointCloud2 and PolygonInstanceStamped messages.

As in ``fields``, a message is a nested dict; what is not named keeps its default.
"""

from collections.abc import Sequence

from mv_slapse.fields import Fields, header
from mv_slapse.records import Obstacle, ObstacleState
from mv_slapse.ros_frames import points_to_odom, RosFrames, vectors_to_odom
from mv_slapse.shapes import footprint, sample
import numpy as np

INT32, FLOAT32 = 5, 7  # PointField.INT32, FLOAT32
COLUMNS = ('x', 'y', 'z', 'vx', 'vy', 'vz')
POINT = np.dtype([*((name, np.float32) for name in COLUMNS), ('id', np.int32)])
LAYOUT = [{'name': name, 'offset': 4 * i, 'count': 1,
           'datatype': INT32 if name == 'id' else FLOAT32} for i, name in enumerate(POINT.names)]
SPACING, DEPTH = 0.2, 0.5  # [m] between points, least extent of a polygon, where nobody chooses


def sure(obstacles: Sequence[Obstacle]) -> list[Obstacle]:
    """Return what a planner is told of: confirmed obstacles, and those that coast."""
    return [o for o in obstacles if o.state != ObstacleState.TENTATIVE]


def cloud_to_fields(stamp: int, obstacles: Sequence[Obstacle], frames: RosFrames,
                    spacing: float = SPACING) -> Fields:
    """Return sensor_msgs/PointCloud2 of the surfaces, a point every ``spacing`` [m]."""
    parts = [_points(obstacle, frames, spacing) for obstacle in obstacles]
    points = np.concatenate(parts) if parts else np.zeros(0, POINT)
    return {'header': header(stamp, frames.odom), 'height': 1, 'width': len(points),
            'fields': LAYOUT, 'is_bigendian': False, 'point_step': POINT.itemsize,
            'row_step': points.nbytes, 'data': points.view(np.uint8), 'is_dense': True}


def polygons_to_fields(stamp: int, obstacles: Sequence[Obstacle], frames: RosFrames,
                       depth: float = DEPTH) -> list[Fields]:
    """Return a geometry_msgs/PolygonInstanceStamped of what each obstacle covers on the ground.

    At the height of its lowest point.
    """
    found = []
    for obstacle in obstacles:
        if len(obstacle.outline) > 2:
            outline = points_to_odom(obstacle.outline, frames)
            points = [{'x': x, 'y': y, 'z': float(outline[:, 2].min())}
                      for x, y in footprint(outline, depth).tolist()]
            found.append({'header': header(stamp, frames.odom), 'polygon': {
                'polygon': {'points': points}, 'id': int(obstacle.id)}})
    return found


def _points(obstacle: Obstacle, frames: RosFrames, spacing: float) -> np.ndarray:
    X = sample(points_to_odom(obstacle.outline, frames), spacing)
    points = np.zeros(len(X), POINT)
    velocity = vectors_to_odom(obstacle.velocity, frames)
    for i, name in enumerate(COLUMNS):
        points[name] = X[:, i] if i < 3 else velocity[i - 3]
    points['id'] = obstacle.id
    return points
