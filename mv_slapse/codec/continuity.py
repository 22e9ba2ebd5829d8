"""Whether a picture is the next to be shown after the one before, or some between were lost.

What is lost is told by what is left: a hole in the counts of pictures, in their times, or in
the order of decoding. FFmpeg and containers do not tell.
"""

from collections import Counter, deque

from mv_slapse.codec.places import Place

KEPT = 64  # packets: no encoder reorders farther, and none need wait longer for its picture
RECENT = 32  # steps of a clock that say what is usual
LONG = 1.5  # times the longest usual step: a lost picture doubles the step
ALIKE = 0.1  # share by which steps of one rate may differ
AGAIN = 2  # long steps after a long one and alike, which are no losses but a new rate
FEW, ENOUGH = 2, 8  # steps that tell what is usual of a steady clock, and of any
WHOLE = 0.25  # usual steps by which stamps may depart from a steady clock
STEADY = 0.6  # share of the usual step of a count, below which it does not count pictures
LOST = 'pictures were lost'


class Continuity:
    """Follows pictures from the order of decoding into the order of showing."""

    def __init__(self):
        """Expect nothing of the first picture."""
        self._places: dict[int, Place] = {}
        self._events: dict[int, str] = {}
        self._last: Place | None = None
        self._steps: deque[int] = deque(maxlen=2 * RECENT)
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

    def references(self, number: int) -> int | None:
        """Return how many references a packet's picture tells that it has."""
        return self._places[number].references if number in self._places else None

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
        return f'{LOST} (gap in the times of pictures)' if late else ''

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
        self._usual, times = _most_common(self._steps)
        if times < STEADY * len(self._steps):
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
        self._recent: deque[int] = deque(maxlen=RECENT)
        self._last: int | None = None
        self._odd = self._times = 0

    def is_late(self, value: int, follows: bool | None) -> bool:
        """Tell whether a picture comes too late; ``follows`` where counts tell better."""
        last, self._last = self._last, value
        step = 0 if last is None else value - last
        if last is None or follows is False:
            return False
        late = follows is None and self._is_known() and step > LONG * max(self._recent)
        alike = late and abs(step - self._odd) <= ALIKE * step
        self._odd, self._times = (step, self._times + 1 if alike else 0) if late else (0, 0)
        again = self._times >= AGAIN
        if step > 0 and (again or not late):
            self._recent.append(step)
        return late and not again

    def left_out(self, value: int) -> int:
        """Return how many pictures a steady clock would have shown before this one; else 0."""
        if self._last is None or len(self._recent) < FEW or not self._is_steady():
            return 0
        steps = (value - self._last) / sorted(self._recent)[len(self._recent) // 2]
        return round(steps) - 1 if abs(steps - round(steps)) < WHOLE else 0

    def _is_known(self) -> bool:
        n = len(self._recent)
        return n >= ENOUGH or n >= FEW and self._is_steady()

    def _is_steady(self) -> bool:
        return max(self._recent) <= (1 + WHOLE) * min(self._recent)


def forget(items: dict[int, object], first: int):
    """Take out what belongs to packets before ``first``; numbers only grow."""
    while items and (oldest := next(iter(items))) < first:
        del items[oldest]


def _most_common(steps: deque[int]) -> tuple[int, int]:
    """Return the most frequent step and its number; of equals the smallest above zero."""
    counts = Counter(steps)
    return max(counts.items(), key=lambda item: (item[1], item[0] > 0, -item[0]))
