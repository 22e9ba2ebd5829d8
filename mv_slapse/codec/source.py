"""Video files and network streams as packets with presentation times."""

from collections.abc import Iterator
from contextlib import AbstractContextManager
from fractions import Fraction
import os
from pathlib import Path
import select
from typing import BinaryIO

import av
from mv_slapse.codec.packet import Form, Packet
from mv_slapse.errors import UnusableInput

PROTOCOLS = 'rtsp,rtp,udp,tcp,http,https,tls,crypto'
LOCAL = 'file'  # a playlist from the network must not read files, nor a file's the network
PATIENCE = 10.0  # s, for a network to answer
DEFAULT_RATE = Fraction(25)
# of decoders that are not named after their codec (older PyAV tells the decoder only)
CODECS = {'libdav1d': 'av1', 'libaom-av1': 'av1'}


class Source(AbstractContextManager):
    """An open video.

    Attributes
    ----------
    codec : str
        FFmpeg's name of the codec.
    width, height : int
        Picture size [px].
    fps : float
        Frame rate as the container tells it; 0 where it does not [1/s].
    n_frames : int
        Number of pictures as the container tells it; 0 where it does not.
    has_end : bool
        Whether the container tells how long it lasts, as a file does.
    """

    def __init__(self, container):
        """Take the first video stream of an open container."""
        self._container = container
        self._stream = container.streams.video[0]
        context = self._stream.codec_context
        decoder = self._stream.codec.name
        self.codec = CODECS.get(decoder, decoder)
        self.width, self.height = context.width, context.height
        self._rate = self._stream.average_rate or self._stream.guessed_rate
        self.fps = float(self._rate or 0)
        self.n_frames = self._stream.frames
        self.has_end = container.duration is not None
        # What the parser saw: AV_FIELD_TT and all after it are fields.
        self.interlaced = int(getattr(context, 'field_order', 0) or 0) > 1

    def __exit__(self, *_):
        """Close the file."""
        self.close()

    def close(self):
        """Close the file or the connection."""
        self._container.close()

    def packets(self) -> Iterator[Packet]:
        """Yield the packets of the video in the order of decoding.

        The stamp of a file's first picture is 0. A file that is cut off is played as far as it
        goes. Where a packet carries no time, the frame rate gives it one.

        Raises
        ------
        UnusableInput
            Where not even the first packet can be read.
        """
        context = self._stream.codec_context
        extradata = bytes(context.extradata or b'')
        form = Form(context.width, context.height, context.pix_fmt or '', context.codec_tag)
        clock = _Clock(self._stream, self._rate)
        for packet in self._demux():
            yield Packet(bytes(packet), clock.stamp(packet), bool(packet.is_keyframe),
                         self.codec, extradata, form)

    def _demux(self) -> Iterator[av.Packet]:
        some = False
        try:
            for packet in self._container.demux(self._stream):
                if packet.size:
                    some = True
                    yield packet
        except av.error.FFmpegError as error:
            if not some and not isinstance(error, av.error.EOFError):
                raise UnusableInput(f'{self._container.name} cannot be read as a video: {error}; '
                                    'is it whole, and can its server begin anywhere?') from error


class _Clock:
    """Presentation times [ns] of packets, from zero."""

    def __init__(self, stream, rate: Fraction | None):
        self._base = stream.time_base or Fraction(1, 90000)
        self._start = stream.start_time
        self._step = Fraction(10**9) / (rate or DEFAULT_RATE)
        self._count = 0

    def stamp(self, packet) -> int:
        """Return the time of the next packet."""
        number, self._count = self._count, self._count + 1
        if packet.pts is None:
            return round(number * self._step)
        if self._start is None:
            self._start = packet.pts
        return round((packet.pts - self._start) * self._base * 10**9)


def open_source(path_or_url: str | Path) -> Source:
    """Open a video file, or a URL of file, rtsp, rtp, udp, tcp, http or https.

    Raises UnusableInput where there is no such file, or no video in it.
    """
    name = str(path_or_url)
    check_protocol(name)
    is_url = '://' in name
    if not is_url:
        _check_file(Path(name))
    try:
        container = (_camera(name) if not is_url and Path(name).is_char_device()
                     else av.open(_place(name, is_url), **_how_to_open(name, is_url)))
    except (av.error.FFmpegError, OSError) as error:
        raise UnusableInput(f'{name} cannot be opened as a video: {error}; give a video file '
                            'that FFmpeg can read, or a stream that is reachable') from error
    if not container.streams.video:
        container.close()
        raise UnusableInput(f'{name} has no video stream; give a file with pictures in it')
    source = Source(container)
    if source.interlaced:
        source.close()
        raise UnusableInput(f'{name}: the video is interlaced: its vectors join fields, not '
                            'frames; deinterlace it with: ffmpeg -i INPUT -vf bwdif '
                            '-c:v libx264 -refs 1 -bf 0 OUTPUT.mp4')
    return source


def check_protocol(name: str):
    """Raise UnusableInput for a URL of a protocol that is not taken."""
    if _protocol(name) not in (LOCAL, *PROTOCOLS.split(',')):
        raise UnusableInput(f'{name}: protocol not allowed; use one of {LOCAL},{PROTOCOLS}')


def is_live(name: str) -> bool:
    """Return whether a source is a camera or the network: it does not wait, and may come back."""
    return Path(name).is_char_device() or name.startswith('/dev/') or _protocol(name) != LOCAL


def _camera(name: str):
    """Open a camera by its driver: for its H.264, or its JPEG where it has no encoder."""
    try:
        return av.open(name, format='v4l2', options={'input_format': 'h264'})
    except av.error.FFmpegError:
        return av.open(name, format='v4l2', options={'input_format': 'mjpeg'})


def _how_to_open(name: str, is_url: bool) -> dict:
    """Return the arguments of av.open: a patience for networks."""
    protocol = _protocol(name)
    options = {'protocol_whitelist': LOCAL if protocol == LOCAL else PROTOCOLS}
    if protocol == 'rtsp':  # UDP loses packets in silence: a broken pair
        options['rtsp_transport'] = 'tcp'
    return {'options': options} | ({'timeout': PATIENCE} if is_url else {})


def _place(name: str, is_url: bool) -> str | BinaryIO:
    """Return what FFmpeg opens: a path that is absolute, as a colon makes a relative one a URL."""
    if is_url:
        return name
    return _fifo(Path(name)) if Path(name).is_fifo() else str(Path(name).absolute())


def _protocol(name: str) -> str:
    return name.split('://', 1)[0].lower() if '://' in name else LOCAL


def _check_file(path: Path):
    try:
        if path.is_dir():
            raise UnusableInput(f'{path} is a directory; give a video file')
        if not path.exists():
            raise UnusableInput(f'{path}: no such file; check the path')
        is_stream = path.is_char_device() or path.is_fifo()
        if not path.stat().st_size and not is_stream:
            raise UnusableInput(f'{path} is empty; was the recording finished?')
    except (OSError, ValueError) as error:  # too long a name, one with a zero byte, no permission
        raise UnusableInput(f'{str(path)[:200]!r} cannot be opened: {error}') from None


def _fifo(path: Path) -> BinaryIO:
    """Open a FIFO once it has something to read; without a writer opening would never return."""
    number = os.open(path, os.O_RDONLY | os.O_NONBLOCK)
    if not select.select([number], [], [], PATIENCE)[0]:
        os.close(number)
        raise UnusableInput(f'{path} is a FIFO that nobody has written to for {PATIENCE:.0f} s; '
                            'start the writer first')
    os.set_blocking(number, True)
    return os.fdopen(number, 'rb')
