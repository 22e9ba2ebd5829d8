"""Video whose decoder exports no motion vectors, decoded and encoded again in memory."""

import av
from mv_slapse.codec import bitstream
from mv_slapse.codec.frames import WITH_VECTORS
from mv_slapse.codec.packet import Packet, Picture
from mv_slapse.config import EncoderSettings
from mv_slapse.encoding.encoder import encoding_of, ImageEncoder
from mv_slapse.errors import UnusableInput

MAX_PIXELS = 64_000_000
HELD = 64  # packets whose pictures may still be inside the decoder; 16 is the most of HEVC
# FFmpeg's own decoder of AV1 needs hardware.
DECODERS = {'av1': 'libdav1d'}


class Recoder:
    """Pictures and packets in, packets with motion vectors out.

    Attributes
    ----------
    recoded : str
        FFmpeg's name of the codec that is decoded and encoded again; '' where packets are passed
        on as they came.
    """

    def __init__(self, settings: EncoderSettings | None = None):
        """Open nothing until the first item tells what it is."""
        self._settings = settings or EncoderSettings()
        self._encoder = ImageEncoder(encoding_of(self._settings))
        self._context: av.VideoCodecContext | None = None
        self._stamps: dict[int, int] = {}
        self._count = 0
        self._is_whole = True
        self.recoded = ''

    def feed(self, item: Packet | Picture) -> list[Packet]:
        """Return the packets that a picture, or a packet, completes.

        A packet that cannot be decoded gives nothing, nor do the pictures after it up to one that
        needs no other: the motion from the last whole picture to that one is measured instead.

        Raises
        ------
        UnusableInput
            Where FFmpeg has no decoder for the codec.
        """
        if isinstance(item, Picture):
            return self._encoder.feed(item.image, item.stamp)
        if not self.is_recoded(item):
            return [item]
        if self._context is None:
            self._open(item)
        self._count += 1
        self._stamps[self._count] = item.stamp
        self._stamps.pop(self._count - HELD, None)
        return self._pictures(_numbered(item.data, self._count)) if item.data else []

    def flush(self) -> list[Packet]:
        """Return the packets still held back, at the end of the stream."""
        last = self._pictures(None) if self._context else []
        return last + self._encoder.flush()

    def is_recoded(self, packet: Packet) -> bool:
        """Return whether packets of this stream are decoded and encoded again."""
        if self._context is not None or self._settings.recode == 'always':
            return True
        return self._settings.recode == 'auto' and _codec(packet) not in WITH_VECTORS

    def _open(self, packet: Packet):
        codec = _codec(packet)
        try:
            self._context = av.CodecContext.create(DECODERS.get(codec, codec), 'r')
        except (av.error.FFmpegError, ValueError) as error:
            raise UnusableInput(f'{codec or "this video"} gives no motion vectors, and FFmpeg has '
                                'no decoder for it here; send H.264, or encode the file again: '
                                'ffmpeg -i INPUT -c:v libx264 -refs 1 -bf 0 OUTPUT.mp4'
                                ) from error
        self.recoded = codec
        self._context.thread_count = 1  # more threads hold pictures back
        self._context.options = {'max_pixels': str(MAX_PIXELS)}
        if packet.extradata:
            self._context.extradata = packet.extradata

    def _pictures(self, wrapped: av.Packet | None) -> list[Packet]:
        try:
            frames = self._context.decode(wrapped)
        except av.error.EOFError:
            return []
        except av.error.FFmpegError:
            self._is_whole = False
            return []
        return [packet for frame in frames for packet in self._encode(frame)]

    def _encode(self, frame: av.VideoFrame) -> list[Packet]:
        stamp = self._stamps.pop(frame.pts, None)
        self._is_whole = (self._is_whole or frame.key_frame) and not frame.is_corrupt
        return [] if stamp is None or not self._is_whole else self._encoder.feed_frame(
            frame, stamp)


def _codec(packet: Packet) -> str:
    return (packet.codec if packet.extradata
            else bitstream.codec_of(packet.data, packet.codec))


def _numbered(data: bytes, number: int) -> av.Packet:
    packet = av.Packet(data)
    packet.pts = packet.dts = number
    return packet
