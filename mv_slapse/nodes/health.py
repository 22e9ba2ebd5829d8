"""What a node knows about its own state, on /diagnostics at 1 Hz."""

from collections.abc import Callable
from dataclasses import dataclass
import time

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from mv_slapse.states import CONDITIONS, Kind
from rclpy.clock import Clock
from rclpy.clock_type import ClockType
from rclpy.node import Node
from rclpy.timer import Timer

SILENCE = 3.0  # [s] without input or output before it is reported
LEVELS = {Kind.FAILED: DiagnosticStatus.ERROR, Kind.WAITING: DiagnosticStatus.WARN,
          Kind.DEGRADED: DiagnosticStatus.WARN, Kind.WORKING: DiagnosticStatus.OK}
ORDER = {key: place for place, key in enumerate(CONDITIONS)}
#: what is said as long as nothing has come out, and taken back by the first output
HINDERS = ('fault', 'unusable', 'undecodable', 'no_key_frame', 'rejected')
OWN = ('/clock', '/parameter_events')  # topics that each node has


def every(node: Node, period: float, callback: Callable[[], None]) -> Timer:
    """Call back every ``period`` seconds of real time, also where /clock stands still."""
    return node.create_timer(period, callback, clock=Clock(clock_type=ClockType.STEADY_TIME))


@dataclass
class _Watch:
    topic: str
    hint: str
    last: float


@dataclass(frozen=True)
class _Entered:
    key: str
    message: str
    until: float


class Health:
    """Conditions, inputs and counters of a node; the worst condition is what it reports."""

    def __init__(self, node: Node):
        """Publish every second of real time, whatever /clock does."""
        self._node = node
        self._entered: dict[tuple[str, str], _Entered] = {}
        self._counts: dict[str, int] = {}
        self._values: dict[str, str] = {}
        self._fresh: dict[str, tuple[str, float]] = {}
        self._watches: dict[str, _Watch] = {}
        self._worked = -float('inf')
        self._publisher = node.create_publisher(DiagnosticArray, '/diagnostics', 10)
        every(node, 1.0, self.publish)

    def enter(self, key: str, said: str = '', part: str = '', lasts: float = float('inf')):
        """Enter a condition of CONDITIONS, until it is left or for ``lasts`` seconds.

        ``said`` takes the place of its meaning and next step; ``part`` is the topic or the like
        to which it belongs, so that several can be in it.
        """
        condition = CONDITIONS[key]
        message = said or f'{condition.meaning}; {condition.next_step}'
        self._entered[key, part] = _Entered(key, message, time.monotonic() + lasts)

    def leave(self, *keys: str, part: str | None = None):
        """Leave conditions, of one part or of all."""
        for key, of in list(self._entered):
            if key in keys and part in (None, of):
                del self._entered[key, of]

    def set(self, key: str, holds: bool, said: str = ''):
        """Enter or leave a condition."""
        if holds:
            self.enter(key, said)
        else:
            self.leave(key)

    def worked(self):
        """Note that something usable has come out: what hindered it before does so no more."""
        self._worked = time.monotonic()
        self.leave(*HINDERS)

    def restarted(self):
        """Forget what was known of the input so far."""
        self._worked = -float('inf')
        self._fresh.clear()
        self.leave('lost', 'initialising', 'broken', 'no_motion', 'predicted', 'overload', 'clock',
                   'no_pose', 'no_scale', *HINDERS)

    def count(self, name: str, n: int = 1):
        """Add to a counter."""
        self._counts[name] = self._counts.get(name, 0) + n

    def value(self, name: str, value: object):
        """Set a value shown beside the counters."""
        self._values[name] = str(value)

    def fresh(self, name: str, value: object):
        """Set a value that is true only as long as it is renewed."""
        self._fresh[name] = str(value), time.monotonic()

    def watch(self, topic: str, hint: str):
        """Report when nothing arrives on a topic; ``hint`` says where it should come from."""
        self._watches[topic] = _Watch(self._node.resolve_topic_name(topic), hint, 0.0)

    def unwatch(self, topic: str):
        """Say nothing more when a topic is silent: what it had to say is known."""
        self._watches.pop(topic, None)

    def arrived(self, topic: str):
        """Note that something arrived on a topic."""
        if topic in self._watches:
            self._watches[topic].last = time.monotonic()
        self.leave('qos', part=topic)
        self.count(f'messages on {topic}')

    def has_arrived(self, topic: str) -> bool:
        """Return whether anything ever arrived on a topic."""
        return f'messages on {topic}' in self._counts

    def status(self) -> DiagnosticStatus:
        """Return the state now."""
        found = sorted(self._conditions(), key=lambda entry: ORDER[entry.key])
        kind = min((self._kind(entry.key) for entry in found), default=Kind.WORKING)
        worst = [entry for entry in found if self._kind(entry.key) == kind]
        if [entry.key for entry in worst] == ['no_output']:
            worst = found  # what does not work well may be why
        others = {entry.key: entry.message for entry in found if entry not in worst}
        values = {'state': kind.name.lower(), 'condition': worst[0].key if worst else 'working',
                  **self._values, **self._fresh_values(),
                  **{k: str(v) for k, v in self._counts.items()}, **self._connected(), **others}
        return DiagnosticStatus(
            level=LEVELS[kind], name=self._node.get_fully_qualified_name().lstrip('/'),
            hardware_id='mv_slapse', message=_text(kind, worst),
            values=[KeyValue(key=key, value=value) for key, value in sorted(values.items())])

    def publish(self):
        """Publish the state now."""
        msg = DiagnosticArray(status=[self.status()])
        msg.header.stamp = self._node.get_clock().now().to_msg()
        self._publisher.publish(msg)

    def _conditions(self) -> list[_Entered]:
        """Return what holds now; nothing of it is OK while nothing comes out."""
        now = time.monotonic()
        self._entered = {at: entry for at, entry in self._entered.items() if now < entry.until}
        found = [*self._entered.values(), *self._silences()]
        kinds = {self._kind(entry.key) for entry in found}
        if self._is_idle() and not kinds & {Kind.FAILED, Kind.WAITING}:
            condition = CONDITIONS['no_output']
            said = f'{condition.meaning} {self._since()}; {condition.next_step}'
            found.insert(0, _Entered('no_output', said, now))
        return found

    def _kind(self, key: str) -> Kind:
        """Return the kind of a condition; where all that comes is rejected it has failed."""
        return Kind.FAILED if key == 'rejected' and self._is_idle() else CONDITIONS[key].kind

    def _is_idle(self) -> bool:
        return time.monotonic() - self._worked > SILENCE

    def _since(self) -> str:
        age = time.monotonic() - self._worked
        return 'yet' if age == float('inf') else f'for {age:.0f} s'

    def _fresh_values(self) -> dict[str, str]:
        now = time.monotonic()
        return {name: value if now - at <= SILENCE else f'unknown ({value} {now - at:.0f} s ago)'
                for name, (value, at) in self._fresh.items()}

    def _connected(self) -> dict[str, str]:
        """Return how many publishers the middleware has connected, of each topic."""
        found = {}
        for one in self._node.subscriptions:
            name = f'publishers of {one.topic_name}'
            found[name] = max(found.get(name, 0), one.get_publisher_count())
        return {name: str(n) for name, n in found.items() if not name.endswith(OWN)}

    def _silences(self) -> list[_Entered]:
        now = time.monotonic()
        return [self._silence(watch, now) for watch in self._watches.values()
                if now - watch.last > SILENCE]

    def _silence(self, watch: _Watch, now: float) -> _Entered:
        silent = self._node.count_publishers(watch.topic) > 0
        said = 'is silent' if silent else 'has no publisher'
        return _Entered('silent' if silent else 'no_publisher',
                        f'{watch.topic} {said}: {watch.hint}', now)


def _text(kind: Kind, entries: list[_Entered]) -> str:
    """Return what is said of the worst conditions; a next step that several have, once."""
    steps = [entry.message.partition(': ')[2] for entry in entries]
    said = '; '.join(entry.message.removesuffix(f': {step}') if step in steps[i + 1:]
                     else entry.message for i, (entry, step) in enumerate(zip(
                         entries, steps, strict=True)))
    return f'{kind.name.lower()}: {said}' if said else 'ok'
