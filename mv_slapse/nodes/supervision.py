"""The border of a node: no exception of a callback, ours or foreign, crosses it."""

from collections.abc import Callable
import time
import traceback
from typing import Any

from rclpy.event_handler import EventHandler
from rclpy.executors import SingleThreadedExecutor

REMEMBERED = 100  # kinds of errors whose traceback is told once
EVENTS = 1.0  # [s] between two looks at the events of the middleware


class SupervisedExecutor(SingleThreadedExecutor):
    """Runs callbacks, and hands to ``report`` what they and the middleware raise.

    rclpy lets such exceptions end the process: those of our callbacks, those of its own services
    (a parameter of a type that does not exist), those of messages that cannot be deserialised.

    Each publisher and subscription has two or three events, such as a QoS that does not fit. To
    wait for all of them costs more than half of a wake-up, so they are looked at now and then.
    """

    def __init__(self, report: Callable[[str, Exception], None]):
        """Call ``report`` with what the exception came from, and the exception."""
        super().__init__()
        self._report = report
        self._looked, self._looks = -EVENTS, True

    def spin_once(self, timeout_sec: float | None = None):
        """Run what is ready, or what is first within so many seconds."""
        now = time.monotonic()
        self._looks = now - self._looked >= EVENTS
        if self._looks:
            self._looked = now
        super().spin_once(timeout_sec)

    def can_execute(self, entity: Any) -> bool:
        """Return whether an entity is waited for; in one thread none is at work then."""
        return self._looks or not isinstance(entity, EventHandler)

    def _make_handler(self, entity, node, take_from_wait_list):
        """Wrap both halves of a callback, the taking of its data and the call."""
        def take(taken):
            """Take what has come; nothing where that fails."""
            try:
                call = take_from_wait_list(taken)
            except Exception as error:
                self._report(_name(taken), error)
                return None
            return call and supervised(call)

        def supervised(call):
            """Return the call within the border."""
            async def run():
                """Call, and report what it raises."""
                try:
                    await call()
                except Exception as error:
                    self._report(_name(entity), error)

            return run

        # After each callback rclpy wakes the other threads of an executor, of which this one has
        # none: it would itself be woken for nothing, and build its whole wait set twice.
        guard, self._guard = self._guard, NOBODY
        try:
            return super()._make_handler(entity, node, take)
        finally:
            self._guard = guard


class _Nobody:
    """Takes the place of a guard condition that wakes other threads."""

    def trigger(self):
        """Wake nobody."""


NOBODY = _Nobody()


class Tracebacks:
    """Tells the traceback of each kind of error once."""

    def __init__(self):
        """Know no error yet."""
        self._told: set[tuple[str, str, int]] = set()

    def first(self, error: Exception) -> str:
        """Return the traceback of an error, empty where one from that place was told before."""
        last = traceback.extract_tb(error.__traceback__)[-1:]
        place = type(error).__name__, *((last[0].filename, last[0].lineno) if last else ('', 0))
        if place in self._told or len(self._told) >= REMEMBERED:
            return ''
        self._told.add(place)
        return ''.join(traceback.format_exception(error))


def _name(entity: Any) -> str:
    """Return what a callback belongs to, in words."""
    name = getattr(entity, 'topic_name', None) or getattr(entity, 'srv_name', None)
    return name or type(entity).__name__.lower()
