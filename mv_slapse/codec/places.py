"""The places of pictures in the order of showing, and whether some between them were lost.

What is lost is told by what is left: a hole in the counts of pictures, in their times, or in the
order of decoding. FFmpeg and containers do not tell.

ITU-T H.264 8.2.1 (picture order count), ISO/IEC 13818-2 6.3.8 and 6.3.9 (time_code,
temporal_reference), ISO/IEC 14496-2 6.3.5 (modulo_time_base, vop_time_increment).
"""

from collections import Counter, deque
from contextlib import suppress
from dataclasses import dataclass
from typing import NamedTuple

from mv_slapse.codec.bitstream import BitReader, Headers, SliceHeader

PICTURE, SEQUENCE, GROUP = b'\x00\x00\x01\x00', b'\x00\x00\x01\xb3', b'\x00\x00\x01\xb8'
VOP, GOV = b'\x00\x00\x01\xb6', b'\x00\x00\x01\xb3'
FRAME_RATES = (0, 24, 24, 25, 30, 30, 50, 60, 60)  # [1/s] that time codes count with
B_PICTURE, B_VOP = 3, 2
TURN = 1024  # values of temporal_reference
KEPT = 64  # packets: no encoder reorders farther, and none need wait longer for its picture
LOST = 'pictures were lost'
LATE = f'{LOST} (gap in the times of pictures)'  # or left out before they were coded


class Rules(NamedTuple):
    """Constants of the step that is usual from picture to picture."""

    recent: int = 32  # steps of a clock that say what is usual
    long: float = 1.5  # times the longest usual step: a lost picture doubles the step
    alike: float = 0.1  # share by which steps of one rate may differ
    again: int = 2  # long steps after a long one and alike, which are no losses but a new rate
    few: int = 2  # steps that tell what is usual of a steady clock,
    enough: int = 8  # and of any
    whole: float = 0.25  # usual steps by which stamps may depart from a steady clock
    steady: float = 0.6  # share of a count's steps that are usual, if it counts pictures


RULES = Rules()


@dataclass(frozen=True)
class Place:
    """Where a picture is shown."""

    sequence: int = 0  # counts are compared within one; the next one shown has the next number
    count: int | None = None  # grows by one step from picture to picture; None: nothing counts
    index: int | None = None  # the same across sequences, if time codes are to be trusted
    time: int | None = None  # the picture's time by the stream's own clock, in ticks of it
    turn: int = 0  # where the count turns over to zero; 0 where it is not known
    reason: str = ''  # why pictures decoded before this one are missing; else empty
    references: int | None = None  # most pictures in a list of them, by the picture's own header
    is_reference: bool = True  # whether others may be predicted from it, for all that is known


class Places:
    """Reads the place of each packet, in the order of decoding; of none here."""

    def read(self, data: bytes) -> Place:
        """Return the place of a packet's picture, which here tells nothing."""
        return Place()


def places_of(codec: str, headers: Headers, extradata: bytes) -> Places:
    """Return what reads the places of a codec's pictures."""
    if codec == 'h264':
        return OrderCount(headers)
    if codec == 'mpeg4':
        return VopTime(extradata)
    return GroupPlaces() if codec in ('mpeg1video', 'mpeg2video') else Places()


class OrderCount(Places):
    """H.264: picture order count, and frame_num where showing follows decoding."""

    def __init__(self, headers: Headers):
        """Share the parameter sets with the decoder."""
        self._headers = headers
        self._sequence = self._count = self._msb = self._lsb = 0

    def read(self, data: bytes) -> Place:
        """Return the place of a packet's picture."""
        header = self._headers.read_slice(data)
        missing = self._headers.missing(header)
        if header is None:
            return Place(self._sequence)
        if header.is_idr:
            self._sequence, self._count = self._sequence + 1, -1
        reason = 'a reference picture was lost (gap in frame_num)' if missing else ''
        sps = self._headers.sps
        turn = 1 << (sps.log2_max_frame_num if sps.order_type else sps.order_bits)
        return Place(self._sequence, self._next(header, missing), turn=turn, reason=reason,
                     references=header.references, is_reference=header.is_reference)

    def _next(self, header: SliceHeader, missing: int) -> int | None:
        kind = self._headers.sps.order_type
        if kind == 0:
            return self._order(header, 1 << self._headers.sps.order_bits)
        self._count += 1 + missing
        return self._count if kind == 2 and not self._headers.sps.gaps_allowed else None

    def _order(self, header: SliceHeader, modulus: int) -> int:
        """Return the order of a picture, H.264 (8-3)."""
        if header.is_idr:
            self._msb = self._lsb = 0
        ahead = header.order - self._lsb
        turns = (ahead <= -modulus // 2) - (ahead > modulus // 2)
        msb = self._msb + turns * modulus
        if header.is_reference:
            self._msb, self._lsb = msb, header.order
        return msb + header.order


class GroupPlaces(Places):
    """MPEG-1 and MPEG-2: the place in a group of pictures, and the group's time code."""

    def __init__(self):
        """Trust no time code yet: some encoders write the same one for ever."""
        self._rate = self._group = self._pictures = self._begin = self._trust = 0
        self._turns = 0

    def read(self, data: bytes) -> Place:
        """Return the place of a packet's picture; temporal_reference counts as shown."""
        at = data.find(PICTURE)
        if at < 0 or len(data) < at + 6:
            return Place(self._group)
        self._read_rate(data[:at])
        group = data.find(GROUP, 0, at)
        if group >= 0:
            self._enter(data[group + 4:group + 8])
        count = self._turns + (data[at + 4] << 2 | data[at + 5] >> 6)
        if count < self._pictures - TURN // 2:
            self._turns, count = self._turns + TURN, count + TURN
        self._pictures = max(self._pictures, count + 1)
        index = self._begin + count if self._trust > 0 else None
        is_reference = data[at + 5] >> 3 & 7 != B_PICTURE
        return Place(self._group, count, index, turn=TURN, is_reference=is_reference)

    def _read_rate(self, head: bytes):
        at = head.find(SEQUENCE)
        if at >= 0 and len(head) >= at + 8:
            code = head[at + 7] & 15
            self._rate = FRAME_RATES[code] if code < len(FRAME_RATES) else 0

    def _enter(self, code: bytes):
        """Begin a group; its time code is trusted if those before were right more than wrong."""
        bits = _plain(code.ljust(4, b'\x00'))
        dropping, seconds, pictures = bits.bits(1), _seconds(bits), bits.bits(6)
        begin = seconds * self._rate + pictures
        right = begin - self._begin == self._pictures and not dropping
        if self._group:
            self._trust = min(max(self._trust + (1 if right else -1), -2), 8)
        self._group, self._begin, self._pictures = self._group + 1, begin, 0
        self._turns = 0


class VopTime(Places):
    """MPEG-4 part 2: the time of a picture by modulo_time_base and vop_time_increment."""

    def __init__(self, extradata: bytes):
        """Take the clock's resolution from the parameter sets, if they are apart."""
        self._resolution = self._base = self._last_base = 0
        self._read_resolution(extradata)

    def read(self, data: bytes) -> Place:
        """Return the place of a packet's picture, which has a time and no count."""
        at = data.find(VOP)
        self._read_resolution(data if at < 0 else data[:at])
        time, is_b = None, 0 <= at < len(data) - 4 and data[at + 4] >> 6 == B_VOP
        if at >= 0 and self._resolution:
            with suppress(EOFError):
                time = self._time(data, at, is_b)
        return Place(time=time, is_reference=not is_b)

    def _time(self, data: bytes, at: int, is_b: bool) -> int:
        gov = data.find(GOV, 0, at)
        if gov >= 0:
            self._base = _seconds(_plain(data[gov + 4:gov + 8]))
        bits, seconds = _plain(data[at + 4:at + 20]), 0
        bits.bits(2)
        while bits.bits(1):
            seconds += 1
        bits.bits(1)
        if not is_b:
            self._last_base, self._base = self._base, self._base + seconds
        base = self._last_base + seconds if is_b else self._base
        return base * self._resolution + bits.bits(max((self._resolution - 1).bit_length(), 1))

    def _read_resolution(self, head: bytes):
        for code in range(0x20, 0x30):  # video_object_layer_start_code
            at = head.find(bytes([0, 0, 1, code]))
            if at >= 0:
                self._resolution = 0
                with suppress(EOFError):
                    self._resolution = _resolution(_plain(head[at + 4:at + 80]))


def _seconds(bits: BitReader) -> int:
    """Return hours, minutes, a marker and seconds as seconds."""
    minutes = 60 * bits.bits(5) + bits.bits(6)
    bits.bits(1)
    return 60 * minutes + bits.bits(6)


def _resolution(bits: BitReader) -> int:
    """Return vop_time_increment_resolution of a video object layer, ISO/IEC 14496-2 6.2.3."""
    bits.bits(9)
    if bits.bits(1):
        bits.bits(7)
    if bits.bits(4) == 15:  # extended_PAR
        bits.bits(16)
    if bits.bits(1):  # vol_control_parameters
        bits.bits(3)
        if bits.bits(1):
            bits.bits(79)  # vbv_parameters
    if bits.bits(2) == 3:
        return 0  # grey shapes: no encoder writes them
    bits.bits(1)
    return bits.bits(16)


def _plain(data: bytes) -> BitReader:
    """Return the bits of an MPEG header, which knows no emulation prevention."""
    return BitReader(data, is_escaped=False)


class Continuity:
    """Follows pictures from the order of decoding into the order of showing."""

    def __init__(self):
        """Expect nothing of the first picture."""
        self._places: dict[int, Place] = {}
        self._events: dict[int, str] = {}
        self._last: Place | None = None
        self._steps: deque[int] = deque(maxlen=2 * RULES.recent)
        self._usual, self._length = 1, None
        self._stamps, self._times = _Clock(), _Clock()

    def add(self, number: int, place: Place):
        """Note the place of a packet by its number; packets come in the order of decoding."""
        self._places[number] = place
        if place.reason:
            self.report(number, place.reason)
        forget(self._places, number - KEPT)

    def report(self, number: int, reason: str):
        """Note what is wrong at a packet: it concerns the first picture of it or of a later one.

        A packet that cannot be decoded often gives no picture, and FFmpeg may show none for a
        while after it: the damage waits.
        """
        self._events.setdefault(number, reason)
        forget(self._events, number - KEPT)

    def place(self, number: int) -> Place:
        """Return the place of a packet's picture; one that tells nothing where it is unknown."""
        return self._places.get(number, Place())

    def damage(self, number: int, stamp: int) -> str:
        """Return why the picture of a packet cannot be joined to the one shown before it."""
        due = [n for n in self._events if n <= number]
        reasons = [self._events.pop(n) for n in due]
        place = self._places.pop(number, Place())
        hole = self._hole(place, stamp)
        self._last = place
        return (reasons or [hole])[0]

    def _hole(self, place: Place, stamp: int) -> str:
        follows = None if self._last is None else self._follows(self._last, place)
        if follows and self._is_turn(place, self._stamps.left_out(stamp)):
            follows = False
        late = self._stamps.is_late(stamp, follows)
        if place.time is not None:
            late |= self._times.is_late(place.time, follows)
        if follows is False:
            return f'{LOST} (gap in the count of pictures)'
        return LATE if late else ''

    def _follows(self, last: Place, place: Place) -> bool | None:
        """Tell by counts whether a place is the next; None where they do not say."""
        if last.sequence != place.sequence:
            self._length = last.count
        if last.index is not None and place.index is not None:
            return place.index - last.index == 1
        if last.sequence != place.sequence:
            begins = place.sequence == last.sequence + 1 and not place.count
            return None if begins else False
        if last.count is None or place.count is None:
            return None
        self._steps.append(place.count - last.count)
        counts = Counter(self._steps)  # of equals the smallest above zero is the usual one
        self._usual = max(counts, key=lambda step: (counts[step], step > 0, -step))
        if counts[self._usual] < RULES.steady * len(self._steps):
            return None
        return place.count - last.count == self._usual

    def _is_turn(self, place: Place, missing: int) -> bool:
        """Tell whether so many lost pictures would leave the count as if there were none.

        The count has turned over, or the beginning of a sequence was lost and counting began
        anew without notice.
        """
        if missing < 1 or not place.turn:
            return False
        ahead = missing * self._usual
        if self._length is None:  # how long a sequence is will be seen at its end
            return ahead % place.turn == 0 or ahead >= place.count
        return ahead % place.turn in (0, (self._length + self._usual) % place.turn)


class _Clock:
    """What step of a clock is usual from picture to picture."""

    def __init__(self):
        self._recent: deque[int] = deque(maxlen=RULES.recent)
        self._last: int | None = None
        self._odd = self._times = 0

    def is_late(self, value: int, follows: bool | None) -> bool:
        """Tell whether a picture comes too late; ``follows`` where counts tell better."""
        last, self._last = self._last, value
        step = 0 if last is None else value - last
        if last is None or follows is False:
            return False
        late = follows is None and self._is_known() and step > RULES.long * max(self._recent)
        alike = late and abs(step - self._odd) <= RULES.alike * step
        self._odd, self._times = (step, self._times + 1 if alike else 0) if late else (0, 0)
        again = self._times >= RULES.again
        if step > 0 and (again or not late):
            self._recent.append(step)
        return late and not again

    def left_out(self, value: int) -> int:
        """Return how many pictures a steady clock would have shown before this one; else 0."""
        if self._last is None or len(self._recent) < RULES.few or not self._is_steady():
            return 0
        steps = (value - self._last) / sorted(self._recent)[len(self._recent) // 2]
        return round(steps) - 1 if abs(steps - round(steps)) < RULES.whole else 0

    def _is_known(self) -> bool:
        n = len(self._recent)
        return n >= RULES.enough or n >= RULES.few and self._is_steady()

    def _is_steady(self) -> bool:
        return max(self._recent) <= (1 + RULES.whole) * min(self._recent)


def forget(items: dict[int, object], first: int):
    """Take out what belongs to packets before ``first``; numbers only grow."""
    while items and (oldest := next(iter(items))) < first:
        del items[oldest]
