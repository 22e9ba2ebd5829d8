"""Pictures to coded packets, for raw image topics, the simulator and tests.

The encoder's motion search is what measures the motion then, so it is set for true vectors
rather than for few bits: one reference, high quality, wide search.
"""

from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from fractions import Fraction
from pathlib import Path

import av
from mv_slapse.codec.packet import Packet
from mv_slapse.config import EncoderSettings
from mv_slapse.errors import UnusableOutput, UsageError
import numpy as np

# With qscale set and no quality given FFmpeg searches at a rate multiplier of zero: vectors then
# minimise the difference of the pictures alone. Measured on KITTI, 92 % of the merged vectors lie
# within 1 px of the true epipolar line, against 84 % at a fixed quantiser of 2, and 82 % with
# rate-distortion decisions (mbd), which drop the second vector of B blocks.
PRESETS = {
    'mpeg2video': {'flags': '+qscale', 'sc_threshold': '1000000000', 'b_strategy': '0',
                   'dia_size': '6'},
    'h264': {'preset': 'medium', 'crf': '18',
             'x264-params': 'ref=1:scenecut=0:rc-lookahead=0:sync-lookahead=0:weightp=0:'
                            'b-adapt=0:b-pyramid=none:weightb=0:mbtree=0:sliced-threads=0:'
                            'threads=1:open-gop=1:force-cfr=1'},
}
ENCODERS = {'mpeg2video': 'mpeg2video', 'h264': 'libx264'}


@dataclass(frozen=True)
class Encoding:
    """How pictures are coded."""

    codec: str = 'mpeg2video'  # mpeg2video or h264
    b_frames: int = 3  # B frames between two key frames; always so many
    # an I frame every so many pictures. The B frames before it refer to it and to the past (an
    # open group), for without them no vector joins an I frame to the past
    gop: int = 12
    # FFmpeg options of the encoder that replace those of PRESETS
    options: dict[str, str] = field(default_factory=dict)

    def __post_init__(self):
        """Refuse a codec without a preset."""
        if self.codec not in ENCODERS:
            raise UsageError(f'no encoder for {self.codec!r}: use one of {", ".join(ENCODERS)}')


LOW_LATENCY = Encoding('h264', 0, 30)
LONGEST_GROUP = 600  # pictures, the most of FFmpeg's MPEG-2 encoder


def encoding_of(settings: EncoderSettings) -> Encoding:
    """Return how pictures are coded that stay in memory: no loss asks for an I frame."""
    quality, options = str(settings.quality), {}
    if settings.codec == 'mpeg2video' and not settings.b_frames:
        options = {'flags': '+qscale+low_delay'}  # or the encoder holds one picture back
    if settings.quality:
        options |= ({'crf': quality} if settings.codec == 'h264'
                    else {'qmin': quality, 'qmax': quality})
    return Encoding(settings.codec, settings.b_frames, LONGEST_GROUP, options)


class ImageEncoder:
    """Codes pictures one after another."""

    def __init__(self, encoding: Encoding | None = None):
        """Open nothing until the first picture tells the size."""
        self._encoding = encoding or Encoding()
        self._context = None
        #: width and height of the coded pictures [px]; zero before the first
        self.size = (0, 0)
        self._stamps: dict[int, int] = {}
        self._count = 0

    def feed(self, image: np.ndarray, stamp: int) -> list[Packet]:
        """Return the packets that this picture, taken at a stamp [ns], completes.

        It is grey (height, width) or BGR (height, width, 3) uint8; an odd last row or column is
        cut off.
        """
        return self.feed_frame(_frame(image), stamp)

    def feed_frame(self, frame: av.VideoFrame, stamp: int) -> list[Packet]:
        """Return the packets that a decoded picture completes; another size begins anew.

        An odd last row or column is cut off, the picture then being taken as grey.
        """
        if frame.width % 2 or frame.height % 2:
            frame = _frame(frame.to_ndarray(format='gray'))
        size, before = (frame.width, frame.height), []
        if size != self.size:
            before = self.flush()
            self.size = size
            self._context = av.CodecContext.create(ENCODERS[self._encoding.codec], 'w')
            configure(self._context, self._encoding, *size, Fraction(25))
        self._stamps[self._count] = stamp
        picture = _numbered(frame, self._count, self._context.time_base)
        self._count += 1
        return before + self._packets(picture)

    def flush(self) -> list[Packet]:
        """Return the packets still held back."""
        return [] if self._context is None else self._packets(None)

    def _packets(self, picture) -> list[Packet]:
        return [Packet(bytes(packet), self._stamps.pop(packet.pts), bool(packet.is_keyframe),
                       self._encoding.codec, b'') for packet in self._context.encode(picture)]


def configure(context, encoding: Encoding, width: int, height: int, rate: Fraction):
    """Set up an encoder's context; one thread, so that the same pictures give the same bytes."""
    context.width, context.height = width // 2 * 2, height // 2 * 2
    context.pix_fmt = 'yuv420p'
    context.time_base, context.framerate = 1 / rate, rate
    context.gop_size = encoding.gop
    context.max_b_frames = encoding.b_frames
    context.thread_count = 1
    context.options = {**PRESETS[encoding.codec], **encoding.options}


def encode(images: Iterable[np.ndarray], fps: float,
           encoding: Encoding | None = None) -> Iterator[Packet]:
    """Yield the packets of pictures taken at a fixed rate [1/s]; the first has stamp 0."""
    encoder = ImageEncoder(encoding)
    for i, image in enumerate(images):
        yield from encoder.feed(image, round(i * 1e9 / fps))
    yield from encoder.flush()


def write_video(path: str | Path, images: Iterable[np.ndarray], fps: float,
                encoding: Encoding | None = None):
    """Write pictures to a video file; its suffix (.mp4, .mpg, .mkv) chooses the container.

    Raises
    ------
    UnusableOutput
        Where FFmpeg does not know the suffix, or the file cannot be written.
    """
    encoding = encoding or Encoding()
    rate = Fraction(fps).limit_denominator(1001)
    with _writing(path):
        container = av.open(str(path), 'w')
    try:
        with _writing(path):
            stream = container.add_stream(ENCODERS[encoding.codec], rate=rate)
        for i, image in enumerate(images):
            with _writing(path):
                if not i:
                    height, width = image.shape[:2]
                    configure(stream.codec_context, encoding, width, height, rate)
                container.mux(stream.encode(_numbered(_frame(image), i, 1 / rate)))
        with _writing(path):
            container.mux(stream.encode(None))
    finally:
        with _writing(path):
            container.close()


@contextmanager
def _writing(path: str | Path) -> Iterator[None]:
    """Give what FFmpeg and the disk refuse as one kind of error."""
    try:
        yield
    except (av.error.FFmpegError, OSError, ValueError) as error:
        raise UnusableOutput(f'{path} cannot be written: {getattr(error, "strerror", "") or error}'
                             '; free the disk, or choose another place or suffix') from error


def leave_out(source: str | Path, path: str | Path, lost: range):
    """Copy a video but for some of its packets, counted from zero as they come."""
    with av.open(str(source)) as given, av.open(str(path), 'w') as kept:
        stream = kept.add_stream_from_template(given.streams.video[0])
        for i, packet in enumerate(given.demux(video=0)):
            if i not in lost and packet.dts is not None:
                packet.stream = stream
                kept.mux(packet)


def _frame(image: np.ndarray) -> av.VideoFrame:
    height, width = (size // 2 * 2 for size in image.shape[:2])
    return av.VideoFrame.from_ndarray(np.ascontiguousarray(image[:height, :width]),
                                      'gray' if image.ndim == 2 else 'bgr24')


def _numbered(frame: av.VideoFrame, number: int, time_base: Fraction) -> av.VideoFrame:
    picture = frame.reformat(format='yuv420p')
    picture.pts, picture.time_base, picture.pict_type = number, time_base, 0
    return picture
