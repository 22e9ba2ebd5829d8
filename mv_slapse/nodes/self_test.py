"""Whether ROS works here: one message through DDS and back. Run by ``mv_slapse doctor``."""

import sys
import time

from mv_slapse_msgs.msg import Correspondences
import rclpy
from rclpy.utilities import get_rmw_implementation_identifier

SECONDS = 5.0


def echo(sent: Correspondences) -> Correspondences | None:
    """Publish a message and return it as received, or None where it does not come."""
    node, received = rclpy.create_node('mv_slapse_self_test'), []
    node.create_subscription(Correspondences, '~/echo', received.append, 1)
    publisher = node.create_publisher(Correspondences, '~/echo', 1)
    end = time.monotonic() + SECONDS
    while not received and time.monotonic() < end:
        if publisher.get_subscription_count():
            publisher.publish(sent)
        rclpy.spin_once(node, timeout_sec=0.1)
    node.destroy_node()
    return received[0] if received else None


def main() -> int:
    """Send a message and say how it went; 0 where it came back whole."""
    sent = Correspondences(width=1240, reason='self test')
    rclpy.init()
    try:
        received = echo(sent)
    finally:
        rclpy.try_shutdown()
    if received != sent:
        print(f'no message came back within {SECONDS:.0f} s')
        return 1
    print(f'a message came back over {get_rmw_implementation_identifier()}')
    return 0


if __name__ == '__main__':
    sys.exit(main())
