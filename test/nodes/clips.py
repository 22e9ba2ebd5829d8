"""A short clip whose motion is known, as packets and pictures."""

from functools import cache

import cv2
from mv_slapse.codec.encoding.encoder import encode, Encoding
import numpy as np
from sensor_msgs.msg import CameraInfo

SIZE = (192, 128)
FPS = 10.0


@cache
def pictures(n: int = 16) -> list:
    """Return grey pictures (128, 192) in which everything moves 3 px to the left each time."""
    texture = np.random.default_rng(0).integers(0, 255, (160, 300)).astype(np.uint8)
    texture = cv2.GaussianBlur(texture, (0, 0), 1.5)
    return [np.ascontiguousarray(texture[10:138, 3 * i:3 * i + 192]) for i in range(n)]


@cache
def packets(codec: str = 'mpeg2video', start: int = 0) -> list:
    """Return the pictures coded; the first has the stamp ``start`` [ns]."""
    b_frames, gop = (0, 30) if codec == 'h264' else (1, 12)
    coded = list(encode(pictures(), FPS, Encoding(codec, b_frames, gop)))
    return [type(p)(p.data, p.stamp + start, p.is_key, p.codec, p.extradata) for p in coded]


def camera_info(focal: float = 150.0) -> CameraInfo:
    info = CameraInfo(width=SIZE[0], height=SIZE[1], distortion_model='plumb_bob')
    info.header.frame_id = 'cam_optical'
    info.k[:] = [focal, 0, 95.5, 0, focal, 63.5, 0, 0, 1 if focal else 0]
    info.d = [0.0] * 5
    return info
