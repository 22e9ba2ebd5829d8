"""Fields to messages, and messages of cameras to records.

Records and their fields are paired in ``mv_slapse.fields``, which bags use as well; here the
fields enter the classes of rclpy. Long arrays go in as ``array.array``: a list or an ndarray
would be checked element by element.
"""

from array import array
from functools import cache
from importlib import import_module
from typing import Any

from builtin_interfaces.msg import Time
from mv_slapse import fields
from mv_slapse import message_checks as check
from mv_slapse.geometry.calibration import camera_from_calibration
from mv_slapse.geometry.camera import Camera
import numpy as np
from sensor_msgs.msg import CameraInfo

VARIANCE_MIN, VARIANCE_MAX = 1e-9, 1e6
FOCAL = np.array([0.05, 1000.0])  # bounds of a focal length, in sides of the picture


def to_message(message_type: type, values: dict[str, Any]) -> Any:
    """Return a message whose fields hold the values, nested as ``mv_slapse.fields`` gives them."""
    msg = message_type()
    _fill(msg, values)
    return msg


def stamp_to_msg(stamp: int) -> Time:
    """Return the message of a stamp [ns]."""
    return to_message(Time, fields.stamp_to_fields(stamp))


def camera_from_msg(msg: CameraInfo, topic: str = 'camera_info') -> Camera:
    """Return the camera of a sensor_msgs/CameraInfo, for the pictures as they are published.

    Binning and region of interest of a driver move and scale the pixels: full-resolution pixel u
    is seen at (u - offset + 0.5) / binning - 0.5, pixels being centred at integers.
    """
    size = np.array([msg.roi.width or msg.width, msg.roi.height or msg.height], np.int64)
    K = np.array(msg.k, float).reshape(3, 3)
    binning = np.maximum([msg.binning_x, msg.binning_y], 1).astype(np.int64)
    if np.any(binning > 1) or msg.roi.x_offset or msg.roi.y_offset:
        offset = np.array([msg.roi.x_offset, msg.roi.y_offset])
        K[:2, 2] = (K[:2, 2] - offset + 0.5) / binning - 0.5
        K[:2, :2] /= binning[:, None]
    width, height = (int(n) for n in size // binning)
    camera = camera_from_calibration((width, height), K, msg.distortion_model, msg.d, topic)
    check.size(width, height)
    low, high = FOCAL * max(width, height)
    check.within(camera.K[[0, 1], [0, 1]], 'focal length (k[0], k[4])', low, high)
    return camera


def bounded_covariance(covariance: np.ndarray) -> np.ndarray:
    """Return a flat covariance (36,) whose variances lie within what consumers can invert."""
    C = np.reshape(covariance, (6, 6))
    shrink = np.sqrt(np.minimum(1.0, VARIANCE_MAX / np.maximum(np.diag(C), VARIANCE_MIN)))
    C = shrink[:, None] * C * shrink
    return (C + VARIANCE_MIN * np.eye(6)).ravel()


def column(typecode: str, values: np.ndarray) -> array:
    """Return a contiguous array as what a long message field takes without a copy by element."""
    entry = array(typecode)
    entry.frombytes(np.ascontiguousarray(values, np.dtype(typecode)).tobytes())
    return entry


def _fill(msg: Any, values: dict[str, Any]):
    """Give a message its values; a message inside it is there already, and its own."""
    for name, value in values.items():
        default = getattr(msg, name)
        if isinstance(value, dict):
            _fill(default, value)
        else:
            setattr(msg, name, _entry(type(msg), name, default, value))


def _entry(message_type: type, name: str, default: Any, value: Any) -> Any:
    if isinstance(default, array):
        return column(default.typecode, value)
    if isinstance(default, np.ndarray):
        return np.asarray(value, default.dtype)
    if isinstance(default, list) and value and isinstance(value[0], dict):
        item_type = _item_type(message_type, name)
        return [to_message(item_type, item) for item in value]
    return value


@cache
def _item_type(message_type: type, name: str) -> type:
    """Return the message class of the items of a sequence."""
    at = list(message_type.get_fields_and_field_types()).index(name)
    item = message_type.SLOT_TYPES[at].value_type
    return getattr(import_module('.'.join(item.namespaces)), item.name)
