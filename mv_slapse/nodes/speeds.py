"""Speeds of the vehicle from the topic ``wheel_odometry``, kept until their key frame."""

from collections import deque

from mv_slapse import fields
from mv_slapse.nodes.qos import subscribe
from mv_slapse.nodes.shell import Shell
from mv_slapse.records import Speed
from nav_msgs.msg import Odometry
from rclpy.qos import QoSProfile, ReliabilityPolicy

TOPIC = 'wheel_odometry'
KEPT = 1000  # speeds, 10 s at 100 Hz
APART = 5_000_000_000  # ns: no speed is so late, nor so early, where both use one clock
EITHER = QoSProfile(depth=100, reliability=ReliabilityPolicy.BEST_EFFORT)


class Speeds:
    """Collects the speeds that are published, if any are."""

    def __init__(self, node: Shell):
        """Subscribe; a best-effort subscription fits every publisher."""
        self._health = node.health
        self.restart()
        take = node.guarded(TOPIC, Odometry, self._on_message, proves=True)
        subscribe(node, Odometry, TOPIC, take, EITHER)

    def restart(self):
        """Forget what is kept."""
        self._kept: deque[Speed] = deque(maxlen=KEPT)

    def told(self, stamp: int) -> list[Speed]:
        """Return the speeds up to the stamp [ns] of a key frame, and drop them."""
        told = [speed for speed in self._kept if speed.stamp <= stamp]
        self._check(stamp)
        self._kept = deque((speed for speed in self._kept if speed.stamp > stamp), maxlen=KEPT)
        return told

    def _check(self, stamp: int):
        """Report speeds that belong to no key frame."""
        apart = min((abs(speed.stamp - stamp) for speed in self._kept), default=0)
        if apart > APART or self._kept:
            self._health.set('clock', apart > APART, f'{TOPIC} is stamped {apart / 1e9:.1f} s '
                             'apart from the video and not used: stamp both with one clock')

    def _on_message(self, msg: Odometry):
        self._kept.append(fields.speed_from_message(msg))
