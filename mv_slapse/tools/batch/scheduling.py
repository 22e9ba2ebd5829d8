"""All runs of a batch: what is done is kept, long ones come first, the dead are tried again."""

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
import shutil
import uuid

from mv_slapse.errors import MvSlapseError, UsageError
from mv_slapse.storage import whole_files
from mv_slapse.tools.batch import task
from mv_slapse.tools.batch.manifest import Recording
from mv_slapse.tools.batch.places import BEGUN, LOCK
from mv_slapse.tools.batch.task import Row
from mv_slapse.tools.batch.workers import died, Pool

#: tasks that the scheduler holds, so that this process stays small and no worker waits for it
AT_ONCE, FOR_EACH_THREAD = 64, 4
MEMORY = ('it takes more memory than its worker has; give fewer workers, or more with '
          '--memory-limit')

Tell = Callable[[Row], None]


@contextmanager
def claimed(output: Path) -> Iterator[None]:
    """Keep a folder for this call, and clear it of what earlier ones had only begun.

    Raises
    ------
    UsageError, UnusableOutput
        Where another call works in it, or it cannot be written.
    """
    try:
        output.mkdir(parents=True, exist_ok=True)
        lock = whole_files.locked(output / LOCK)
    except OSError as error:
        raise whole_files.unusable(output, error) from error
    if lock is None:
        raise UsageError(f'another call of mv_slapse batch works in {output}; wait for it, or '
                         'choose another folder with -o')
    with lock:
        clear(output)
        yield


def clear(output: Path, name: str = BEGUN):
    """Remove what runs have begun and not finished."""
    for part in task.remains(output, name):
        shutil.rmtree(part, ignore_errors=True)


def split(recordings: Sequence[Recording], output: Path) -> tuple[list[Row], list[Recording]]:
    """Return the rows of the runs that are finished, and the others, the longest first."""
    kept = {item: row for item in recordings
            if (row := task.kept_row(output / item.name, item.key)) and task.is_finished(row)}
    left = [item for item in recordings if item not in kept]
    return list(kept.values()), sorted(left, key=lambda item: -item.size)


def run_all(recordings: Sequence[Recording], output: Path, pool: Pool,
            run: task.Task = task.run_recording) -> Iterator[Row]:
    """Run recordings in their order and yield their rows as they end.

    Parameters
    ----------
    run : function of a recording, the folder and the name of this call
        Returns a row; a task of the workers.

    Raises
    ------
    UnusableCluster
        Where the scheduler is lost.
    """
    call, waiting = uuid.uuid4().hex[:8], iter(enumerate(recordings))
    tries: dict[Recording, int] = {}

    def submit(item: Recording, priority: int):
        """Hand a run over."""
        pool.submit((item, priority), run, item, str(output), call, priority=priority)

    def fill():
        """Hand over so many that no worker has to wait."""
        bound = max(AT_ONCE, FOR_EACH_THREAD * pool.threads)
        while pool.running < bound and (entry := next(waiting, None)):
            submit(entry[1], -entry[0])

    fill()
    for (item, priority), result in pool.results():
        if died(result) and tries.setdefault(item, 0) < task.TRIES:
            tries[item] += 1  # the task counts its starts itself: it may never have been at fault
            submit(item, priority)
            continue
        yield _row(item, result, pool)
        fill()
    clear(output, f'*.{call}-*')  # what dead workers have left


def _row(item: Recording, result: Row | Exception, pool: Pool) -> Row:
    """Return the row of a task that has ended, however it has."""
    if isinstance(result, dict):
        lost = set(result.get('died_on', ()))
        for_memory = lost and lost <= pool.ended_for_memory()
        return result | {'reason': MEMORY} if for_memory else result
    if isinstance(result, MvSlapseError):
        return task.failed_row(item, result.exit_code, str(result))
    code = task.DIED if died(result) else task.FAULT
    return task.failed_row(item, code, f'{type(result).__name__}: {result}')
