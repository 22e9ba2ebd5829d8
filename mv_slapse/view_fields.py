"""Planes, obstacles and path as what viewers draw: fields of Marker and Path messages.

As in ``fields``, a message is a nested dict; what is not named keeps its default.
"""

from collections.abc import Iterable
from typing import Any

from mv_slapse.fields import Fields, header, stamp_to_fields
from mv_slapse.records import Obstacle, ObstacleState, SceneEstimate
from mv_slapse.ros_frames import points_to_odom, RosFrames, vectors_to_odom
import numpy as np

ARROW, TEXT, TRIANGLES = 0, 9, 11  # Marker.ARROW, TEXT_VIEW_FACING, TRIANGLE_LIST
ADD, DELETE = 0, 2
GROUND, WALL, INK = (0.4, 0.4, 0.4, 0.6), (0.2, 0.5, 0.9, 0.6), (1.0, 1.0, 1.0, 1.0)
COLOURS = {ObstacleState.TENTATIVE: (0.9, 0.9, 0.2, 0.4),
           ObstacleState.CONFIRMED: (0.9, 0.2, 0.1, 0.8),
           ObstacleState.COASTING: (0.9, 0.5, 0.1, 0.5)}
UPRIGHT = {'x': 0.0, 'y': 0.0, 'z': 0.0, 'w': 1.0}


class MarkerBoard:
    """The markers of one topic: ids are stable, and what vanishes is deleted."""

    def __init__(self, frame: str, lifetime: float = 0.0):
        """Give markers in ``frame`` that vanish by themselves after ``lifetime`` [s], 0: never."""
        self._frame, self._lifetime = frame, stamp_to_fields(round(lifetime * 1e9))
        self._shown: set[tuple[str, int]] = set()

    def show(self, stamp: int, markers: Iterable[Fields]) -> Fields:
        """Return visualization_msgs/MarkerArray: these markers, and DELETE for all others."""
        markers = list(markers)
        now = {(marker['ns'], marker['id']) for marker in markers}
        gone = [_marker(ns, id_, TRIANGLES, WALL) | {'action': DELETE}
                for ns, id_ in sorted(self._shown - now)]
        self._shown = now
        common = {'header': header(stamp, self._frame), 'lifetime': self._lifetime}
        return {'markers': [marker | common for marker in markers + gone]}


def plane_markers(scene: SceneEstimate, frames: RosFrames) -> list[Fields]:
    """Return a surface for each plane of the map that has an outline."""
    return [_surface('planes', plane.id, points_to_odom(plane.outline, frames),
                     GROUND if plane.is_ground else WALL)
            for plane in scene.planes if len(plane.outline) > 2]


def obstacle_markers(obstacles: Iterable[Obstacle], frames: RosFrames) -> list[Fields]:
    """Return a surface, an arrow along the velocity, and the time to contact of each obstacle."""
    markers = []
    for obstacle in obstacles:
        colour = COLOURS[obstacle.state]
        position = points_to_odom(obstacle.position, frames)
        end = position + vectors_to_odom(obstacle.velocity, frames)
        text = f'{obstacle.id}: {obstacle.time_to_contact:.1f} s'
        markers += [
            _surface('obstacles', obstacle.id, points_to_odom(obstacle.outline, frames), colour),
            _marker('velocity', obstacle.id, ARROW, colour, (0.1, 0.25, 0.3))
            | {'points': _points([position, end])},
            _marker('time_to_contact', obstacle.id, TEXT, INK, (0.0, 0.0, 0.5),
                    position + (0, 0, 1)) | {'text': text}]
    return markers


def path_to_fields(stamp: int, poses: Iterable[Any], frames: RosFrames) -> Fields:
    """Return nav_msgs/Path of poses, each as ``fields.pose_stamped_to_fields`` or a message."""
    return {'header': header(stamp, frames.odom), 'poses': list(poses)}


def _surface(ns: str, id_: int, outline: np.ndarray, colour: tuple) -> Fields:
    """Return a convex outline (M, 3) as a fan of triangles."""
    fan = [outline[k] for i in range(1, len(outline) - 1) for k in (0, i, i + 1)]
    return _marker(ns, id_, TRIANGLES, colour) | {'points': _points(fan)}


def _marker(ns: str, id_: int, kind: int, colour: tuple, scale: Any = (1.0, 1.0, 1.0),
            position: Any = (0.0, 0.0, 0.0)) -> Fields:
    return {'ns': ns, 'id': int(id_), 'type': kind, 'action': ADD,
            'pose': {'position': _xyz(position), 'orientation': UPRIGHT}, 'scale': _xyz(scale),
            'color': dict(zip('rgba', colour, strict=True))}


def _points(X: Any) -> list[Fields]:
    return [_xyz(point) for point in X]


def _xyz(v: Any) -> Fields:
    return {name: float(value) for name, value in zip('xyz', v, strict=True)}
