"""Pictures of ``sensor_msgs/Image`` in all encodings of cameras, as grey or BGR of 8 bits."""

from collections.abc import Callable
from typing import Any

import cv2
from mv_slapse.errors import UnusableInput
from mv_slapse.message_checks import count, size
import numpy as np

MAX_BYTES = 2**29  # 64 million pixels of 8 bytes
DEPTHS = (8, 10, 12, 14, 16)  # bits of cameras, at the lower end of 16

Decode = Callable[[np.ndarray], np.ndarray]


def _converted(code: int) -> Decode:
    return lambda image: cv2.cvtColor(image, code)


# encoding -> bytes a pixel, rows stored for each row of the picture, what makes grey or BGR of
# (rows, width, bytes) uint8. Only grey tells motion, so colour beside it is left out.
ENCODINGS: dict[str, tuple[int, float, Decode | None]] = {
    'mono8': (1, 1, None), '8UC1': (1, 1, None), 'bgr8': (3, 1, None), '8UC3': (3, 1, None),
    'rgb8': (3, 1, _converted(cv2.COLOR_RGB2BGR)), 'bgra8': (4, 1, _converted(cv2.COLOR_BGRA2BGR)),
    'rgba8': (4, 1, _converted(cv2.COLOR_RGBA2BGR)),
    # OpenCV names a mosaic by its second row.
    'bayer_rggb8': (1, 1, _converted(cv2.COLOR_BayerBG2GRAY)),
    'bayer_bggr8': (1, 1, _converted(cv2.COLOR_BayerRG2GRAY)),
    'bayer_gbrg8': (1, 1, _converted(cv2.COLOR_BayerGR2GRAY)),
    'bayer_grbg8': (1, 1, _converted(cv2.COLOR_BayerGB2GRAY)),
    **dict.fromkeys(('yuv422', 'uyvy'), (2, 1, lambda image: image[..., 1])),
    **dict.fromkeys(('yuv422_yuy2', 'yuyv'), (2, 1, lambda image: image[..., 0])),
    **dict.fromkeys(('nv12', 'nv21'), (1, 1.5, lambda image: image[:len(image) * 2 // 3])),
    'nv24': (1, 3, lambda image: image[:len(image) // 3])}
WIDE = {'mono16': 'mono8', 'bgr16': 'bgr8', 'rgb16': 'rgb8',
        **{f'{name[:-1]}16': name for name in ENCODINGS if name.startswith('bayer')}}


def picture_of(msg: Any) -> np.ndarray:
    """Return the picture of a ``sensor_msgs/Image``.

    16 bits become 8 by the depth of camera (10, 12, 14 or 16 bits) that its brightest pixel needs.

    Returns
    -------
    (height, width) or (height, width, 3) uint8
        Grey or BGR.

    Raises
    ------
    UnusableInput
        Where the encoding is not known, or there are too few bytes.
    """
    is_wide, name = msg.encoding in WIDE, WIDE.get(msg.encoding, msg.encoding)
    if name not in ENCODINGS:
        raise UnusableInput(f'pictures encoded as {msg.encoding!r} are not supported; publish one '
                            f'of {", ".join((*ENCODINGS, *WIDE))}')
    n, share, decode = ENCODINGS[name]
    stored = _stored(msg, n * (1 + is_wide), share)
    if is_wide:
        stored = _narrow(stored.view('>u2' if msg.is_bigendian else '<u2'))
    image = np.ascontiguousarray(stored.reshape(len(stored), msg.width, n).squeeze(2)
                                 if n == 1 else stored.reshape(len(stored), msg.width, n))
    return image if decode is None else decode(image)


def _stored(msg: Any, n_bytes: int, share: float) -> np.ndarray:
    """Return the rows as they were sent, without what pads them."""
    size(msg.width, msg.height)
    data, rows = np.frombuffer(count(msg.data, 'data', MAX_BYTES), np.uint8), int(
        msg.height * share)
    if len(data) < rows * msg.step or msg.step < msg.width * n_bytes:
        raise UnusableInput(f'an Image of {msg.width}x{msg.height} {msg.encoding} has '
                            f'{len(data)} bytes, too few')
    return np.ascontiguousarray(data[:rows * msg.step].reshape(rows, msg.step)[
        :, :msg.width * n_bytes])


def _narrow(values: np.ndarray) -> np.ndarray:
    needed = int(values.max(initial=0)).bit_length()
    return (values >> (next(depth for depth in DEPTHS if depth >= needed) - 8)).astype(np.uint8)
