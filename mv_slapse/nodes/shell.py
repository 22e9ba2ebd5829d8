"""What all nodes share: parameters, diagnostics, ~/reset, ~/pause, and an orderly end."""

from collections.abc import Callable
import faulthandler
import signal
import time
from typing import Any

from mv_slapse.errors import MvSlapseError
from mv_slapse.nodes import parameters
from mv_slapse.nodes.health import Health
from mv_slapse.nodes.settings import NODE_SETTINGS
import rclpy
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.logging import get_logger
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from std_srvs.srv import SetBool, Trigger

POLL = 0.5  # [s] at most between a signal and its effect, beside the callback that runs
END_TIME = 5.0  # [s] after which a process that cannot end is ended, as ros2 launch waits as long
RCLError = rclpy_implementation.RCLError


class Shell(Node):
    """A node around a core object, which subclasses make anew in ``restart``."""

    def __init__(self, name: str, **kwargs):
        """Declare the parameters of the node ``name`` and offer the services."""
        super().__init__(name, **kwargs)
        self.settings = parameters.declare(self, NODE_SETTINGS[name])
        self.health = Health(self)
        self.paused = False
        self.create_service(Trigger, '~/reset', self._on_reset)
        self.create_service(SetBool, '~/pause', self._on_pause)

    def restart(self):
        """Forget everything but parameters and camera."""
        raise NotImplementedError

    def guarded(self, topic: str, callback: Callable[[Any], None]) -> Callable[..., None]:
        """Return a callback that notes arrivals, heeds ~/pause, and reports what it cannot use."""
        def on_message(msg, info):
            """Note the arrival and try the callback."""
            self.health.arrived(topic, (time.time_ns() - info['received_timestamp']) / 1e9)
            if not self.paused:
                self.attempt(topic, callback, msg)

        return on_message

    def attempt(self, topic: str, callback: Callable[..., None], *args):
        """Call, and report an input that cannot be used instead of ending."""
        try:
            callback(*args)
            self.health.solved(topic)
        except MvSlapseError as error:
            self.get_logger().error(f'{topic}: {error}', throttle_duration_sec=5.0)
            self.health.problem(topic, f'{topic}: {error}')

    def _on_reset(self, _request, response):
        self.restart()
        self.get_logger().info('reset: started anew')
        response.success, response.message = True, 'started anew'
        return response

    def _on_pause(self, request, response):
        self.paused = request.data
        if self.paused:
            self.health.warning('pause', 'paused: call ~/pause with data: false to go on')
        else:
            self.restart()
            self.health.solved('pause')
        response.success, response.message = True, 'paused' if self.paused else 'running'
        return response


def run(node_type: Callable[[], Node], args: list[str] | None = None) -> int:
    """Run a node until the process is told to stop; return the exit code for it.

    The signals are Python's here, not rclpy's: they only ask the loop to end, so that nothing is
    torn down under a callback's hands.
    """
    node, executor, stop = None, None, _Stop()
    try:
        rclpy.init(args=args, signal_handler_options=SignalHandlerOptions.NO)
        node = node_type()
        executor = SingleThreadedExecutor()
        executor.add_node(node)
        while not stop.asked and rclpy.ok():
            executor.spin_once(timeout_sec=POLL)
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
