"""Video from the topic ``video``, whatever type it has."""

from collections.abc import Callable
from functools import partial
from importlib import import_module
from typing import Any

from mv_slapse import video_messages
from mv_slapse.codec.packet import Packet, Picture
from mv_slapse.errors import UnusableInput
from mv_slapse.nodes import qos
from mv_slapse.nodes.health import every
from mv_slapse.nodes.settings import INPUT_TYPES, RELIABILITIES, require, VideoSettings
from mv_slapse.nodes.shell import Shell
from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.qos import QoSProfile, ReliabilityPolicy

TOPIC = 'video'
HINT = 'start the camera, remap video to its topic, or set source to a file or URL'
#: what the parameter input_type calls it -> type of the topic
TYPES = dict(zip(INPUT_TYPES[1:], video_messages.VIDEO_TYPES, strict=True))


class VideoTopic:
    """Subscribes as soon as type and QoS of the topic are known."""

    def __init__(self, node: Shell, deliver: Callable[[Packet | Picture, str], None]):
        """Look at the graph until the topic can be subscribed to."""
        self._node, self._deliver = node, deliver
        self._settings = node.settings[VideoSettings]
        require('input_type', self._settings.input_type, INPUT_TYPES)
        require('qos_reliability', self._settings.qos_reliability, RELIABILITIES)
        self._topic = node.resolve_topic_name(TOPIC)
        self._subscription = None
        node.health.watch(TOPIC, HINT)
        self._timer = every(node, 0.05, self._look)
        self._look()

    def restart(self):
        """Go on with what comes."""

    def close(self):
        """Nothing is open besides the subscription."""

    def _look(self):
        self._node.attempt(f'type of {TOPIC}', self._try_to_subscribe, recover=lambda: None,
                           proves=True)

    def _try_to_subscribe(self):
        name = self._type_name()
        if name is None:
            return
        self._timer.cancel()
        message_type = _message_type(self._topic, name)
        self._subscribe(message_type, partial(self._on_message, name), qos.video_profile(
            self._node, self._topic, self._settings.qos_reliability, self._settings.qos_depth))

    def _type_name(self) -> str | None:
        if self._settings.input_type != 'auto':
            return TYPES[self._settings.input_type]
        infos = self._node.get_publishers_info_by_topic(self._topic)
        names = sorted({info.topic_type for info in infos})
        usable = [name for name in names if name in TYPES.values()]
        if names and not usable:
            raise UnusableInput(f'{self._topic} has type {", ".join(names)}; remap video to a '
                                f'topic of type {", ".join(TYPES.values())}')
        return usable[0] if usable else None

    def _subscribe(self, message_type: type, callback: Callable, profile: QoSProfile):
        def on_incompatible(_):
            """Ask for less, where the reliability was left to us."""
            if self._settings.qos_reliability == 'auto':
                self._node.destroy_subscription(self._subscription)
                self._subscribe(message_type, callback, QoSProfile(
                    depth=profile.depth, reliability=ReliabilityPolicy.BEST_EFFORT))
                return
            message = qos.mismatch(self._node, self._topic, profile)
            self._node.get_logger().error(message)
            self._node.health.enter('qos', message, TOPIC)

        self._subscription = self._node.create_subscription(
            message_type, self._topic, self._node.guarded(TOPIC, message_type, callback), profile,
            raw=True, event_callbacks=SubscriptionEventCallbacks(
                incompatible_qos=on_incompatible, message_lost=self._on_lost))
        self._node.health.value('video', f'{self._topic}, {qos.text(profile)}')

    def _on_lost(self, event):
        qos.lost(self._node, TOPIC, event.total_count_change)

    def _on_message(self, type_name: str, msg: Any):
        content = video_messages.from_message(type_name, msg)
        self._deliver(content, self._settings.camera_frame
                      or video_messages.frame_of(type_name, msg))


def _message_type(topic: str, name: str) -> type:
    package, _, message = name.split('/')
    try:
        return getattr(import_module(f'{package}.msg'), message)
    except ImportError:
        raise UnusableInput(
            f'{topic} has type {name}, but the package {package} is not installed: sudo apt '
            f'install ros-jazzy-{package.replace("_", "-")}') from None
