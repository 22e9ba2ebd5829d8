"""Subscriptions that say what is wrong when a publisher's QoS does not fit."""

from collections.abc import Callable

from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.subscription import Subscription

#: columns of a few key frame pairs; deep enough that a late reader loses nothing
RELIABLE = QoSProfile(depth=100, reliability=ReliabilityPolicy.RELIABLE)
LATCHED = QoSProfile(depth=1, reliability=ReliabilityPolicy.RELIABLE,
                     durability=DurabilityPolicy.TRANSIENT_LOCAL)


def subscribe(node: Node, message_type: type, topic: str, callback: Callable[..., None],
              profile: QoSProfile = RELIABLE) -> Subscription:
    """Subscribe raw, and report a publisher with incompatible QoS and messages lost on the way.

    The callback is one that ``Shell.guarded`` makes: it gets bytes and information on them. The
    node has a ``health`` (see ``nodes.shell``) that takes the reports.
    """
    name = node.resolve_topic_name(topic)

    def on_incompatible(event):
        """Say which settings of both sides do not fit."""
        message = mismatch(node, name, profile)
        node.get_logger().error(message)
        if not node.health.has_arrived(topic):  # else another publisher does
            node.health.enter('qos', message, topic)

    def on_lost(event):
        """Count messages that the middleware has lost."""
        lost(node, name, event.total_count_change)

    events = SubscriptionEventCallbacks(incompatible_qos=on_incompatible, message_lost=on_lost)
    return node.create_subscription(message_type, topic, callback, profile,
                                    event_callbacks=events, raw=True)


def is_heard(*publishers: Publisher) -> bool:
    """Return whether anybody subscribes: a message for nobody costs as much as one for many."""
    return any(publisher.get_subscription_count() for publisher in publishers)


def lost(node: Node, topic: str, n: int):
    """Count and report messages that the middleware has lost."""
    node.health.count(f'lost on {topic}', n)
    node.health.enter('dropped', f'{topic} loses messages: make its publisher reliable, or raise '
                      'qos_depth where the node has that parameter', topic, lasts=10.0)


def mismatch(node: Node, topic: str, asked: QoSProfile) -> str:
    """Return what is wrong between a subscription and the publishers of a topic, and the fix."""
    offers = [info.qos_profile for info in node.get_publishers_info_by_topic(topic)]
    offered = ' and '.join(sorted({text(offer) for offer in offers})) or 'something else'
    return (f'no messages from {topic}: it is published {offered}, but subscribed '
            f'{text(asked)}; {_fix(offers, asked)}')


def text(profile: QoSProfile) -> str:
    """Return the two policies that can clash, in words."""
    return (f'{profile.reliability.name.lower().replace("_", " ")}, '
            f'{profile.durability.name.lower().replace("_", " ")}')


def video_profile(node: Node, topic: str, reliability: str, depth: int) -> QoSProfile:
    """Return the QoS for the video: as asked, else reliable where every publisher is."""
    reliable = reliability == 'reliable'
    if reliability == 'auto':
        offers = [i.qos_profile.reliability for i in node.get_publishers_info_by_topic(topic)]
        reliable = all(offer == ReliabilityPolicy.RELIABLE for offer in offers)
    policy = ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT
    return QoSProfile(depth=depth, reliability=policy)


def _fix(offers: list[QoSProfile], asked: QoSProfile) -> str:
    best_effort = any(o.reliability == ReliabilityPolicy.BEST_EFFORT for o in offers)
    if best_effort and asked.reliability == ReliabilityPolicy.RELIABLE:
        return ('make the publisher reliable, or set qos_reliability to best_effort where the '
                'node has that parameter')
    return 'make the publisher transient local (latched)'
