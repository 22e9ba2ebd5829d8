"""Fields to messages.

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
import numpy as np

VARIANCE_MIN, VARIANCE_MAX = 1e-9, 1e6


def to_message(message_type: type, values: dict[str, Any]) -> Any:
    """Return a message whose fields hold the values, nested as ``mv_slapse.fields`` gives them."""
    msg = message_type()
    _fill(msg, values)
    return msg


def stamp_to_msg(stamp: int) -> Time:
    """Return the message of a stamp [ns]."""
    return to_message(Time, fields.stamp_to_fields(stamp))


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
        if all(isinstance(number, float) for number in value[0].values()):  # corners of outlines
            return [item_type(**item) for item in value]
        return [to_message(item_type, item) for item in value]
    return value


@cache
def _item_type(message_type: type, name: str) -> type:
    """Return the message class of the items of a sequence."""
    at = list(message_type.get_fields_and_field_types()).index(name)
    item = message_type.SLOT_TYPES[at].value_type
    return getattr(import_module('.'.join(item.namespaces)), item.name)
