"""One picture on its way to the decoder, coded or not."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np


@dataclass(frozen=True)
class Packet:
    """A coded picture.

    Attributes
    ----------
    data : bytes
        The picture as the encoder wrote it.
    stamp : int
        Presentation time [ns].
    is_key : bool
        Whether the container or the topic calls it a key picture.
    codec : str
        FFmpeg's name of the decoder: h264, mpeg2video, mpeg1video, mpeg4; or one without motion
        vectors, which has to be recoded first.
    extradata : bytes
        Parameter sets that are not in the stream (MP4), else empty.
    """

    data: bytes
    stamp: int
    is_key: bool
    codec: str
    extradata: bytes = b''


@dataclass(frozen=True)
class Picture:
    """A picture that is not coded.

    Attributes
    ----------
    image : (height, width) or (height, width, 3) uint8
        Grey or BGR.
    stamp : int
        Time [ns].
    """

    image: np.ndarray
    stamp: int
    is_key: ClassVar[bool] = True  # needs no other
