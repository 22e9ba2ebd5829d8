"""Packets to motion vectors of pictures in the order of presentation, by FFmpeg."""

from collections import deque

import av
from av.sidedata.sidedata import SideDataContainer
import cv2
from mv_slapse.codec import bitstream, places
from mv_slapse.codec.motion_vectors import columns, FrameVectors
from mv_slapse.codec.packet import Packet
from mv_slapse.codec.places import Continuity, forget, KEPT
from mv_slapse.errors import UnusableInput
from mv_slapse.geometry.blocks import MACROBLOCK
from mv_slapse.records import FrameType
import numpy as np

WITH_VECTORS = ('h264', 'mpeg2video', 'mpeg1video', 'mpeg4', 'h263', 'flv1', 'flv')
ZERO_IN_B = ('mpeg4', 'h263')  # FFmpeg exports the blocks of B frames, their vectors as 0
MAX_PIXELS = 64_000_000
LONGEST_REORDERING = 2_000_000_000  # ns; a stamp farther back is a source that began again
LAST_STAMP = (2**31 - 1) * 10**9  # ns: 68 years, the seconds of messages have 32 bits
ALIKE = 1.0  # grey levels: dim halls have 5 and more, noise of 8 levels a pixel has 0.5
COPIES = 16  # packets within which a network delivers one twice: half a second
CURE = ('re-encode it, for instance with: ffmpeg -i INPUT -c:v libx264 -refs 1 -bf 0 -g 30 '
        'OUTPUT.mp4, or: ffmpeg -i INPUT -c:v mpeg2video -q:v 3 -bf 3 -g 12 OUTPUT.mpg')


def check_codec(codec: str):
    """Raise UnusableInput, which names the cure, of a codec whose decoder exports no vectors."""
    if codec not in WITH_VECTORS:
        raise UnusableInput(f'{codec or "this video"} gives no motion vectors: FFmpeg exports '
                            f'them for H.264, MPEG-1, MPEG-2 and MPEG-4 part 2 only; {CURE}')


def codec_of(packet: Packet) -> str:
    """Return the codec of a packet, by its bytes where these are a stream of their own."""
    return packet.codec if packet.extradata else bitstream.codec_of(packet.data, packet.codec)


def _opened(packet: Packet) -> str:
    """Return the codec by which a packet is decoded: bytes do not tell MPEG-1 from MPEG-2."""
    codec = codec_of(packet)
    return packet.codec if {codec, packet.codec} == {'mpeg1video', 'mpeg2video'} else codec


class FrameDecoder:
    """Decodes packets, one after another, and reads the vectors of each picture."""

    def __init__(self, with_luma: bool, of_all: bool = False):
        """Open nothing until the first packet tells the codec; luma of key pictures or of all."""
        self._with_luma, self._of_all = with_luma, with_luma and of_all
        self._context, self._codec = None, ''
        self._headers = bitstream.Headers()
        self._places = places.Places()
        self._stamps, self._continuity = _Stamps(), Continuity()
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

        Damage is a value: what cannot be decoded marks the next picture with the reason. Raises
        UnusableInput where the codec gives no vectors, or the stamp is of no clock.
        """
        if abs(packet.stamp) > LAST_STAMP:
            raise UnusableInput(f'a packet has the stamp {packet.stamp} ns, which no clock shows; '
                                f'give times in nanoseconds, {LAST_STAMP} at most')
        if not packet.data:
            return []  # an empty packet would put FFmpeg into its end state for good
        if any(packet.stamp == other.stamp and packet == other for other in self._recent):
            return []  # a copy would move everything once more
        self._recent.append(packet)
        if self._context is None or self._begins_another(packet):
            self._open(packet)
        return self._decode(self._wrap(packet))

    def flush(self) -> list[FrameVectors]:
        """Return the pictures still held back, at the end of the stream."""
        if self._context is None:
            return []
        # FFmpeg's MPEG decoders hand out the last key picture without its vectors unless another
        # one pushes it out; the echo itself has no stamp and is dropped.
        echo = self._last_key and self._context.name != 'h264'
        return (self._decode(numbered(self._last_key, 0)) if echo else []) + self._decode(None)

    def _begins_another(self, packet: Packet) -> bool:
        """Tell whether a publisher goes on in another codec, from a key picture on."""
        return packet.is_key and _opened(packet) != self._codec

    def _open(self, packet: Packet):
        self._codec = codec = _opened(packet)
        check_codec(codec)
        if self._context is not None:
            self._continuity.report(self._count, 'the codec changed')
        self._context, self._headers = av.CodecContext.create(codec, 'r'), bitstream.Headers()
        self._places = places.places_of(codec, self._headers, packet.extradata)
        if packet.extradata:
            self._context.extradata = packet.extradata
            if codec == 'h264':
                self._headers.read_parameters(bitstream.parameter_sets(packet.extradata))
        # Frame threads corrupt exported vectors; the loop filter does not touch them. 'noref' is a
        # B frame that no other refers to.
        self._context.thread_type = 'NONE'
        self._context.options = {
            'flags2': '+export_mvs', 'skip_loop_filter': 'all', 'max_pixels': str(MAX_PIXELS),
            'skip_idct': 'none' if self._of_all else 'noref' if self._with_luma else 'all'}

    def _wrap(self, packet: Packet) -> av.Packet:
        """Give the packet a number: FFmpeg carries it through reordering, whatever the stamp."""
        self._count += 1
        self._stamps.add(self._count, packet.stamp)
        place = self._places.read(packet.data)
        self._continuity.add(self._count, place)
        if self._context.name != 'h264' and place.is_reference:
            self._last_key = packet.data
        return numbered(packet.data, self._count)

    def _decode(self, wrapped: av.Packet | None) -> list[FrameVectors]:
        try:
            pictures = self._context.decode(wrapped)
        except av.error.EOFError:
            return []
        except av.error.FFmpegError as error:
            if self._context.name != 'h264' or bitstream.has_slice(bytes(wrapped)):
                self._continuity.report(
                    self._count, f'a packet could not be decoded ({error.strerror or error})')
            self._stamps.drop(self._count)
            return []
        read = [self._read(picture) for picture in pictures if picture.pts]
        return [frame for frame in read if frame is not None]

    def _read(self, picture: av.VideoFrame) -> FrameVectors | None:
        """Return the vectors of a picture; None of one that no packet is known to have given."""
        kind = int(picture.pict_type)
        kind = FrameType(kind) if kind in (1, 2, 3) else FrameType.I
        stamp = self._stamps.take(picture.pts, kind)
        if stamp is None:
            self._continuity.report(self._count, 'a packet holds more than one picture')
            return None
        place = self._continuity.place(picture.pts)
        references = place.references or (self.references if kind is not FrameType.I else 1)
        damage = self._continuity.damage(picture.pts, stamp)
        # What picture.side_data gives holds the picture, and is held by it: none would be freed.
        exported = SideDataContainer(picture).get('MOTION_VECTORS')
        if kind is FrameType.B and self._context.name in ZERO_IN_B:
            exported = None
        if getattr(picture, 'is_corrupt', False):
            if kind is FrameType.B and not place.is_reference:
                exported = None  # no other picture is predicted from it: the damage ends there
            else:
                damage = damage or 'the decoder calls the picture corrupt'
        table = columns(None if exported is None else np.frombuffer(exported, np.uint8))
        is_key = kind is not FrameType.B
        luma = _luma(picture) if self._of_all or self._with_luma and is_key else None
        return FrameVectors(stamp, kind, picture.width, picture.height, references=references,
                            is_reference=place.is_reference,
                            is_predicted=self._context.name == 'h264', damage=damage,
                            luma=luma,
                            is_blank=luma is not None and is_key and _is_blank(luma), **table)


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
        self._dropped: dict[int, int] = {}
        self._by_age = self._of_showing = False
        self._last = 0

    def add(self, number: int, stamp: int):
        """Keep the stamp [ns] of a packet, by its number."""
        self._of_showing |= 0 < self._last - stamp < LONGEST_REORDERING
        self._pending[number] = self._last = stamp
        for stamps in (self._pending, self._dropped):
            forget(stamps, number - KEPT)

    def drop(self, number: int):
        """Set aside a packet that could not be decoded; FFmpeg may show it all the same."""
        if number in self._pending:
            self._dropped[number] = self._pending.pop(number)

    def take(self, number: int, kind: FrameType) -> int | None:
        """Return the stamp [ns] of the picture that a packet has given; None of a second one."""
        if not self._by_age and number not in self._pending:
            return self._dropped.pop(number, None)
        stamps = list(self._pending.values())
        late = bool(stamps) and number != min(self._pending)
        in_order = not self._of_showing and stamps == sorted(set(stamps))
        if kind is FrameType.B and late and in_order:
            self._by_age = True
        return self._pending.pop(min(self._pending, default=0) if self._by_age else number, None)


def numbered(data: bytes, number: int) -> av.Packet:
    """Return a packet that carries a number through FFmpeg in place of its time."""
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


def _is_blank(luma: np.ndarray) -> bool:
    """Return whether a picture shows nothing, as of a covered lens, darkness or fog.

    Its macroblocks are all as bright, but for the camera's noise, of which means have little. Its
    vectors, zero or by chance, are of nothing that stands or moves.
    """
    rows, columns = (max(side // MACROBLOCK, 1) for side in luma.shape)
    few = max(rows // 8, 1)  # of the middle: where these differ enough the others need no look
    for n, top in ((few, (rows - few) // 2), (rows, 0)):
        # Whole macroblocks alone: OpenCV takes means ten times as fast where a ratio is whole.
        part = luma[top * MACROBLOCK:(top + n) * MACROBLOCK, :columns * MACROBLOCK]
        _, spread = cv2.meanStdDev(cv2.resize(part, (columns, n), interpolation=cv2.INTER_AREA))
        if n * spread[0, 0]**2 >= rows * ALIKE**2:
            return False
    return True
