"""Runs on real workers: each once, whatever ends one of them."""

import os
from pathlib import Path
import signal

from mv_slapse.errors import UsageError
from mv_slapse.tools.batch import places, scheduling, task
from mv_slapse.tools.batch.manifest import Recording
from mv_slapse.tools.batch.workers import open_pool, Workers
import pytest


def by_name(rows):
    return {row['name']: row for row in rows}


def test_every_recording_is_a_row_and_those_done_are_not_run_again(items, pool, tmp_path):
    kept, left = scheduling.split(items, tmp_path)
    assert not kept
    assert [item.size for item in left] == sorted((item.size for item in items), reverse=True)
    rows = by_name(scheduling.run_all(left, tmp_path, pool))
    assert {name: row['exit_code'] for name, row in rows.items()} == {
        'a.mpg': 0, 'b.mpg': 0, 'c.mpg': 0, 'text.mp4': 3}
    assert all(row['worker'].startswith('tcp://127.0.0.1:') for row in rows.values())
    kept, left = scheduling.split(items, tmp_path)
    assert [item.name for item in left] == ['text.mp4']
    assert by_name(kept) == {name: row for name, row in rows.items() if name != 'text.mp4'}
    assert sorted(path.name for path in tmp_path.iterdir()) == sorted(rows)


def test_a_row_of_a_dead_worker_is_run_by_another(pool, tmp_path):
    def deadly(item: Recording, output: str, call: str) -> task.Row:
        """End the process of the first try of one of the runs."""
        tries = Path(output, f'{item.name} tries')
        tries.write_text(f'{tries.read_text() if tries.exists() else ""}.')
        if item.name == '2' and len(tries.read_text()) == 1:
            os.kill(os.getpid(), signal.SIGKILL)
        return task.empty_row(item) | {'status': 'done', 'exit_code': 0}

    items = [Recording('', str(i)) for i in range(6)]
    rows = list(scheduling.run_all(items, tmp_path, pool, deadly))
    assert sorted(row['name'] for row in rows) == [str(i) for i in range(6)]
    assert (tmp_path / '2 tries').read_text() == '..'


def test_an_error_of_a_task_is_a_row(pool, tmp_path):
    def wrong(item: Recording, output: str, call: str) -> task.Row:
        """Raise what this package raises, or what it never should."""
        if item.name == 'known':
            raise UsageError('the disk is full')
        raise ZeroDivisionError('why')

    rows = by_name(scheduling.run_all([Recording('', 'known'), Recording('', 'unknown')],
                                      tmp_path, pool, wrong))
    assert (rows['known']['exit_code'], rows['known']['reason']) == (2, 'the disk is full')
    assert (rows['unknown']['exit_code'], rows['unknown']['reason']) == (
        1, 'ZeroDivisionError: why')


def test_what_needs_too_much_memory_is_tried_three_times_and_said(items, tmp_path):
    def hungry(item: Recording, output: str, call: str) -> task.Row:
        """Take a gigabyte in the run of one of them."""
        def eat(*_, **__):
            """Take it, page by page, so that the worker is seen to grow."""
            taken = []
            while True:
                taken.append(bytearray(os.urandom(1 << 20)))

        if item.name == 'b.mpg':
            task.running.run = eat
        return task.run_recording(item, output, call)

    with open_pool(Workers(1, memory_limit='600MiB')) as pool:
        rows = by_name(scheduling.run_all(items[1:], tmp_path, pool, hungry))
    assert {name: row['exit_code'] for name, row in rows.items()} == {
        'b.mpg': task.DIED, 'c.mpg': 0, 'text.mp4': 3}
    assert rows['b.mpg']['reason'] == scheduling.MEMORY
    assert len(rows['b.mpg']['died_on']) == 3
    assert not task.remains(tmp_path)


def test_a_folder_serves_one_call_at_a_time(tmp_path):
    (tmp_path / 'a.mp4.0123abcd-0.part').mkdir()
    (tmp_path / 'a.mp4.0123abcd-0.old.part').mkdir()
    with scheduling.claimed(tmp_path):
        assert not task.remains(tmp_path)
        with pytest.raises(UsageError, match='another call'), scheduling.claimed(tmp_path):
            pass
    with scheduling.claimed(tmp_path):
        pass


def test_a_folder_of_others_is_not_cleared(tmp_path):
    for name in ('night.part', 'drive.2024-1.part'):
        (tmp_path / name).mkdir()
    with scheduling.claimed(tmp_path):
        assert {path.name for path in tmp_path.iterdir()} == {
            'night.part', 'drive.2024-1.part', places.LOCK}


def test_no_more_is_handed_over_than_workers_need(pool, tmp_path):
    def quick(item: Recording, output: str, call: str) -> task.Row:
        """Return a row."""
        return task.empty_row(item) | {'status': 'done', 'exit_code': 0}

    items = [Recording('', str(i)) for i in range(3 * scheduling.AT_ONCE)]
    most = 0
    rows = []
    for row in scheduling.run_all(items, tmp_path, pool, quick):
        most = max(most, pool.running)
        rows.append(row['name'])
    assert sorted(rows) == sorted(item.name for item in items)
    assert most <= scheduling.AT_ONCE
