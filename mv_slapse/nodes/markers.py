"""Planes and obstacles as markers for a viewer; ids are stable, vanished ones are deleted."""

from builtin_interfaces.msg import Duration
from geometry_msgs.msg import Point
from mv_slapse.nodes.conversions import stamp_to_msg
from mv_slapse.nodes.shapes import fan
from mv_slapse.records import ObstacleState
import numpy as np
from std_msgs.msg import ColorRGBA
from visualization_msgs.msg import Marker, MarkerArray

GROUND, WALL = ColorRGBA(r=0.4, g=0.4, b=0.4, a=0.6), ColorRGBA(r=0.2, g=0.5, b=0.9, a=0.6)
COLOURS = {ObstacleState.TENTATIVE: ColorRGBA(r=0.9, g=0.9, b=0.2, a=0.4),
           ObstacleState.CONFIRMED: ColorRGBA(r=0.9, g=0.2, b=0.1, a=0.8),
           ObstacleState.COASTING: ColorRGBA(r=0.9, g=0.5, b=0.1, a=0.5)}
INK = ColorRGBA(r=1.0, g=1.0, b=1.0, a=1.0)


class Markers:
    """The markers of one topic; knows which ids are shown, to delete them."""

    def __init__(self, frame: str, lifetime: float):
        """Give markers in ``frame`` that vanish after ``lifetime`` [s], 0: never."""
        self._frame = frame
        self._lifetime = Duration(sec=int(lifetime), nanosec=int(lifetime % 1 * 1e9))
        self._shown: set[tuple[str, int]] = set()

    def array(self, stamp: int, markers: list[Marker]) -> MarkerArray:
        """Return the message: these markers, and DELETE for those shown before."""
        now = {(marker.ns, marker.id) for marker in markers}
        gone = [Marker(ns=ns, id=id_, action=Marker.DELETE)
                for ns, id_ in sorted(self._shown - now)]
        self._shown = now
        for marker in markers + gone:
            marker.header.frame_id, marker.header.stamp = self._frame, stamp_to_msg(stamp)
            marker.lifetime = self._lifetime
            marker.pose.orientation.w = 1.0
        return MarkerArray(markers=markers + gone)


def surface(ns: str, id_: int, outline: np.ndarray, colour: ColorRGBA) -> Marker:
    """Return a convex outline (M, 3) as a surface."""
    marker = Marker(ns=ns, id=id_, type=Marker.TRIANGLE_LIST, color=colour,
                    points=_points(fan(outline).reshape(-1, 3)))
    marker.scale.x = marker.scale.y = marker.scale.z = 1.0
    return marker


def arrow(ns: str, id_: int, start: np.ndarray, vector: np.ndarray, colour: ColorRGBA) -> Marker:
    """Return an arrow from ``start`` along ``vector``, both (3,)."""
    marker = Marker(ns=ns, id=id_, type=Marker.ARROW, color=colour,
                    points=_points(np.array([start, start + vector])))
    marker.scale.x, marker.scale.y, marker.scale.z = 0.1, 0.25, 0.3
    return marker


def label(ns: str, id_: int, position: np.ndarray, text: str) -> Marker:
    """Return a text at ``position`` (3,)."""
    marker = Marker(ns=ns, id=id_, type=Marker.TEXT_VIEW_FACING, color=INK, text=text)
    marker.pose.position = _points(position[None])[0]
    marker.scale.z = 0.5
    return marker


def _points(X: np.ndarray) -> list[Point]:
    return [Point(x=x, y=y, z=z) for x, y, z in X.tolist()]
