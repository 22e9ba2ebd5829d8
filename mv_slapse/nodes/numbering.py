"""Ids of planes that no extraction before has given: one that was killed leaves a map behind."""

from dataclasses import replace
import time

from mv_slapse import fields
from mv_slapse.message_checks import MAX_ITEMS
from mv_slapse.nodes.qos import LATCHED, subscribe
from mv_slapse.nodes.shell import Shell
from mv_slapse.records import Extraction
from mv_slapse.storage.archives import BLOCK
from mv_slapse_msgs.msg import PlaneMap
import numpy as np

TOPIC = 'planes/map'
WAIT = 1.0  # [s] after the start for the map of a slam that may have been running before


class Numbering:
    """Moves the ids of an extraction beyond those that slam's map has from an earlier one.

    To the filter a plane's id says which plane it is: numbered from zero again, other planes
    would be taken for those of the map.
    """

    def __init__(self, node: Shell):
        """Listen to the map, which is latched."""
        self._node = node
        self._offset, self._newest, self._is_known = 0, -1, False
        self._deadline = time.monotonic() + WAIT
        self._subscription = subscribe(
            node, PlaneMap, TOPIC, node.guarded(TOPIC, PlaneMap, self._on_map, proves=True),
            LATCHED)

    def is_known(self) -> bool:
        """Return whether ids can be given: the map has come, or there seems to be none."""
        if not self._is_known and time.monotonic() > self._deadline:
            self._decide()
        return self._is_known

    def begin_anew(self):
        """Give other ids than so far from now on."""
        if self._newest >= 0:
            self._offset = BLOCK * (1 + self._newest // BLOCK)

    def applied(self, extraction: Extraction) -> Extraction:
        """Return an extraction with the ids that are its own."""
        ids = self._moved(np.array([plane.id for plane in extraction.planes], int)).tolist()
        self._newest = max([self._newest, *ids])
        if not self._offset:
            return extraction
        planes = tuple(replace(plane, id=id_) for plane, id_ in zip(
            extraction.planes, ids, strict=True))
        return replace(extraction, planes=planes, plane_id=self._moved(extraction.plane_id),
                       macroblock_plane=self._moved(extraction.macroblock_plane))

    def _moved(self, ids: np.ndarray) -> np.ndarray:
        return np.where(ids < 0, ids, ids + np.int32(self._offset))

    def _on_map(self, msg: PlaneMap):
        fields.check_plane_map(msg)
        if not self._is_known:
            self._newest = max((plane.id for plane in msg.planes[:MAX_ITEMS]), default=-1)
            self.begin_anew()
            self._decide()

    def _decide(self):
        self._is_known = True
        self._node.latency.opened()
        # The map is of no further interest here, and comes often.
        self._node.destroy_subscription(self._subscription)
