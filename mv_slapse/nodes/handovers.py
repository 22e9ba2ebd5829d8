"""Planes that change their label, on ``planes/handover`` between slam and obstacle_tracker."""

from collections import deque
from collections.abc import Iterable
from itertools import compress

from mv_slapse import fields
from mv_slapse.nodes.conversions import to_message
from mv_slapse.nodes.qos import RELIABLE, subscribe
from mv_slapse.nodes.shell import Shell
from mv_slapse.records import Label, PlaneHandover
from mv_slapse.ros_frames import RosFrames
from mv_slapse_msgs.msg import PlaneHandover as PlaneHandoverMsg

TOPIC = 'planes/handover'
HELD = 1000  # hand-overs that wait for their key frame


class Handovers:
    """Sends hand-overs, and keeps those that come until their key frame."""

    def __init__(self, node: Shell, to_label: Label | None):
        """Take hand-overs to ``to_label``; None: send only."""
        self.restart()
        self._to_label = to_label
        self._publisher = node.create_publisher(PlaneHandoverMsg, TOPIC, RELIABLE)
        if to_label is not None:
            subscribe(node, PlaneHandoverMsg, TOPIC,
                      node.guarded(TOPIC, PlaneHandoverMsg, self._on_message, proves=True))

    def restart(self):
        """Forget what is pending."""
        self._pending: deque[PlaneHandoverMsg] = deque(maxlen=HELD)

    def publish(self, handovers: Iterable[PlaneHandover], frames: RosFrames):
        """Send hand-overs to the other filter."""
        for handover in handovers:
            self._publisher.publish(to_message(
                PlaneHandoverMsg, fields.handover_to_fields(handover, frames)))

    def due(self, stamp: int, frames: RosFrames) -> list[PlaneHandover]:
        """Return the hand-overs decided at ``stamp`` [ns] or before, sorted, and drop them.

        However fast a message was, it takes effect at the key frame at which it does in the
        pipeline: the scene's at once, the tracker's at the next.
        """
        records = [fields.handover_from_message(msg, frames) for msg in self._pending]
        pending = [r.stamp > stamp for r in records]
        self._pending = deque(compress(self._pending, pending), maxlen=HELD)
        due = [r for r, wait in zip(records, pending, strict=True) if not wait]
        return sorted(due, key=lambda record: (record.stamp, record.id))

    def _on_message(self, msg: PlaneHandoverMsg):
        # once, so that what waits can be used later
        if fields.handover_from_message(msg, RosFrames()).to_label == self._to_label:
            self._pending.append(msg)
