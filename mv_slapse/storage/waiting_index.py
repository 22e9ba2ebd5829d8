"""The index of an MCAP file, which waits on the disk until the file is complete."""

from collections.abc import Iterator
from io import BytesIO
import os
from pathlib import Path
import struct
from tempfile import TemporaryFile

LENGTH = struct.Struct('<I')  # before each entry


class WaitingIndex:
    """Entries of an index in the order in which they came, as rosbags' writer wants a list.

    rosbags keeps an entry for each MB that it writes; a run may last for days.
    """

    def __init__(self, folder: Path):
        """Hold nothing yet; a file without a name is made in the folder."""
        self._file, self._n = TemporaryFile(dir=folder), 0  # noqa: SIM115 (as long as this)

    def append(self, entry: BytesIO):
        """Keep an entry; raises OSError where the disk is full."""
        data = entry.getvalue()
        self._file.write(LENGTH.pack(len(data)) + data)
        self._n += 1

    def __len__(self) -> int:
        """Return the number of entries."""
        return self._n

    def __iter__(self) -> Iterator[BytesIO]:
        """Return the entries, each ready to be copied from its beginning or as a whole."""
        self._file.seek(0)  # what is buffered is written before
        for _ in range(self._n):
            length, = LENGTH.unpack(self._file.read(LENGTH.size))
            entry = BytesIO()
            entry.write(self._file.read(length))
            yield entry
        self._file.seek(0, os.SEEK_END)

    def close(self):
        """Give them up."""
        self._file.close()
