"""What the decoder does not tell: the few header fields of H.264 that are needed here.

Only start codes, parameter sets and the first bits of slice headers are read (ITU-T H.264 7.3).
"""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

from mv_slapse.geometry.camera import LARGEST

START = b'\x00\x00\x01'
NAL_SLICE, NAL_IDR, NAL_SEI, NAL_SPS, NAL_PPS = 1, 5, 6, 7, 8
SEI_RECOVERY_POINT = 6
HIGH_PROFILES = (100, 110, 122, 244, 44, 83, 86, 118, 128, 138, 139, 134, 135)
LONGEST_SET = 1024  # bytes of a parameter set; the longest of real encoders have a tenth
MOST_UNITS = 2048  # of a packet that are told apart; a picture has fewer slices
LONGEST_CODE = 32  # zeros before an Exp-Golomb number, H.264 9.1
COUNTER_BITS = range(4, 17)  # of frame_num and of the picture order, H.264 7.4.2.1.1
LAST_PPS = 255  # greatest pic_parameter_set_id, H.264 7.4.2.2


@dataclass(frozen=True)
class SequenceParameters:
    """H.264 sequence parameter set, as far as it is needed."""

    width: int  # coded, before cropping [px]
    height: int  # the same [px]
    max_num_ref_frames: int  # most pictures that a vector may point to
    interlaced: bool  # whether fields may be coded (frame_mbs_only_flag is 0)
    log2_max_frame_num: int  # bits of frame_num in slice headers
    gaps_allowed: bool  # whether frame_num may have gaps without loss
    separate_planes: bool  # whether slice headers carry a colour plane
    order_type: int  # pic_order_cnt_type, how slice headers carry the picture order,
    order_bits: int  # and the bits of its lsb


@dataclass(frozen=True)
class PictureParameters:
    """H.264 picture parameter set, as far as it is needed."""

    has_bottom_order: bool  # whether slice headers carry delta_pic_order_cnt_bottom,
    has_redundant: bool  # and redundant_pic_cnt
    references: tuple[int, int]  # default number of pictures in list 0 and list 1


@dataclass(frozen=True)
class SliceHeader:
    """First slice of a picture."""

    is_idr: bool
    is_reference: bool
    frame_num: int
    references: int  # most pictures in a list of references: 1 means that no vector is ambiguous
    order: int = 0  # pic_order_cnt_lsb; 0 where the stream has none


class BitReader:
    """Bits of a payload; of H.264's, which are escaped, without emulation prevention."""

    def __init__(self, payload: bytes, is_escaped: bool = True):
        """Hold the payload; nothing is copied bit by bit."""
        if is_escaped:
            payload = payload.replace(b'\x00\x00\x03', b'\x00\x00')
        self._value = int.from_bytes(payload, 'big')
        self._left = 8 * len(payload)

    def bits(self, n: int) -> int:
        """Return the next n bits as an unsigned number."""
        self._left -= n
        if self._left < 0:
            raise EOFError('parameter set is truncated')
        return (self._value >> self._left) & ((1 << n) - 1)

    def ue(self) -> int:
        """Return the next unsigned Exp-Golomb number, H.264 9.1."""
        zeros = 0
        while not self.bits(1):
            zeros += 1
            if zeros > LONGEST_CODE:
                raise EOFError('no Exp-Golomb number')
        return (1 << zeros) - 1 + self.bits(zeros)

    def se(self) -> int:
        """Return the next signed Exp-Golomb number, H.264 9.1.1."""
        k = self.ue()
        return (k + 1) // 2 if k % 2 else -(k // 2)


def nal_units(data: bytes) -> list[bytes]:
    """Return the H.264 units of a packet, Annex B or length-prefixed (AVCC)."""
    prefixed = _length_prefixed(data)
    if prefixed or START not in data[:4]:
        return prefixed
    return [unit.rstrip(b'\x00') for unit in data.split(START, MOST_UNITS) if unit.strip(b'\x00')]


def has_slice(data: bytes) -> bool:
    """Return whether an H.264 packet holds some of a picture, not parameter sets alone."""
    return any(unit and NAL_SLICE <= unit[0] & 31 <= NAL_IDR for unit in nal_units(data))


def _length_prefixed(data: bytes) -> list[bytes]:
    """Return units whose lengths add up to just the packet, else none.

    A unit of 256 to 511 bytes has a length that looks like a start code: only the sum tells.
    """
    units, at = [], 0
    while at + 4 < len(data):
        size = int.from_bytes(data[at:at + 4], 'big')
        if not size:
            return []
        units.append(data[at + 4:at + 4 + size])
        at += 4 + size
    return units if at == len(data) and all(units) else []


def parameter_sets(extradata: bytes) -> Iterator[bytes]:
    """Yield the units of H.264 extradata, avcC or Annex B; of one that is cut those before."""
    if extradata[:1] != b'\x01':
        yield from nal_units(extradata)
        return
    at = 5
    for mask in (31, 255):
        n, at = int.from_bytes(extradata[at:at + 1], 'big') & mask, at + 1
        for _ in range(n):
            size = int.from_bytes(extradata[at:at + 2], 'big')
            if not size or at + 2 + size > len(extradata):
                return
            yield extradata[at + 2:at + 2 + size]
            at += 2 + size


def parse_sps(unit: bytes) -> SequenceParameters | None:
    """Return the fields of a sequence parameter set, H.264 7.3.2.1.1; None where it is broken."""
    try:
        sps = _parse_sps(BitReader(unit[1:LONGEST_SET]))
    except EOFError:
        return None
    counters = sps.log2_max_frame_num, sps.order_bits or COUNTER_BITS[0]
    sane = all(n in COUNTER_BITS for n in counters) and max(sps.width, sps.height) <= LARGEST
    return sps if sane else None


def _parse_sps(bits: BitReader) -> SequenceParameters:
    profile = bits.bits(8)
    bits.bits(16)
    bits.ue()
    separate = _skip_chroma_and_scaling(bits) if profile in HIGH_PROFILES else False
    log2_max_frame_num = bits.ue() + 4
    order_type, order_bits = _picture_order(bits)
    references, gaps = bits.ue(), bool(bits.bits(1))
    width, rows = 16 * (bits.ue() + 1), 16 * (bits.ue() + 1)
    frames_only = bits.bits(1)
    return SequenceParameters(width, rows * (2 - frames_only), references, not frames_only,
                              log2_max_frame_num, gaps, separate, order_type, order_bits)


def _skip_chroma_and_scaling(bits: BitReader) -> bool:
    """Skip what only high profiles have; return separate_colour_plane_flag."""
    chroma = bits.ue()
    separate = bool(bits.bits(1)) if chroma == 3 else False
    bits.ue()
    bits.ue()
    bits.bits(1)
    if bits.bits(1):
        for i in range(12 if chroma == 3 else 8):
            if bits.bits(1):
                _skip_scaling_list(bits, 16 if i < 6 else 64)
    return separate


def _skip_scaling_list(bits: BitReader, size: int):
    last = following = 8
    for _ in range(size):
        if following:
            following = (last + bits.se()) % 256
        last = following or last


def _picture_order(bits: BitReader) -> tuple[int, int]:
    """Return the type of picture order and the bits that a slice header spends on it."""
    kind = bits.ue()
    if kind == 0:
        return 0, bits.ue() + 4
    if kind == 1:
        always_zero = bits.bits(1)
        bits.se(), bits.se()
        for _ in range(bits.ue()):
            bits.se()
        return (2 if always_zero else 1), 0
    return kind, 0


def parse_pps(unit: bytes) -> tuple[int, PictureParameters] | None:
    """Return id and fields of a picture parameter set, H.264 7.3.2.2; None where it is broken."""
    bits = BitReader(unit[1:LONGEST_SET])
    try:
        number = bits.ue()
        bits.ue()
        bits.bits(1)
        bottom = bool(bits.bits(1))
        if bits.ue() or number > LAST_PPS:
            return None  # slice groups: only baseline streams that no encoder writes
        references = bits.ue() + 1, bits.ue() + 1
        bits.bits(3)
        bits.se(), bits.se(), bits.se()
        bits.bits(2)
        return number, PictureParameters(bottom, bool(bits.bits(1)), references)
    except EOFError:
        return None


class Headers:
    """Follows the headers of an H.264 stream: parameter sets, frame_num, references."""

    def __init__(self):
        """Know no parameter set yet."""
        self.sps: SequenceParameters | None = None
        self._pps: dict[int, PictureParameters] = {}
        self._last: int | None = None

    def read_parameters(self, units: Iterable[bytes]):
        """Take the newest parameter sets among the units."""
        for unit in units:
            kind = unit[0] & 31 if unit else 0
            if kind == NAL_SPS:
                self.sps = parse_sps(unit) or self.sps
            elif kind == NAL_PPS:
                self._pps.update([parse_pps(unit) or (-1, None)])

    def read_slice(self, packet: bytes) -> SliceHeader | None:
        """Return the first slice header of a packet, H.264 7.3.3; None where it is not known."""
        units = nal_units(packet)
        self.read_parameters(units)
        unit = next((u for u in units if u and u[0] & 31 in (NAL_SLICE, NAL_IDR)), None)
        if unit is None or self.sps is None or self.sps.interlaced:
            return None
        try:
            return self._slice(unit)
        except EOFError:
            return None

    def missing(self, header: SliceHeader | None) -> int:
        """Return how many reference pictures are missing before this one, H.264 7.4.3.

        Neither FFmpeg nor the container tells. The number is known up to multiples of the range
        of frame_num, 16 at least.
        """
        if header is None or self.sps.gaps_allowed:
            return 0
        last, modulus = self._last, 1 << self.sps.log2_max_frame_num
        known = not header.is_idr and last is not None
        missing = (header.frame_num - last - 1) % modulus if known else 0
        if header.is_reference:
            self._last = header.frame_num
        elif missing:  # told once; a picture that is no reference has the number of the next one
            self._last = (header.frame_num - 1) % modulus
        return missing

    def _slice(self, unit: bytes) -> SliceHeader:
        bits, sps = BitReader(unit[1:40]), self.sps
        is_idr, is_reference = unit[0] & 31 == NAL_IDR, bool(unit[0] & 0x60)
        bits.ue()
        kind, pps = bits.ue() % 5, self._pps.get(bits.ue())
        bits.bits(2 if sps.separate_planes else 0)
        number = bits.bits(sps.log2_max_frame_num)
        if is_idr:
            bits.ue()
        order = bits.bits(sps.order_bits)
        if pps is None:
            return SliceHeader(is_idr, is_reference, number, sps.max_num_ref_frames, order)
        deltas = {0: int(pps.has_bottom_order), 1: 1 + int(pps.has_bottom_order)}
        for _ in range(deltas.get(sps.order_type, 0)):
            bits.se()
        if pps.has_redundant:
            bits.ue()
        return SliceHeader(is_idr, is_reference, number, _references(bits, kind, pps), order)


def _references(bits: BitReader, kind: int, pps: PictureParameters) -> int:
    """Return the longer list of a slice of kind P (0) or B (1); 0 for an I slice."""
    if kind not in (0, 1):
        return 0
    lists = pps.references[:kind + 1]
    bits.bits(kind)
    if bits.bits(1):
        lists = tuple(bits.ue() + 1 for _ in lists)
    return max(lists)


def is_recovery_point(unit: bytes) -> bool:
    """Return whether an H.264 unit says that decoding may begin here, as intra refresh does.

    Rec. ITU-T H.264, 7.3.2.3 and D.1.8: a supplemental enhancement message of type 6.
    """
    at = 1
    while unit and unit[0] & 31 == NAL_SEI and at + 1 < len(unit):
        kind, at = _sei_number(unit, at)
        size, at = _sei_number(unit, at)
        if kind == SEI_RECOVERY_POINT:
            return True
        at += size
    return False


def _sei_number(unit: bytes, at: int) -> tuple[int, int]:
    """Return a number that is a sum of bytes, all but the last 255, and where it ends."""
    value = 0
    while unit[at:at + 1] == b'\xff':
        value, at = value + 255, at + 1
    return value + (unit[at] if at < len(unit) else 0), at + 1


def codec_of(data: bytes, named: str) -> str:
    """Return the codec that a packet shows, or else that it is said to have.

    A topic's format field is sometimes wrong, but a picture of HEVC may look like one of MPEG-2.
    """
    sniffed = sniff(data)
    return named if not sniffed or named == 'hevc' and sniffed == 'mpeg2video' else sniffed


def sniff(data: bytes) -> str:
    """Return FFmpeg's name of the codec of a packet, or '' where the payload does not tell.

    Annex B and MPEG start codes are what tells.
    """
    at = data.find(START)
    if at not in (0, 1) or at + 4 > len(data) or _length_prefixed(data):
        return ''
    code = data[at + 3]
    if code in (0xB3, 0x00, 0xB8):
        return 'mpeg2video'
    if code in (0xB0, 0xB5, 0xB6) or code == 0x20:
        return 'mpeg4'
    # Parameter sets, delimiter and key pictures of HEVC; H.264 has no such second byte there.
    if code in (0x26, 0x28, 0x2A, 0x40, 0x42, 0x44, 0x46) and data[at + 4:at + 5] == b'\x01':
        return 'hevc'
    return 'h264' if code & 31 in (NAL_SLICE, NAL_IDR, NAL_SEI, NAL_SPS, NAL_PPS, 9) else ''

