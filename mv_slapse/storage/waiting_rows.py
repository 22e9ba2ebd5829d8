"""Rows of text that wait on the disk until somebody asks for them."""

from collections.abc import Iterator
from contextlib import suppress
import os
from tempfile import TemporaryFile


class WaitingRows:
    """Rows of text, in a file without a name, for a run or a node may last for days.

    A disk that is full ends the rows, and not who adds them: what could not wait is told when they
    are asked for.

    Attributes
    ----------
    n : int
        How many were added.
    """

    def __init__(self):
        """Hold nothing yet."""
        self.n = 0
        self._file, self._error = None, None
        try:
            self._file = TemporaryFile('w+')  # noqa: SIM115 (as long as this)
        except OSError as error:
            self._error = error

    def add(self, row: str):
        """Keep a row, up to the first that cannot be kept."""
        self.n += 1
        if self._error is None:
            try:
                self._file.write(row + '\n')
            except OSError as error:
                self._error = error

    def __iter__(self) -> Iterator[str]:
        """Return the rows, each with its line's end.

        Raises
        ------
        OSError
            Where one could not be kept.
        """
        if self._error is not None:
            raise self._error
        self._file.seek(0)  # what is buffered is written before
        try:
            # `yield from` would close the file with whoever gives up half-way.
            for row in self._file:  # noqa: UP028
                yield row
        finally:
            self._file.seek(0, os.SEEK_END)

    def close(self):
        """Give them up; what a full disk does not take any more is not wanted either."""
        if self._file is not None:
            with suppress(OSError):
                self._file.close()
