"""Messages of the planes of a map, each made once for as long as its plane stays the same."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

from mv_slapse import fields
from mv_slapse.fields import Fields
from mv_slapse.records import MapPlane, SceneEstimate
from mv_slapse.ros_frames import RosFrames
import numpy as np


class PlaneMessages:
    """Messages of planes; of one that has not changed since the last picture it is the same.

    A map may hold 200 planes that the filter has given up, and each costs as much as a pose.
    """

    def __init__(self, to_message: Callable[[Fields], Any]):
        """Make messages by a function of the fields of mv_slapse_msgs/MapPlane."""
        self._to_message = to_message
        self._made: dict[int, tuple[MapPlane, Any]] = {}
        self._place: tuple[np.ndarray, np.ndarray] | None = None

    def of(self, planes: Sequence[MapPlane], frames: RosFrames) -> list[Any]:
        """Return the messages of planes in odom."""
        place = frames.R_odom_from_world, frames.t_odom_from_world
        if self._place is None or not all(map(np.array_equal, place, self._place)):
            self._made, self._place = {}, place
        made = [self._made.get(plane.id) for plane in planes]
        made = [old if old and old[0] is plane else (plane, self._to_message(
            fields.map_plane_to_fields(plane, frames)))
            for plane, old in zip(planes, made, strict=True)]
        self._made = {plane.id: (plane, msg) for plane, msg in made}
        return [msg for _, msg in made]

    def map_fields(self, scene: SceneEstimate, frames: RosFrames, resets: int,
                   began: int) -> Fields:
        """Return mv_slapse_msgs/PlaneMap as fields, those of its planes as messages."""
        without = fields.plane_map_to_fields(replace(scene, planes=()), frames, resets, began)
        return without | {'planes': self.of(scene.planes, frames)}
