"""A ROS peer for tests: publishes, listens, and spins together with the node under test."""

from contextlib import contextmanager
import time

from mv_slapse.nodes.supervision import SupervisedExecutor
import rclpy
from rclpy.parameter import Parameter
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy

LATCHED = QoSProfile(depth=20, durability=DurabilityPolicy.TRANSIENT_LOCAL)
RELIABLE = QoSProfile(depth=100)
BEST_EFFORT = QoSProfile(depth=100, reliability=ReliabilityPolicy.BEST_EFFORT)


class Bench:
    """Holds the nodes under test and a peer node in one executor."""

    def __init__(self):
        self.peer = rclpy.create_node('peer')
        self.escaped = []  # (what it came from, exception) of what no border held
        self._executor = SupervisedExecutor(lambda *what: self.escaped.append(what))
        self._executor.add_node(self.peer)
        self._nodes = []

    def start(self, node_type, **parameters):
        """Return a new node with these parameters (``a__b`` is the parameter ``a.b``).

        It may fall behind as far as it will, unless told otherwise: the machine may be busy.
        """
        parameters = {'max_latency': 3600.0, **parameters}
        overrides = [Parameter(name.replace('__', '.'), value=value)
                     for name, value in parameters.items()]
        node = node_type(parameter_overrides=overrides)
        self._nodes.append(node)
        self._executor.add_node(node)
        return node

    def listen(self, message_type, topic, profile=RELIABLE):
        """Return the list to which the messages of a topic are added."""
        received = []
        self.peer.create_subscription(message_type, topic, received.append, profile)
        return received

    def advertise(self, message_type, topic, profile=RELIABLE, subscribers=1):
        """Return a publisher that the node under test has connected to."""
        publisher = self.peer.create_publisher(message_type, topic, profile)
        assert self.spin(lambda: publisher.get_subscription_count() >= subscribers), topic
        return publisher

    def spin(self, until, timeout=5.0):
        """Spin until a condition holds; return whether it does."""
        end = time.monotonic() + timeout
        while not until() and time.monotonic() < end:
            self._executor.spin_once(timeout_sec=0.05)
        return bool(until())

    def call(self, service_type, name, **fields):
        """Return the response of a service of the node under test."""
        client = self.peer.create_client(service_type, name)
        assert self.spin(client.service_is_ready), name
        future = client.call_async(service_type.Request(**fields))
        assert self.spin(future.done), name
        return future.result()

    def close(self):
        for what, error in self.escaped:
            raise AssertionError(f'{what} raised') from error
        for node in [*self._nodes, self.peer]:
            self._executor.remove_node(node)
            node.destroy_node()
        self._executor.shutdown()


@contextmanager
def bench():
    """Start ROS and give a bench."""
    rclpy.init()
    made = Bench()
    try:
        yield made
    finally:
        made.close()
        rclpy.shutdown()


def held_up(node, seconds):
    """Let what comes to a node from now on look as if it had waited so long [s]."""
    node.latency.waited = lambda came=None: seconds


def value_of(node, name) -> str:
    """Return a value beside the message of /diagnostics, empty where there is none."""
    return {item.key: item.value for item in node.health.status().values}.get(name, '')


def messages_of(node) -> str:
    """Return what a node would say on /diagnostics now."""
    return node.health.status().message
