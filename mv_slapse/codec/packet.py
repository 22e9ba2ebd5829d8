"""One picture on its way to the decoder, coded or not."""

from dataclasses import dataclass, field
from typing import ClassVar, NamedTuple

import numpy as np


class Form(NamedTuple):
    """What a container knows of its pictures, which some codecs do not tell themselves."""

    width: int  # [px]
    height: int  # [px]
    pix_fmt: str  # FFmpeg's name of the pixel format; empty where it is not known
    codec_tag: str  # the container's four characters for the codec


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
    form: Form | None = field(default=None, compare=False)  # as its container tells it


@dataclass(frozen=True)
class Picture:
    """A picture that is not coded."""

    image: np.ndarray  # (height, width) or (height, width, 3) uint8: grey or BGR
    stamp: int  # time [ns]
    is_key: ClassVar[bool] = True  # needs no other
