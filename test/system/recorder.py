"""Record ROS topics as raw CDR into a bag."""

from collections import Counter
from functools import partial
from pathlib import Path
import time

from diagnostic_msgs.msg import DiagnosticArray
from mv_slapse.storage.messages import typestore
import rclpy
from rclpy.qos import DurabilityPolicy, QoSProfile
from rclpy.serialization import deserialize_message
from rosbags.rosbag2 import StoragePlugin, Writer
from system.player import message_type

LATCHED = QoSProfile(depth=100, durability=DurabilityPolicy.TRANSIENT_LOCAL)


class Recorder:
    """Writes what comes on some topics; a context manager."""

    def __init__(self, path: Path, topics: dict[str, str], latched: tuple[str, ...] = ()):
        """Subscribe to ``topics``, name to type."""
        self.counts = Counter()
        self.last = time.monotonic()
        self.nodes = {}  # what each says on /diagnostics, by name
        self.node = rclpy.create_node('recorder')
        self._subscriptions = []
        self._writer = Writer(path, version=9, storage_plugin=StoragePlugin.MCAP)
        self._writer.open()
        for topic, kind in topics.items():
            connection = self._writer.add_connection(topic, kind, typestore=typestore())
            self._subscriptions.append(self.node.create_subscription(
                message_type(kind), topic, partial(self._write, connection),
                LATCHED if topic in latched else QoSProfile(depth=1000), raw=True))

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self._writer.close()
        self.node.destroy_node()

    def spin(self, until, timeout: float) -> bool:
        """Record until a condition holds; return whether it did in time."""
        end = time.monotonic() + timeout
        while not until() and time.monotonic() < end:
            rclpy.spin_once(self.node, timeout_sec=0.1)
        return bool(until())

    def finds_all(self) -> bool:
        """Return whether each topic has a publisher that the recorder is connected to."""
        return all(subscription.get_publisher_count() for subscription in self._subscriptions)

    def silent_for(self, seconds: float) -> bool:
        """Return whether nothing has come for so long."""
        return time.monotonic() - self.last > seconds

    def _write(self, connection, data: bytes, info: dict):
        # by the time of sending: the order in which topics are read here says nothing
        self._writer.write(connection, info['source_timestamp'], data)
        if connection.topic == '/diagnostics':
            for status in deserialize_message(data, DiagnosticArray).status:
                self.nodes[status.name] = {item.key: item.value for item in status.values}
        else:
            self.last = time.monotonic()
        self.counts[connection.topic] += 1
