"""Replay a bag into ROS topics as raw CDR, at the rate at which it was recorded.

python player.py BAG [RATE [CAMERAS]]   CAMERAS is how many nodes need the calibration
"""

from importlib import import_module
from pathlib import Path
import sys
import time

import rclpy
from rclpy.duration import Duration
from rclpy.qos import QoSProfile
from rosbags.highlevel import AnyReader

CONNECTED = 20.0  # [s] to wait for subscribers


def message_type(name: str) -> type:
    package, _, message = name.split('/')
    return getattr(import_module(f'{package}.msg'), message)


def play(node, bag: Path, rate: float, cameras: int = 1) -> int:
    """Publish what the bag holds for which somebody listens; return how many messages."""
    with AnyReader([bag]) as reader:
        publishers = {c.topic: node.create_publisher(message_type(c.msgtype), c.topic,
                                                     QoSProfile(depth=100))
                      for c in reader.connections}
        # The calibration comes once a second: who misses it has missed half of a short bag.
        wanted = [(p, cameras if 'camera_info' in topic else 1)
                  for topic, p in publishers.items() if topic != '/ground_truth']
        wait(lambda: all(p.get_subscription_count() >= n for p, n in wanted), CONNECTED)
        begin, first, n = time.monotonic(), reader.start_time, 0
        for connection, stamp, data in reader.messages():
            time.sleep(max(0.0, begin + (stamp - first) / 1e9 / rate - time.monotonic()))
            publishers[connection.topic].publish(bytes(data))
            n += 1
    for publisher in publishers.values():
        publisher.wait_for_all_acked(Duration(seconds=5))
    return n


def wait(until, timeout: float):
    end = time.monotonic() + timeout
    while not until() and time.monotonic() < end:
        time.sleep(0.05)
    time.sleep(0.5)  # the other side learns of the match a little later


def main():
    rclpy.init()
    node = rclpy.create_node('bag_player')
    print(play(node, Path(sys.argv[1]), *map(float, sys.argv[2:])))
    node.destroy_node()
    rclpy.shutdown()


if __name__ == '__main__':
    main()
