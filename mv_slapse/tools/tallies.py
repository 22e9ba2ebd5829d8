"""Counts of what a run saw that stay small however long it lasts."""

from collections import Counter

MOST_TEXTS = 200
OTHER = 'other reasons'


class Numbers:
    """Which numbers from 0 on were seen: a bit for each up to the largest."""

    def __init__(self):
        """Hold none yet."""
        self._bits = bytearray()

    def add(self, number: int):
        """Take a number."""
        byte = number >> 3
        if byte >= len(self._bits):
            self._bits.extend(bytes(byte + 1 - len(self._bits)))
        self._bits[byte] |= 1 << (number & 7)

    def __len__(self) -> int:
        """Return how many different ones there were."""
        return sum(byte.bit_count() for byte in self._bits)


class Texts(Counter):
    """How often each text occurred; those that come after MOST_TEXTS others count together."""

    def take(self, text: str):
        """Count a text."""
        self[text if text in self or len(self) < MOST_TEXTS else OTHER] += 1
