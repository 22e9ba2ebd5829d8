"""Message classes for bags: Jazzy's types, this package's, and two of video packages."""

from collections.abc import Iterator
from functools import cache
import os
from pathlib import Path
import sys
from typing import Any

from mv_slapse.errors import UnusableInput
from mv_slapse.fields import Fields
import numpy as np
from rosbags.interfaces import Nodetype
from rosbags.typesys import get_types_from_msg, get_typestore, Stores
from rosbags.typesys.store import Typestore

VIDEO_DEFINITIONS = {
    'ffmpeg_image_transport_msgs/msg/FFMPEGPacket': (
        'std_msgs/Header header\nint32 width\nint32 height\nstring encoding\nuint64 pts\n'
        'uint8 flags\nbool is_bigendian\nuint8[] data\n'),
    'foxglove_msgs/msg/CompressedVideo': (
        'builtin_interfaces/Time timestamp\nstring frame_id\nuint8[] data\nstring format\n'),
}


@cache
def typestore() -> Typestore:
    """Return the types of Jazzy, of mv_slapse_msgs and of the video messages."""
    store = get_typestore(Stores.ROS2_JAZZY)
    types: dict = {}
    for name, text in VIDEO_DEFINITIONS.items():
        types.update(get_types_from_msg(text, name))
    for path in sorted(definition_folder().glob('*.msg')):
        types.update(get_types_from_msg(path.read_text(), f'mv_slapse_msgs/msg/{path.stem}'))
    store.register(types)
    return store


def definition_folder() -> Path:
    """Return where the .msg files lie: in a source clone, or in an installed share folder.

    Raises
    ------
    UnusableInput
        Where neither is found.
    """
    for prefix in _prefixes():
        for folder in (prefix / 'msg_defs' / 'msg', prefix / 'share' / 'mv_slapse_msgs' / 'msg'):
            if (folder / 'Correspondences.msg').is_file():
                return folder
    raise UnusableInput('the message definitions of mv_slapse_msgs are not found; install the '
                        'package with its share folder (make setup, or colcon build)')


def to_message(name: str, values: Fields | Any) -> Any:
    """Return a message of the type ``name`` with the given fields, nested as they are.

    As in ROS, a field that is not given is zero or empty; one that does not exist is a KeyError.
    What is such a message already, as a whole or nested, stays itself.
    """
    make, definition, known = _layout(name)
    if isinstance(values, make):
        return values
    if not values.keys() <= known:
        raise KeyError(f'{name} has no field {", ".join(sorted(values.keys() - known))}')
    return make(*[_value(kind, values[field]) if field in values else _default(kind)
                  for field, kind in definition])


def serialize(name: str, values: Fields) -> bytes:
    """Return the CDR form of a message of the type ``name`` with the given fields."""
    return bytes(typestore().serialize_cdr(to_message(name, values), name))


@cache
def _layout(name: str) -> tuple[type, list, frozenset[str]]:
    """Return class, fields with their kinds, and names of the fields of a type."""
    store = typestore()
    _, definition = store.fielddefs[name]
    return store.types[name], definition, frozenset(field for field, _ in definition)


def _value(kind: tuple, value: Any) -> Any:
    node, detail = kind
    if node == Nodetype.NAME:
        return to_message(detail, value)
    if node == Nodetype.BASE:
        return value
    (item_node, item), _ = detail
    if item_node == Nodetype.NAME:
        return [to_message(item, entry) for entry in value]
    base = item[0]
    return list(value) if base == 'string' else np.ascontiguousarray(value, base)


def _default(kind: tuple) -> Any:
    node, detail = kind
    if node == Nodetype.NAME:
        return to_message(detail, {})
    if node == Nodetype.BASE:
        return '' if detail[0] == 'string' else {'bool': False}.get(detail[0], 0)
    (item_node, item), size = detail
    count = size if node == Nodetype.ARRAY else 0
    return _value(kind, [_default((item_node, item))] * count if item_node == Nodetype.BASE
                  else [{}] * count)


def _prefixes() -> Iterator[Path]:
    here = Path(__file__)
    yield from here.resolve().parents[2:]
    yield from here.absolute().parents[2:]
    yield from (Path(prefix) for prefix in os.environ.get('AMENT_PREFIX_PATH', '').split(
        os.pathsep) if prefix)
    yield Path(sys.prefix)
