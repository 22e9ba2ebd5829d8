"""What all nodes share: parameters, diagnostics, ~/reset, ~/pause, the border, an orderly end."""

from collections.abc import Callable
import faulthandler
import gc
import signal
import sys
import time
from typing import Any

from mv_slapse import heap
from mv_slapse.errors import MvSlapseError
from mv_slapse.message_checks import InvalidMessage
from mv_slapse.nodes import parameters
from mv_slapse.nodes.gate import Gate
from mv_slapse.nodes.health import every, Health, SILENCE
from mv_slapse.nodes.latency import Latency
from mv_slapse.nodes.settings import NODE_SETTINGS
from mv_slapse.nodes.standby import stand_by
from mv_slapse.nodes.supervision import SupervisedExecutor, Tracebacks
import rclpy
from rclpy.executors import ExternalShutdownException
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.logging import get_logger
from rclpy.node import Node
from rclpy.serialization import deserialize_message
from rclpy.signals import SignalHandlerOptions
from std_srvs.srv import SetBool, Trigger

POLL = 0.5  # [s] at most between a signal and its effect, beside the callback that runs
END_TIME = 5.0  # [s] after which a process that cannot end is ended, as ros2 launch waits as long
GIVE_BACK = 20.0  # [s] after which free pages go back to the system, within 3 to 11 ms
DRAINING = 0.1  # [s] between two looks whether what is held back can be passed on
BACKWARDS = 1_000_000_000  # [ns] a stamp this much earlier is a new run, no B frame or odd clock
SPARING = 5.0  # [s] between two lines of one kind in the log
RCLError = rclpy_implementation.RCLError


class Shell(Node):
    """A node around a core object, which subclasses make anew in ``restart``.

    Attributes
    ----------
    settings : dict
        Settings class -> its values now; those that may change live are looked up when used.
    resets : int
        How often a trajectory, or the like, began anew.
    """

    def __init__(self, name: str, **kwargs):
        """Declare the parameters of the node ``name`` and offer the services."""
        super().__init__(name, **kwargs)
        self.settings = parameters.declare(self, NODE_SETTINGS[name])
        self.health = Health(self)
        self.latency = Latency(self)
        self.paused, self.resets = False, 0
        self._tracebacks = Tracebacks()
        self.create_service(Trigger, '~/reset', self._on_reset)
        self.create_service(SetBool, '~/pause', self._on_pause)
        parameters.follow(self, NODE_SETTINGS[name], self.on_settings)

    def restart(self):
        """Forget everything but parameters and camera."""
        raise NotImplementedError

    def go_on(self):
        """Begin anew where the last output has ended; by default simply anew."""
        self.begin_anew()

    def on_settings(self, changed: set[type]):
        """Heed that settings of these classes have changed."""

    def begin_anew(self, reason: str = ''):
        """Restart, count it, and say why."""
        if reason:
            self.get_logger().warning(f'{reason}: starting anew')
        self.count_reset()
        self.health.restarted()
        self.restart()

    def count_reset(self):
        """Count that a trajectory begins anew, or elsewhere, and tell the count."""
        self.resets += 1
        self.health.value('resets', self.resets)

    def guarded(self, topic: str, message_type: type, callback: Callable[[Any], None],
                proves: bool = False, comes_once: bool = False) -> Callable[..., None]:
        """Return the callback of a raw subscription: it heeds ~/pause, and nothing ends it.

        What ``comes_once``, as a pose that is given, is taken while the node pauses, too.

        The bytes are made a message here, inside the border: what cannot be is dropped and
        counted as well. ``proves``: whether an input that was used takes back the complaints
        about earlier ones; where it only leads to an output later, the output does.
        """
        def on_bytes(data: bytes, info: dict):
            """Note the arrival and try the callback."""
            self.health.arrived(topic)
            if comes_once or not self.paused:
                self.latency.begin((time.time_ns() - info['received_timestamp']) / 1e9)
                self.attempt(topic, receive, data, proves=proves)

        def receive(data: bytes):
            """Make the message and call back."""
            callback(_message(data, message_type))

        return on_bytes

    def keep_draining(self, part: str, gate: Gate):
        """Ask again and again whether a gate is open, until it has opened: each time costs."""
        def drain():
            """Ask, and be called no more."""
            self.attempt(part, gate.drain)
            if gate.is_done:
                timer.cancel()

        timer = every(self, DRAINING, drain)

    def attempt(self, part: str, callback: Callable[..., Any], *args: Any,
                recover: Callable[[], None] | None = None, proves: bool = False) -> Any:
        """Call; where that raises report it, and after a foreign error start the part anew.

        Returns what the call does, None where it raised.
        """
        try:
            result = callback(*args)
        except InvalidMessage as error:
            self.reject(part, error)
        except MvSlapseError as error:
            self.get_logger().error(f'{part}: {error}', throttle_duration_sec=SPARING)
            self.health.count(f'unusable on {part}')
            self.health.enter('unusable', _prefixed(part, error), part)
        except Exception as error:
            self._recover(part, recover or self.go_on)
            self.fault(part, error)
        else:
            if proves:
                self.health.leave('unusable', 'fault', 'rejected', part=part)
            return result
        return None

    def reject(self, part: str, error: Exception):
        """Report a message that was dropped."""
        self.get_logger().error(f'{part}: {error}', throttle_duration_sec=SPARING)
        self.health.count(f'rejected on {part}')
        self.health.enter('rejected', _prefixed(part, error), part, lasts=SILENCE)

    def fault(self, part: str, error: Exception):
        """Report an error that should not be, with its traceback once."""
        self.health.count('faults')
        said = f'{part}: {type(error).__name__}: {error}'
        trace = self._tracebacks.first(error)
        if trace:
            self.get_logger().error(f'{said}; started anew, please report this:\n{trace}')
        self.health.enter('fault', f'{said}; the part was started anew; report the traceback in '
                          'the log', part)

    def escaped(self, part: str, error: Exception):
        """Report what the executor caught outside our own callbacks: nothing is in disorder."""
        self.fault(part, error)
        self.health.leave('fault', part=part)

    def _recover(self, part: str, recover: Callable[[], None]):
        try:
            recover()
        except Exception as error:
            self.fault(f'restart of {part}', error)

    def _on_reset(self, _request, response):
        self.begin_anew()
        self.get_logger().info('reset: started anew')
        response.success, response.message = True, 'started anew'
        return response

    def _on_pause(self, request, response):
        if self.paused and not request.data:
            self.go_on()
        self.paused = request.data
        self.health.set('paused', self.paused)
        response.success, response.message = True, 'paused' if self.paused else 'running'
        return response


def _message(data: bytes, message_type: type) -> Any:
    try:
        return deserialize_message(data, message_type)
    except Exception as error:
        raise InvalidMessage(
            f'{len(data)} bytes are no {message_type.__name__} ({error}); the message is dropped, '
            'build publisher and subscriber with the same interface package') from None


def _prefixed(part: str, error: Exception) -> str:
    """Return an error's words, the part before them where they do not begin with it."""
    said = str(error)
    return said if said.lstrip('/').startswith(part) else f'{part}: {said}'


def run(node_type: Callable[[], Node], args: list[str] | None = None) -> int:
    """Run a node until the process is told to stop; return the exit code for it.

    The signals are Python's here, not rclpy's: they only ask the loop to end, so that nothing is
    torn down under a callback's hands.
    """
    code, place = stand_by(sys.argv if args is None else args)
    if code is not None:
        return code
    node, executor, stop = None, None, _Stop()
    heap.give_back_large_blocks()
    try:
        if not rclpy.ok():
            rclpy.init(args=args, signal_handler_options=SignalHandlerOptions.NO)
        node = node_type()
        if place is not None:  # The node has taken it.
            place.destroy_node()
        # What there is by now stays: a full garbage collection would look through it for 30 ms.
        gc.freeze()
        every(node, GIVE_BACK, heap.give_back_free_pages)
        # With a timeout the executor makes a timer for each callback, which costs some 0.2 ms.
        every(node, POLL, lambda: None)
        executor = SupervisedExecutor(node.escaped)
        executor.add_node(node)
        while not stop.asked and rclpy.ok():
            executor.spin_once()
    except (KeyboardInterrupt, ExternalShutdownException):
        pass
    except MvSlapseError as error:
        get_logger('mv_slapse').fatal(str(error))
        return error.exit_code
    except RCLError as error:
        get_logger('mv_slapse').fatal(str(error))
        return 2
    finally:
        # The middleware was seen to hang while it ended, once in a thousand processes.
        faulthandler.dump_traceback_later(END_TIME, exit=True)
        # Left to the interpreter's end an executor was seen to miss its handles, with a traceback.
        if executor is not None:
            executor.shutdown()
        if node is not None:
            node.destroy_node()
        rclpy.try_shutdown()
    return 0


class _Stop:
    """Notes that SIGINT or SIGTERM came; a second one interrupts at once."""

    def __init__(self):
        self.asked = False
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, self._ask)

    def _ask(self, _number, _frame):
        if self.asked:
            raise KeyboardInterrupt
        self.asked = True
