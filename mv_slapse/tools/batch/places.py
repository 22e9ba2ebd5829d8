"""Where a batch writes: what it leaves there, and what of others it must not touch."""

from collections.abc import Iterable
import os
from pathlib import Path

from mv_slapse.errors import UnusableOutput, UsageError
from mv_slapse.storage.whole_files import PART

ROW = 'row.json'  # in each run's folder
TABLE, PAGE = 'batch.csv', 'batch.html'
LOCK = '.lock'  # in each folder that a batch has written
#: names of unfinished folders before PART: the run's, the call's and the number of the try
BEGUN = '*.' + 8 * '[0-9a-f]' + '-[0-9]*'


def is_left(path: Path, output: Path) -> bool:
    """Return whether a path is what a batch has left in a resolved folder, or lies in that."""
    path = path.resolve()
    if output not in path.parents:
        return False
    first = output / path.relative_to(output).parts[0]
    return (first.name in (TABLE, PAGE, LOCK) or first.match(BEGUN + PART)
            or (first / ROW).exists())


def check(output: Path, names: Iterable[str], read: Iterable[str]):
    """Refuse a folder where results would take the place of files that are read, or of others'.

    Parameters
    ----------
    names : iterable of str
        Of the runs' folders.
    read : iterable of str
        Inputs and the files beside them; what does not exist, as a topic, is left out.

    Raises
    ------
    UsageError
        Where a run's folder would be, hold or lie in one of them.
    """
    files = {Path(file).resolve() for file in set(read) if os.path.exists(file)}
    above = {folder: file for file in files for folder in (file, *file.parents)}
    for name in names:
        place = (output / name).resolve()
        around = files.intersection(place.parents)
        if place in above or around:
            file = above.get(place) or around.pop()
            raise UsageError(f'results in {place} would replace {file}, which is read, or lie in '
                             'it; choose another folder with -o')
    for path in (output / TABLE, output / PAGE):
        if path.exists() and not (output / LOCK).exists():
            raise UsageError(f'{path} is there and no batch wrote it; move it, or choose another '
                             'folder with -o')


def check_replaceable(place: Path):
    """Refuse to put a run's folder where something stands that is no run's.

    Raises
    ------
    UnusableOutput
    """
    is_ours = not place.exists() or place.is_dir() and (
        (place / ROW).exists() or not any(place.iterdir()))
    if not is_ours:
        raise UnusableOutput(f'{place} is there and no run of a batch ({ROW} is missing); move '
                             'it, or choose another folder with -o')
