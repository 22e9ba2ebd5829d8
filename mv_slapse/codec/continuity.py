"""Whether a picture is the next to be shown after the one before, or some between were lost.

What is lost is told by what is left: a hole in the counts of pictures, in their times, or in
the order of decoding. FFmpeg and containers do not tell.
"""

from collections import Counter, deque

from mv_slapse.codec.places import Place

KEPT = 64  # packets: no encoder reorders farther, and none need wait longer for its picture
RECENT = 32  # steps of a clock that say what is usual
LONG = 1.5  # times the longest usual step: a lost picture doubles the step
ALIKE = 0.25  # share by which two long steps may differ and be a new rate
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
        late = self._stamps.is_late(stamp, follows)
        if place.time is not None:
            late |= self._times.is_late(place.time, follows)
        if follows is False:
            return f'{LOST} (gap in the count of pictures)'
        return f'{LOST} (gap in the times of pictures)' if late else ''

    def _follows(self, last: Place, place: Place) -> bool | None:
        """Tell by counts whether a place is the next; None where they do not say."""
        if last.index is not None and place.index is not None:
            return place.index - last.index == 1
        if last.sequence != place.sequence:
            begins = place.sequence == last.sequence + 1 and not place.count
            return None if begins else False
        if last.count is None or place.count is None:
            return None
        self._steps.append(place.count - last.count)
        (usual, times), = _most_common(self._steps)
        return place.count - last.count == usual if times >= STEADY * len(self._steps) else None


class _Clock:
    """What step of a clock is usual from picture to picture."""

    def __init__(self):
        self._recent: deque[int] = deque(maxlen=RECENT)
        self._last: int | None = None
        self._odd = 0

    def is_late(self, value: int, follows: bool | None) -> bool:
        """Tell whether a picture comes too late; ``follows`` where counts tell better."""
        last, self._last = self._last, value
        step = 0 if last is None else value - last
        if last is None or follows is False:
            return False
        late = follows is None and len(self._recent) > 1 and step > LONG * max(self._recent)
        # A second step as long as that is no loss any more but another rate.
        again = late and abs(step - self._odd) <= ALIKE * step
        self._odd = step if late else 0
        if step > 0 and (again or not late):
            self._recent.append(step)
        return late and not again


def forget(items: dict[int, object], first: int):
    """Take out what belongs to packets before ``first``; numbers only grow."""
    while items and (oldest := next(iter(items))) < first:
        del items[oldest]


def _most_common(steps: deque[int]) -> list[tuple[int, int]]:
    """Return the most frequent step and its number; of equals the smallest above zero."""
    counts = Counter(steps)
    return [max(counts.items(), key=lambda item: (item[1], item[0] > 0, -item[0]))]
