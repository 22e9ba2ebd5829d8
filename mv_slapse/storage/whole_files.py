"""Files that are either the old ones or whole: written beside their place, then renamed."""

from collections.abc import Iterator
from contextlib import contextmanager, suppress
import fcntl
import os
from pathlib import Path
from typing import IO

from mv_slapse.errors import UnusableOutput

PART = '.part'


def part_of(path: Path) -> Path:
    """Return where a file grows until it is whole."""
    return path.with_name(path.name + PART)


def put_in_place(path: Path):
    """Give the grown file its name, once it is on the disk."""
    with part_of(path).open('rb') as file:
        os.fsync(file.fileno())
    part_of(path).replace(path)


@contextmanager
def whole(path: str | Path, mode: str = 'w') -> Iterator[IO]:
    """Open a file to write; it takes its place at the end, and goes where that is not reached.

    Text is UTF-8; what is none, as a file's name may be, is written as its escape.

    Raises
    ------
    UnusableOutput
        Where it cannot be written; an earlier file stays as it was.
    """
    path = Path(path)
    text = {} if 'b' in mode else {'encoding': 'utf-8', 'errors': 'backslashreplace'}
    try:
        with part_of(path).open(mode, **text) as file:
            yield file
        put_in_place(path)
    except OSError as error:
        raise unusable(path, error) from error
    finally:
        _remove(part_of(path))


def write_text(path: str | Path, text: str):
    """Write a text file; see ``whole``."""
    with whole(path) as file:
        file.write(text)


def locked(path: Path) -> IO | None:
    """Return a file that is locked until it is closed, or its process ends however it does.

    None where another has locked it. A disk without locks, as some networks have, keeps nobody
    out. Raises OSError where it cannot be opened.
    """
    file = path.open('w')
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except (BlockingIOError, PermissionError):
        file.close()
        return None
    except OSError:
        return file
    if os.fstat(file.fileno()).st_nlink:
        return file
    file.close()  # who had it removed it meanwhile
    return locked(path)


def unusable(path: str | Path, error: OSError, more: str = '') -> UnusableOutput:
    """Return the error of a file that cannot be written: which, why, and what to do."""
    return UnusableOutput(f'{path} cannot be written: {error.strerror or error}; '
                          f'{more or "free the disk or choose another place"}')


def _remove(path: Path):
    with suppress(OSError):  # a folder that has gone read-only keeps it
        path.unlink(missing_ok=True)
