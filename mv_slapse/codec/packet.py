"""One coded picture on its way to the decoder."""

from dataclasses import dataclass


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
        FFmpeg's name of the decoder: h264, mpeg2video, mpeg1video, mpeg4.
    extradata : bytes
        Parameter sets that are not in the stream (MP4), else empty.
    """

    data: bytes
    stamp: int
    is_key: bool
    codec: str
    extradata: bytes = b''
