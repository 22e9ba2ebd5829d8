"""The calibration of the camera, from a file or from ``camera_info``."""

from collections.abc import Callable
from pathlib import Path

from ament_index_python.packages import get_package_share_directory, PackageNotFoundError
from mv_slapse import fields
from mv_slapse.errors import MvSlapseError, UsageError
from mv_slapse.geometry.camera import Camera
from mv_slapse.nodes.qos import LATCHED
from mv_slapse.nodes.settings import CameraSettings
from mv_slapse.nodes.shell import Shell
from mv_slapse.storage.camera_info import read_camera
import numpy as np
from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.qos import qos_profile_sensor_data
from sensor_msgs.msg import CameraInfo

TOPIC = 'camera_info'
HINT = 'start the camera driver, remap camera_info, or set camera_info_url to a calibration file'


class CameraInput:
    """Calls ``on_camera`` with the camera once it is known, and again when it changes."""

    def __init__(self, node: Shell, on_camera: Callable[[Camera], None]):
        """Read the file that the parameter names, or subscribe."""
        self.camera: Camera | None = None
        self._node, self._on_camera = node, on_camera
        url = node.settings[CameraSettings].camera_info_url
        if url:
            self._take(read_camera(path_of_url(url)))
        else:
            self._subscribe()

    def _subscribe(self):
        """Subscribe twice: only so both a volatile and an already sent latched one arrive."""
        self._node.health.watch(TOPIC, HINT)
        self._node.health.enter('no_camera', 'no camera_info yet: ' + HINT)
        silent = SubscriptionEventCallbacks(incompatible_qos=lambda _: None)
        callback = self._node.guarded(TOPIC, CameraInfo, self._on_message, comes_once=True)
        for profile in (qos_profile_sensor_data, LATCHED):
            self._node.create_subscription(CameraInfo, TOPIC, callback, profile,
                                           event_callbacks=silent, raw=True)

    def _on_message(self, msg: CameraInfo):
        try:
            camera = fields.camera_from_message(msg, self._node.resolve_topic_name(TOPIC))
        except MvSlapseError as error:
            self._node.get_logger().error(str(error), throttle_duration_sec=5.0)
            self._node.health.leave('no_camera')
            self._node.health.enter('bad_camera', str(error))
            return
        self._node.health.leave('bad_camera')
        if self.camera is None or not _same(self.camera, camera):
            self._take(camera)

    def _take(self, camera: Camera):
        before, self.camera = self.camera, camera
        self._node.health.leave('no_camera')
        self._node.health.unwatch(TOPIC)
        self._node.latency.opened()
        self._on_camera(camera)
        if before is not None:
            self._node.begin_anew('camera_info changed')


def path_of_url(url: str) -> Path:
    """Return the path of a calibration's URL: a plain path, file:// or package://."""
    scheme, separator, rest = url.partition('://')
    if not separator or scheme == 'file':
        return Path(rest or url).expanduser()
    if scheme != 'package':
        raise UsageError(f'camera_info_url = {url!r}: use a path, file:// or package://')
    package, _, path = rest.partition('/')
    try:
        return Path(get_package_share_directory(package)) / path
    except PackageNotFoundError:
        raise UsageError(f'camera_info_url = {url!r}: there is no package {package!r}; source '
                         'its workspace or give a path') from None


def _same(camera: Camera, other: Camera) -> bool:
    return (camera.lens == other.lens and (camera.width, camera.height) == (
        other.width, other.height) and np.array_equal(camera.K, other.K)
        and np.array_equal(camera.distortion, other.distortion))
