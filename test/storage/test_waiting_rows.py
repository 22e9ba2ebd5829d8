"""Rows that wait on the disk, and who asks for them in vain."""

from contextlib import suppress

from mv_slapse.storage.waiting_rows import WaitingRows
import pytest


def test_rows_come_back_as_often_as_they_are_asked_for():
    rows = WaitingRows()
    for k in range(3):
        rows.add(f'row {k}')
    assert [*rows] == [*rows] == ['row 0\n', 'row 1\n', 'row 2\n']
    rows.close()


def test_a_full_disk_of_who_asks_costs_no_row():
    rows = WaitingRows()
    for k in range(5000):  # more than any buffer holds
        rows.add(f'row {k}')
    with (suppress(OSError), open('/dev/full', 'w') as full,
          pytest.raises(OSError, match='No space left')):
        full.writelines(rows)
    rows.add('the next')
    found = [*rows]
    assert len(found) == 5001
    assert found[-2:] == ['row 4999\n', 'the next\n']
