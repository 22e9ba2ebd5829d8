"""Counts of a long run."""

from mv_slapse.tools.tallies import MOST_TEXTS, Numbers, OTHER, Texts
import numpy as np


def test_numbers_are_counted_once(rng):
    drawn = rng.integers(0, 5000, 3000)
    numbers = Numbers()
    for number in drawn:
        numbers.add(int(number))
    assert len(numbers) == len(np.unique(drawn))
    assert len(Numbers()) == 0


def test_texts_beyond_the_most_count_together():
    texts = Texts()
    for i in range(MOST_TEXTS + 5):
        texts.take(f'reason {i}')
    texts.take('reason 3')
    assert texts['reason 3'] == 2
    assert texts[OTHER] == 5
    assert len(texts) == MOST_TEXTS + 1
    assert sum(texts.values()) == MOST_TEXTS + 6
