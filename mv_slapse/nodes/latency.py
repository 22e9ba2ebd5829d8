"""How far a node is behind its input, and whether it must drop some to catch up."""

import time

from mv_slapse.nodes.health import SILENCE
from mv_slapse.nodes.settings import LatencySettings

SEGMENTS = 0.5  # share of max_latency from which segments are dropped; packets are at all of it
CAUGHT_UP = 0.25  # share below which nothing is dropped any more


class Latency:
    """Tells from how long messages have waited what can still be worked on.

    Whole segments are dropped, the oldest first: from the place where the node is more than
    ``SEGMENTS`` of max_latency behind to where it has caught up, so that those between are
    neighbours. What has waited for something else, such as the camera, is not counted as late.
    """

    def __init__(self, node):
        """Take max_latency from the parameters, and report to the node's diagnostics."""
        self._node = node
        self._came, self._opened = time.monotonic(), 0.0
        self._dropping = False

    def begin(self, waited: float):
        """Note that a message is worked on which has waited so long [s]."""
        self._came = time.monotonic() - max(waited, 0.0)

    def opened(self):
        """Note that from now on what was held back can be worked on."""
        self._opened = time.monotonic()

    @property
    def came(self) -> float:
        """When the message came that is worked on (monotonic time, [s])."""
        return self._came

    def waited(self, came: float | None = None) -> float:
        """Return how long [s] what came then, by default what is worked on, could have begun."""
        came = self._came if came is None else came
        return time.monotonic() - max(came, self._opened)

    def is_behind(self, came: float | None = None) -> bool:
        """Return whether a segment is to be dropped, and count and report it."""
        waited, most = self.waited(came), self.most
        self._dropping = waited > (CAUGHT_UP if self._dropping else SEGMENTS) * most
        if self._dropping:
            self.report(waited, 'segments dropped')
        return self._dropping

    @property
    def most(self) -> float:
        """Longest time [s] that anything may wait."""
        return self._node.settings[LatencySettings].max_latency

    def report(self, waited: float, name: str):
        """Count what is dropped, and say why."""
        health = self._node.health
        health.count(f'{name} by overload')
        health.enter('overload', f'{waited:.2f} s behind: fed faster than it can work, {name} to '
                     'keep up; lower the rate or the size of the pictures, or free the CPU',
                     lasts=SILENCE)
