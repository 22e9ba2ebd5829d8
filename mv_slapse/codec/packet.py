"""One picture on its way to the decoder, coded or not."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np


@dataclass(frozen=True)
class Packet:
    """A coded picture."""

    data: bytes  # the picture as the encoder wrote it
    stamp: int  # presentation time [ns]
    is_key: bool  # whether the container or the topic calls it a key picture
    # FFmpeg's name of the decoder: h264, mpeg2video, mpeg1video, mpeg4; or one without motion
    # vectors, which has to be recoded first
    codec: str
    extradata: bytes = b''  # parameter sets that are not in the stream (MP4), else empty


@dataclass(frozen=True)
class Picture:
    """A picture that is not coded."""

    image: np.ndarray  # (height, width) or (height, width, 3) uint8: grey or BGR
    stamp: int  # time [ns]
    is_key: ClassVar[bool] = True  # needs no other
