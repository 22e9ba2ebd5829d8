"""The topic ``image_overlay``: key pictures with what was found, made while somebody looks."""

from collections.abc import Callable, Sequence
from typing import Any

from mv_slapse import drawing, fields
from mv_slapse import message_checks as check
from mv_slapse.field_values import header
from mv_slapse.geometry.blocks import grid_centres
from mv_slapse.nodes.conversions import to_message
from mv_slapse.nodes.health import every
from mv_slapse.nodes.qos import is_heard, RELIABLE, subscribe
from mv_slapse.nodes.shell import Shell
from mv_slapse.records import Extraction, Obstacle, ScaleStatus
from mv_slapse.ros_frames import RosFrames
from mv_slapse_msgs.msg import ObstacleArray, PlaneObservations
import numpy as np
from sensor_msgs.msg import Image

TOPIC = 'image_overlay'
PICTURES = 32  # kept until what they show is known: as many as are chained, and some on their way
PERIOD = 0.5  # [s] between two looks whether somebody subscribes


class ImageOverlay:
    """Keeps the newest key pictures, grey, and draws what was found into them."""

    def __init__(self, node: Shell):
        """Advertise the topic."""
        self._publisher = node.create_publisher(Image, TOPIC, RELIABLE)
        self._pictures: dict[int, np.ndarray] = {}

    @property
    def is_watched(self) -> bool:
        """Whether somebody subscribes; nothing is kept or drawn while nobody does."""
        return is_heard(self._publisher)

    def add_picture(self, stamp: int, luma: np.ndarray):
        """Keep a key picture (H, W) uint8 for what will be known of it."""
        if not self.is_watched:
            self._pictures.clear()
            return
        self._pictures[stamp] = luma
        while len(self._pictures) > PICTURES:
            del self._pictures[next(iter(self._pictures))]

    def show(self, extraction: Extraction, obstacles: Sequence[Obstacle], scale: ScaleStatus,
             frame: str):
        """Publish the picture of a key frame, if it is there, with what was found in it."""
        image = self._pictures.pop(extraction.stamp, None)
        size = extraction.width, extraction.height
        if image is None or image.shape != size[::-1] or not len(extraction.macroblock_label):
            return
        drawn = drawing.draw(
            image, grid_centres(*size), extraction.macroblock_label, extraction.macroblock_plane,
            map(drawing.box_of, filter(drawing.is_shown, obstacles)),
            'm/s' if scale is ScaleStatus.METRIC else 'u/s')
        height, width = image.shape
        self._publisher.publish(to_message(Image, {
            'header': header(extraction.stamp, frame), 'height': height, 'width': width,
            'encoding': 'bgr8', 'step': 3 * width, 'data': drawn.ravel()}))


class OverlayTopics:
    """What other nodes found, for the decoder, which has the pictures.

    It subscribes only while somebody looks, and draws obstacles as soon as they are there, or
    none where the next key frame comes before them.
    """

    def __init__(self, node: Shell, overlay: ImageOverlay):
        """Look now and then whether somebody subscribes."""
        self._node, self._overlay = node, overlay
        self._subscriptions: list = []
        self._waiting: tuple[Extraction, str] | None = None
        every(node, PERIOD, self._follow)

    def _follow(self):
        node = self._node
        if self._overlay.is_watched and not self._subscriptions:
            self._subscriptions = [
                subscribe(node, kind, topic, node.guarded(topic, kind, self._trying(take)))
                for kind, topic, take in (
                    (PlaneObservations, 'planes/observations', self._take_observations),
                    (ObstacleArray, 'obstacles', self._take_obstacles))]
        elif not self._overlay.is_watched and self._subscriptions:
            for subscription in self._subscriptions:
                node.destroy_subscription(subscription)
            self._subscriptions, self._waiting = [], None

    def _trying(self, take: Callable[[Any], None]) -> Callable[[Any], None]:
        """Return a callback whose failure does not disturb the decoder."""
        return lambda msg: self._node.attempt(TOPIC, take, msg, recover=lambda: None, proves=True)

    def _take_observations(self, msg: PlaneObservations):
        if self._waiting:
            self._overlay.show(self._waiting[0], (), ScaleStatus.UNKNOWN, self._waiting[1])
        self._waiting = fields.extraction_from_message(msg), msg.header.frame_id

    def _take_obstacles(self, msg: ObstacleArray):
        waiting = self._waiting
        if waiting and waiting[0].stamp == fields.stamp_from_message(msg.header.stamp):
            self._waiting = None
            self._overlay.show(waiting[0], fields.obstacles_from_message(msg, RosFrames()),
                               check.member(ScaleStatus, msg.scale_status, 'scale_status'),
                               waiting[1])
