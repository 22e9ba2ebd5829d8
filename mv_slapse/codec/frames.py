"""Packets to motion vectors of pictures in the order of presentation, by FFmpeg."""

from collections import deque

import av
from mv_slapse.codec import bitstream
from mv_slapse.codec.motion_vectors import columns, FrameVectors
from mv_slapse.codec.packet import Packet
from mv_slapse.errors import UnusableInput
from mv_slapse.records import FrameType
import numpy as np

WITH_VECTORS = ('h264', 'mpeg2video', 'mpeg1video', 'mpeg4', 'h263', 'flv1')
MAX_PIXELS = 64_000_000
LONGEST_REORDERING = 2_000_000_000  # ns; a stamp farther back is a source that began again
NUMBERED = ('mpeg1video', 'mpeg2video')
COPIES = 16  # packets within which a network delivers one twice: half a second
PLACES = 1024  # values of temporal_reference
CURE = ('re-encode it, for instance with: ffmpeg -i INPUT -c:v libx264 -refs 1 -bf 0 -g 30 '
        'OUTPUT.mp4, or: ffmpeg -i INPUT -c:v mpeg2video -q:v 3 -bf 3 -g 12 OUTPUT.mpg')


def check_codec(codec: str):
    """Refuse a codec whose decoder exports no motion vectors.

    Raises
    ------
    UnusableInput
        For HEVC, VP9, AV1 and all others; the message names the cure.
    """
    if codec not in WITH_VECTORS:
        raise UnusableInput(f'{codec or "this video"} gives no motion vectors: FFmpeg exports '
                            f'them for H.264, MPEG-1, MPEG-2 and MPEG-4 part 2 only; {CURE}')


class FrameDecoder:
    """Decodes packets, one after another, and reads the vectors of each picture."""

    def __init__(self, with_luma: bool):
        """Open nothing until the first packet tells the codec."""
        self._with_luma = with_luma
        self._context = None
        self._headers = bitstream.Headers()
        self._stamps, self._numbers = _Stamps(), _Numbers()
        self._damage: dict[int, str] = {}
        self._references: dict[int, int] = {}
        self._lost = ''
        self._count = 0
        self._last_key = b''
        self._recent: deque[Packet] = deque(maxlen=COPIES)

    @property
    def references(self) -> int:
        """Most pictures that a vector may point to in one direction; 1 unless H.264 says more."""
        sps = self._headers.sps
        return max(sps.max_num_ref_frames, 1) if sps else 1

    @property
    def interlaced(self) -> bool:
        """Whether H.264 may code fields."""
        return bool(self._headers.sps and self._headers.sps.interlaced)

    def feed(self, packet: Packet) -> list[FrameVectors]:
        """Return the pictures that this packet makes available.

        Damage is a value: what cannot be decoded marks the next picture with the reason.
        """
        if not packet.data:
            return []  # an empty packet would put FFmpeg into its end state for good
        if packet in self._recent:
            return []  # a copy would move everything once more
        self._recent.append(packet)
        if self._context is None:
            self._open(packet)
        return self._decode(self._wrap(packet))

    def flush(self) -> list[FrameVectors]:
        """Return the pictures still held back, at the end of the stream."""
        if self._context is None:
            return []
        # FFmpeg's MPEG decoders hand out the last key picture without its vectors unless another
        # one pushes it out; the echo itself has no stamp and is dropped.
        echo = self._last_key and self._context.name != 'h264'
        return (self._decode(_numbered(self._last_key, 0)) if echo else []) + self._decode(None)

    def _open(self, packet: Packet):
        sniffed = '' if packet.extradata else bitstream.sniff(packet.data)
        codec = sniffed or packet.codec
        if {codec, packet.codec} == {'mpeg1video', 'mpeg2video'}:
            codec = packet.codec
        check_codec(codec)
        self._context = av.CodecContext.create(codec, 'r')
        if packet.extradata:
            self._context.extradata = packet.extradata
            if codec == 'h264':
                self._headers.read_parameters(bitstream.parameter_sets(packet.extradata))
        # Frame threads corrupt exported vectors; the loop filter does not touch them.
        self._context.thread_type = 'NONE'
        self._context.options = {
            'flags2': '+export_mvs', 'skip_loop_filter': 'all', 'max_pixels': str(MAX_PIXELS),
            **({} if self._with_luma else {'skip_idct': 'all'})}

    def _wrap(self, packet: Packet) -> av.Packet:
        """Give the packet a number: FFmpeg carries it through reordering, whatever the stamp."""
        self._count += 1
        self._stamps.add(self._count, packet.stamp)
        if self._context.name == 'h264':
            header = self._headers.read_slice(packet.data)
            self._references[self._count] = header.references if header else self.references
            if self._headers.is_gap(header):
                self._damage[self._count] = 'a reference picture was lost (gap in frame_num)'
        elif not bitstream.is_b_picture(packet.data):
            self._last_key = packet.data
        if self._context.name in NUMBERED:
            self._numbers.add(self._count, packet.data)
        return _numbered(packet.data, self._count)

    def _decode(self, wrapped: av.Packet | None) -> list[FrameVectors]:
        try:
            pictures = self._context.decode(wrapped)
        except av.error.EOFError:
            return []
        except av.error.FFmpegError as error:
            self._lost = f'a packet could not be decoded ({error.strerror or error})'
            self._stamps.drop(self._count)
            return []
        return [self._read(picture) for picture in pictures if picture.pts]

    def _read(self, picture: av.VideoFrame) -> FrameVectors:
        kind = int(picture.pict_type)
        kind = FrameType(kind) if kind in (1, 2, 3) else FrameType.I
        stamp = self._stamps.take(picture.pts, kind)
        damage, self._lost = self._damage.pop(picture.pts, '') or self._lost, ''
        if not self._numbers.follows(picture.pts):
            damage = damage or 'pictures were lost (gap in temporal_reference)'
        if getattr(picture, 'is_corrupt', False):
            damage = damage or 'the decoder calls the picture corrupt'
        references = self._references.pop(picture.pts, 1)
        exported = picture.side_data.get('MOTION_VECTORS')
        table = columns(None if exported is None else exported.to_ndarray())
        luma = _luma(picture) if self._with_luma and kind is not FrameType.B else None
        return FrameVectors(stamp, kind, picture.width, picture.height, references=references,
                            is_predicted=self._context.name == 'h264', damage=damage, luma=luma,
                            **table)


class _Stamps:
    """Stamps of pictures inside the decoder.

    Some sources (raw .h264, recorders without reordering) stamp in the order of decoding. That
    is noticed when a B frame comes out before an older packet with an older stamp; from then on
    each picture gets the oldest stamp that is left. Not so where stamps have gone back a little
    from packet to packet: these are in the order of showing, and a picture that was left over is
    one that the decoder has thrown away.
    """

    def __init__(self):
        self._pending: dict[int, int] = {}
        self._by_age = self._of_showing = False
        self._last = 0

    def add(self, number: int, stamp: int):
        """Keep the stamp [ns] of a packet, by its number."""
        self._of_showing |= 0 < self._last - stamp < LONGEST_REORDERING
        self._pending[number] = self._last = stamp

    def drop(self, number: int):
        """Forget a packet that gives no picture."""
        self._pending.pop(number, None)

    def take(self, number: int, kind: FrameType) -> int:
        """Return the stamp [ns] of the picture that a packet has given."""
        stamps = list(self._pending.values())
        late = number != min(self._pending)
        in_order = not self._of_showing and stamps == sorted(set(stamps))
        if kind is FrameType.B and late and in_order:
            self._by_age = True
        stamp = self._pending.pop(min(self._pending) if self._by_age else number)
        for old in [n for n in self._pending if n < number - 64]:
            self._pending.pop(old)
        return stamp


class _Numbers:
    """Places of MPEG-1 and MPEG-2 pictures in their groups: a gap tells that some were lost."""

    def __init__(self):
        self._places: dict[int, tuple[int, int]] = {}
        self._groups, self._next = 0, (0, 0)

    def add(self, number: int, data: bytes):
        """Note the place of a packet, by its number; packets come in the order of decoding."""
        found = bitstream.picture_number(data)
        if found is not None:
            self._groups += found[0]
            self._places[number] = self._groups, found[1]

    def follows(self, number: int) -> bool:
        """Return whether a packet's picture is the next to be shown."""
        group, place = self._places.pop(number, self._next)
        expected, self._next = self._next, (group, (place + 1) % PLACES)
        return (group, place) in (expected, (expected[0] + 1, 0))


def _numbered(data: bytes, number: int) -> av.Packet:
    # Copied, as FFmpeg reads beyond the end: its own buffers are padded with zeros, those of
    # Python are not, and what lay there spoilt MPEG-4 pictures at random.
    packet = av.Packet(len(data))
    packet.update(data)
    packet.pts = packet.dts = number
    return packet


def _luma(picture: av.VideoFrame) -> np.ndarray:
    """Return the first plane as uint8; of 8 bits a view that keeps the picture alive."""
    plane, bits = picture.planes[0], picture.format.components[0].bits
    rows = np.frombuffer(plane, np.uint8).reshape(-1, plane.line_size)
    if bits > 8:
        rows = (rows.view(np.uint16) >> (bits - 8)).astype(np.uint8)
    return rows[:picture.height, :picture.width]
