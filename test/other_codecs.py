"""Pictures coded by codecs whose decoders export no motion vectors."""

from fractions import Fraction

import av
from mv_slapse.codec.packet import Packet
import numpy as np

PERIOD = 40_000_000
CODECS = {  # FFmpeg's decoder -> encoder, its options
    'hevc': ('libx265', {'x265-params': 'log-level=none:bframes=2:keyint=8',
                         'preset': 'ultrafast'}),
    'vp9': ('libvpx-vp9', {'deadline': 'realtime', 'cpu-used': '8', 'b': '4M'}),
    'vp8': ('libvpx', {'deadline': 'realtime', 'cpu-used': '8', 'b': '4M'}),
    'av1': ('libsvtav1', {'preset': '12', 'crf': '20', 'svtav1-params': 'pred-struct=1'}),
    'mjpeg': ('mjpeg', {'qscale': '2'})}


def coded(images: list[np.ndarray], codec: str, period: int = PERIOD,
          start: int = 0, **more: str) -> list[Packet]:
    """Return the pictures coded, one every period [ns], the first at ``start``."""
    name, options = CODECS[codec]
    context = av.CodecContext.create(name, 'w')
    frames = [av.VideoFrame.from_ndarray(image, 'gray') for image in images]
    context.width, context.height = frames[0].width, frames[0].height
    context.pix_fmt = 'yuvj420p' if codec == 'mjpeg' else 'yuv420p'
    context.time_base, context.framerate = Fraction(1, 25), Fraction(25)
    context.options = {**options, **more}
    context.thread_count, context.gop_size = 1, 8
    packets = []
    for i, frame in enumerate([*frames, None]):
        if frame is not None:
            frame = frame.reformat(format=context.pix_fmt)
            frame.pts, frame.time_base = i, context.time_base
        packets += context.encode(frame)
    assert len(packets) == len(images)
    return [Packet(bytes(packet), start + round(packet.pts * packet.time_base * 25) * period,
                   bool(packet.is_keyframe), codec)
            for packet in packets]
