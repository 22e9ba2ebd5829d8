"""Video whose decoder exports no motion vectors, decoded and encoded again in memory."""

import av
from mv_slapse.codec.encoding.encoder import encoding_of, ImageEncoder
from mv_slapse.codec.frames import codec_of, MAX_PIXELS, numbered, WITH_VECTORS
from mv_slapse.codec.packet import Packet, Picture
from mv_slapse.codec.places import KEPT
from mv_slapse.config import EncoderSettings
from mv_slapse.errors import UnusableInput

# FFmpeg's own decoder of AV1 needs hardware.
DECODERS = {'av1': 'libdav1d'}


class PictureDecoder:
    """Packets of any codec to pictures."""

    def __init__(self):
        """Open nothing until the first packet tells the codec."""
        self._context: av.VideoCodecContext | None = None
        self._stamps: dict[int, int] = {}
        self._count = 0
        self._is_whole = True
        self.codec = ''  # FFmpeg's name of it; empty before the first packet

    def feed(self, packet: Packet) -> list[tuple[av.VideoFrame, int]]:
        """Return the pictures, with their stamps [ns], that a packet completes.

        A packet that cannot be decoded gives nothing, nor do the pictures after it up to one that
        needs no other. Raises UnusableInput where FFmpeg has no decoder for the codec.
        """
        if self._context is None or packet.is_key and codec_of(packet) != self.codec:
            self._open(packet)
        self._count += 1
        self._stamps[self._count] = packet.stamp
        self._stamps.pop(self._count - KEPT, None)
        return self._decode(numbered(packet.data, self._count)) if packet.data else []

    def flush(self) -> list[tuple[av.VideoFrame, int]]:
        """Return the pictures still held back, at the end of the stream."""
        return self._decode(None) if self._context else []

    def _open(self, packet: Packet):
        codec = codec_of(packet)
        try:
            self._context = av.CodecContext.create(DECODERS.get(codec, codec), 'r')
        except (av.error.FFmpegError, ValueError) as error:
            raise UnusableInput(f'{codec or "this video"} gives no motion vectors, and FFmpeg has '
                                'no decoder for it here; send H.264, or encode the file again: '
                                'ffmpeg -i INPUT -c:v libx264 -refs 1 -bf 0 OUTPUT.mp4'
                                ) from error
        self.codec = codec
        self._context.thread_count = 1  # more threads hold pictures back
        self._context.options = {'max_pixels': str(MAX_PIXELS)}
        if packet.extradata:
            self._context.extradata = packet.extradata
        if packet.form:  # raw video, FFV1 and WMV tell none of it in their packets
            width, height, pix_fmt, codec_tag = packet.form
            self._context.width, self._context.height = width, height
            self._context.codec_tag = codec_tag
            if pix_fmt:
                self._context.pix_fmt = pix_fmt

    def _decode(self, wrapped: av.Packet | None) -> list[tuple[av.VideoFrame, int]]:
        try:
            frames = self._context.decode(wrapped)
        except av.error.FFmpegError:
            self._is_whole = False
            return []
        return [picture for frame in frames for picture in self._checked(frame)]

    def _checked(self, frame: av.VideoFrame) -> list[tuple[av.VideoFrame, int]]:
        stamp = self._stamps.pop(frame.pts, None)
        self._is_whole = (self._is_whole or frame.key_frame) and not frame.is_corrupt
        return [(frame, stamp)] if stamp is not None and self._is_whole else []


class Recoder:
    """Pictures and packets in, packets with motion vectors out."""

    def __init__(self, settings: EncoderSettings | None = None):
        """Open nothing until the first item tells what it is."""
        self._settings = settings or EncoderSettings()
        self._encoder = ImageEncoder(encoding_of(self._settings))
        self._decoder = PictureDecoder()

    @property
    def recoded(self) -> str:
        """FFmpeg's name of the codec that is encoded again; empty where packets pass as is."""
        return self._decoder.codec

    @property
    def size(self) -> tuple[int, int] | None:
        """Width and height of the pictures encoded here [px], both even; None where none are."""
        return self._encoder.size if all(self._encoder.size) else None

    def feed(self, item: Packet | Picture) -> list[Packet]:
        """Return the packets that a picture, or a packet, completes.

        Over what cannot be decoded the motion between the whole pictures is measured. Raises
        UnusableInput where FFmpeg has no decoder for the codec.
        """
        if isinstance(item, Picture):
            return self._encoder.feed(item.image, item.stamp)
        if not self._is_recoded(item):
            return [item]
        return self._encode(self._decoder.feed(item))

    def flush(self) -> list[Packet]:
        """Return the packets still held back, at the end of the stream."""
        return self._encode(self._decoder.flush()) + self._encoder.flush()

    def _is_recoded(self, packet: Packet) -> bool:
        if self.recoded or self._settings.recode == 'always':
            return True
        return self._settings.recode == 'auto' and codec_of(packet) not in WITH_VECTORS

    def _encode(self, pictures: list[tuple[av.VideoFrame, int]]) -> list[Packet]:
        return [packet for frame, stamp in pictures
                for packet in self._encoder.feed_frame(frame, stamp)]
