"""``mv_slapse batch``: the same run over many recordings; exit code 5 where some failed."""

import argparse
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
import json
from pathlib import Path
import signal
import sys
from typing import Any

from mv_slapse.config import Settings
from mv_slapse.tools.batch import page, places, scheduling, summary, task
from mv_slapse.tools.batch.manifest import FILES, Recording, recordings
from mv_slapse.tools.batch.task import Row
from mv_slapse.tools.batch.workers import (
    cores,
    open_pool,
    Pool,
    require_dask,
    UnusableCluster,
    Workers,
)
from mv_slapse.tools.plain import plain
from mv_slapse.tools.terminal import say
from tqdm import tqdm

SOME_FAILED, INTERRUPTED = 5, 130
TELL_AGAIN = 0.5  # s between two drawings of the bar


def main(args: argparse.Namespace, settings: Settings) -> int:
    """Run what the arguments ask for and return the exit code.

    Raises
    ------
    MvSlapseError
        Where nothing can be run; a recording that cannot is a row.
    """
    require_dask()
    output = Path(args.output).resolve()
    like = Recording('', camera=args.camera or '', speed=args.speed or '', topic=args.topic or '',
                     max_frames=args.max_frames or 0, settings=settings,
                     report=not args.no_report)
    items = recordings(args.input, like, args.sweep, output, task.code())
    places.check(output, [item.name for item in items],
                 [getattr(item, file) for item in items for file in ('input', *FILES)])
    signal.signal(signal.SIGTERM, signal.default_int_handler)  # ends like Ctrl-C
    with scheduling.claimed(output):
        rows, left = scheduling.split(items, output)
        rows = [summary.short(row) for row in rows]
        code, message = _collect(args, left, output, rows)
        found = {row['name']: row for row in rows}
        rows = [found.get(item.name) or _on_disk(item, output) for item in items]
        summary.write(rows, output / summary.TABLE)
        page.write(rows, output)
    return _tell(args, rows, output, code or _code(rows), message)


def _collect(args: argparse.Namespace, left: Sequence[Recording], output: Path,
             rows: list[Row]) -> tuple[int, str]:
    """Run what is left and add its rows; return exit code and message where that ended early."""
    if not left:
        return 0, ''
    workers = Workers(args.workers or 0, memory_limit=args.memory_limit or '',
                      scheduler=args.scheduler or '')
    if not args.scheduler:  # more would only wait
        workers = Workers(min(workers.count or cores(), len(left)),
                          memory_limit=workers.memory_limit)
    try:
        with open_pool(workers) as pool, _bar(args, pool, rows, len(left)) as tell:
            for row in scheduling.run_all(left, output, pool):
                rows.append(summary.short(row))
                tell(row)
    except KeyboardInterrupt:
        return INTERRUPTED, 'interrupted; what is done is whole, and the same call goes on'
    except UnusableCluster as error:
        if not rows:
            raise
        return error.exit_code, str(error)
    return 0, ''


def _on_disk(item: Recording, output: Path) -> Row:
    """Return the row of a run that nobody has told of: where a batch ended early."""
    row = task.kept_row(output / item.name, item.key)
    return task.empty_row(item) if row is None else summary.short(row)


def _code(rows: Sequence[Row]) -> int:
    return 0 if all(row['exit_code'] == 0 for row in rows) else SOME_FAILED


@contextmanager
def _bar(args: argparse.Namespace, pool: Pool, kept: Sequence[Row], n_left: int
         ) -> Iterator[Callable[[Row], None]]:
    """Draw how many runs are done, have failed and are left, where somebody watches."""
    is_quiet = args.quiet or args.json
    if pool.dashboard and not is_quiet:
        sys.stderr.write(f'dashboard: {pool.dashboard}\n')
    n_kept = len(kept)
    counts = {'failed': 0}
    with tqdm(total=n_kept + n_left, initial=n_kept, unit=' runs', mininterval=TELL_AGAIN,
              disable=is_quiet or not sys.stderr.isatty()) as bar:
        def tell(row: Row):
            """Count a run that has ended."""
            counts['failed'] += row['exit_code'] != 0
            bar.set_postfix(counts, workers=pool.threads, refresh=False)
            bar.update()

        yield tell


def _tell(args: argparse.Namespace, rows: Sequence[Row], output: Path, code: int, message: str
          ) -> int:
    if message:
        sys.stderr.write(f'mv_slapse batch: {message}\n')
    if args.json:
        content: dict[str, Any] = {'exit_code': code, 'rows': plain(list(rows)),
                                   'output': str(output)}
        say(json.dumps(content | ({'error': message} if message else {})))
    elif not args.quiet:
        say(summary.text(rows, output))
    return code
