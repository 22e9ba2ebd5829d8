"""``batch.csv``: one row a run, and what they come to."""

from collections import Counter
from collections.abc import Iterable, Sequence
import csv
from pathlib import Path
from typing import Any

from mv_slapse.storage import whole_files
from mv_slapse.tools.batch.places import PAGE, TABLE
from mv_slapse.tools.batch.task import DONE, FAILED, LEFT, LOST, Row

COLUMNS = ('name', 'input', 'swept', 'status', 'exit_code', 'reason', 'duration_s', 'frames',
           'way', 'key_frames', 'poses', 'lost_percent', 'scale', 'scale_source', 'planes',
           'obstacles', 'hazards', 'ate_m', 'epsilon_d_percent', 'cpu_ms', 'worker')
DIGITS = 6


def write(rows: Iterable[Row], path: Path):
    """Write rows as a table.

    Raises
    ------
    UnusableOutput
    """
    with whole_files.whole(path) as file:
        table = csv.DictWriter(file, COLUMNS, extrasaction='ignore', lineterminator='\n')
        table.writeheader()
        table.writerows({name: _cell(row.get(name)) for name in COLUMNS} for row in rows)


def short(row: Row) -> Row:
    """Return a row without what the table has no column for; that stays in its folder."""
    return {name: row[name] for name in (*COLUMNS, 'ground_truth') if row.get(name) is not None}


def text(rows: Sequence[Row], output: Path) -> str:
    """Return what a batch reports on the terminal."""
    counts = Counter(row['status'] for row in rows)
    total = ', '.join(f'{counts[status]} {status}' for status in (DONE, LOST, FAILED, LEFT)
                      if counts[status])
    bad = [f'{row["name"]}: {row["status"]} (exit code {row["exit_code"]}): {row["reason"]}'
           for row in rows if row['status'] in (LOST, FAILED)]
    more = [f'... and {len(bad) - 20} more'] if len(bad) > 20 else []
    return '\n'.join([*bad[:20], *more, f'{len(rows)} recordings: {total or "none"}',
                      f'table in {output / TABLE}, page in {output / PAGE}'])


def _cell(value: Any) -> Any:
    if isinstance(value, float):
        return f'{value:.{DIGITS}g}'
    return ' '.join(value.split()) if isinstance(value, str) else value
