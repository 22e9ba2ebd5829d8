"""What a node knows about its own state, on /diagnostics at 1 Hz."""

from collections.abc import Callable
from dataclasses import dataclass
import time

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.clock import Clock
from rclpy.clock_type import ClockType
from rclpy.node import Node
from rclpy.timer import Timer

SILENCE = 3.0  # [s] without input before it is reported
LATE = 1.0  # [s] that input waits before it is reported


def every(node: Node, period: float, callback: Callable[[], None]) -> Timer:
    """Call back every ``period`` seconds of real time, also where /clock stands still."""
    return node.create_timer(period, callback, clock=Clock(clock_type=ClockType.STEADY_TIME))


@dataclass
class _Watch:
    topic: str
    hint: str
    last: float


class Health:
    """Problems, inputs and counters of a node; the worst problem is what it reports."""

    def __init__(self, node: Node):
        """Publish every second of real time, whatever /clock does."""
        self._node = node
        self._problems: dict[str, tuple[bytes, str]] = {}
        self._counts: dict[str, int] = {}
        self._values: dict[str, str] = {}
        self._watches: dict[str, _Watch] = {}
        self._publisher = node.create_publisher(DiagnosticArray, '/diagnostics', 10)
        every(node, 1.0, self.publish)

    def problem(self, key: str, message: str, level: bytes = DiagnosticStatus.ERROR):
        """Report a problem, with what to do about it, until it is solved."""
        self._problems[key] = (level, message)

    def warning(self, key: str, message: str):
        """Report something that works, but not as well as it could."""
        self.problem(key, message, DiagnosticStatus.WARN)

    def solved(self, key: str):
        """Take a problem back."""
        self._problems.pop(key, None)

    def count(self, name: str, n: int = 1):
        """Add to a counter."""
        self._counts[name] = self._counts.get(name, 0) + n

    def value(self, name: str, value: object):
        """Set a value shown beside the counters."""
        self._values[name] = str(value)

    def watch(self, topic: str, hint: str):
        """Report when nothing arrives on a topic; ``hint`` says where it should come from."""
        self._watches[topic] = _Watch(self._node.resolve_topic_name(topic), hint, 0.0)

    def unwatch(self, topic: str):
        """Say nothing more when a topic is silent: what it had to say is known."""
        self._watches.pop(topic, None)

    def arrived(self, topic: str, waited: float):
        """Note that something arrived on a topic and waited [s] before it was read."""
        if topic in self._watches:
            self._watches[topic].last = time.monotonic()
        self.count(f'messages on {topic}')
        if waited > LATE:
            self.warning(f'late {topic}', f'{waited:.1f} s behind on {topic}: this machine is '
                         'too slow for the stream; lower its rate or size, or free the CPU')
        else:
            self.solved(f'late {topic}')

    def status(self) -> DiagnosticStatus:
        """Return the state now."""
        problems = {**self._silences(), **self._problems}
        level = max((level for level, _ in problems.values()), default=DiagnosticStatus.OK)
        worst = [message for at, message in problems.values() if at == level]
        others = {key: message for key, (at, message) in problems.items() if at != level}
        values = {**self._values, **{k: str(v) for k, v in self._counts.items()}, **others}
        return DiagnosticStatus(
            level=level, name=self._node.get_fully_qualified_name().lstrip('/'),
            hardware_id='mv_slapse', message='; '.join(worst) or 'ok',
            values=[KeyValue(key=key, value=value) for key, value in sorted(values.items())])

    def publish(self):
        """Publish the state now."""
        msg = DiagnosticArray(status=[self.status()])
        msg.header.stamp = self._node.get_clock().now().to_msg()
        self._publisher.publish(msg)

    def _silences(self) -> dict[str, tuple[bytes, str]]:
        late = time.monotonic() - SILENCE
        return {f'input {watch.topic}': (DiagnosticStatus.WARN, self._silence(watch))
                for watch in self._watches.values() if watch.last < late}

    def _silence(self, watch: _Watch) -> str:
        n = self._node.count_publishers(watch.topic)
        said = 'is silent' if n else 'has no publisher'
        return f'{watch.topic} {said}: {watch.hint}'
