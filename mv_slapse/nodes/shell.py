"""What all nodes share: parameters, diagnostics, ~/reset, ~/pause, and an orderly end."""

from collections.abc import Callable
import time
from typing import Any

from mv_slapse.errors import MvSlapseError
from mv_slapse.nodes import parameters
from mv_slapse.nodes.health import Health
from mv_slapse.nodes.settings import NODE_SETTINGS
import rclpy
from rclpy.executors import ExternalShutdownException
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.logging import get_logger
from rclpy.node import Node
from std_srvs.srv import SetBool, Trigger

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
    """Run a node until it is told to stop; return the exit code of the process."""
    node, started = None, False
    try:
        rclpy.init(args=args)
        started = True
        node = node_type()
        rclpy.spin(node)
    except (KeyboardInterrupt, ExternalShutdownException):
        pass
    except MvSlapseError as error:
        get_logger('mv_slapse').fatal(str(error))
        return error.exit_code
    except RCLError as error:
        # a publisher in use when the signal comes raises as well: that is no fault
        if not started or rclpy.ok():
            get_logger('mv_slapse').fatal(str(error))
            return 2
    finally:
        if node is not None:
            node.destroy_node()
        rclpy.try_shutdown()
    return 0
