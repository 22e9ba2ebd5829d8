"""Bags that ``ros2 bag play`` and Foxglove read: rosbag2 MCAP, CDR, definitions included."""

from pathlib import Path
import shutil

from mv_slapse.errors import UsageError
from mv_slapse.fields import Fields
from mv_slapse.storage import messages
from mv_slapse.storage.waiting_index import WaitingIndex
from mv_slapse.storage.whole_files import unusable
from rosbags.interfaces import (
    Qos,
    QosDurability,
    QosHistory,
    QosLiveliness,
    QosReliability,
    QosTime,
)
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer

WHAT_IS_LEFT = ('free the disk and run again; what was written until then can be read with '
                'mv_slapse run')
METADATA = 'metadata.yaml'  # of a rosbag2 directory
FOREVER = QosTime(9223372036, 854775807)


class BagWriter:
    """A rosbag2 directory; a context manager. Closing it makes it whole, whatever happened."""

    def __init__(self, path: str | Path, compressed: bool = False):
        """Make the directory.

        Raises
        ------
        UsageError
            Where the directory exists or cannot be made.
        """
        self.path = Path(path)
        if self.path.exists():
            raise UsageError(f'{path} exists already; delete it or choose another name')
        self._writer = Writer(self.path, version=9, storage_plugin=StoragePlugin.MCAP)
        if compressed:
            self._writer.set_compression(CompressionMode.STORAGE, CompressionFormat.ZSTD)
        try:
            self._writer.open()
            self._index = WaitingIndex(self.path)
            self._writer.storage.chunks = self._index
        except OSError as error:
            raise UsageError(f'{path} cannot be written: {error.strerror}; choose another place'
                             ) from None
        self._connections: dict = {}
        self._newest = -1

    def __enter__(self) -> 'BagWriter':
        """Return itself."""
        return self

    def __exit__(self, *_):
        """Close the bag."""
        self.close()

    def write(self, topic: str, name: str, values: Fields, stamp: int, latched: bool = False):
        """Write a message of the type ``name``.

        The time of the log is ``stamp`` [ns], or just after the message before where that is
        later: players sort by it and must keep the order of writing.
        """
        if topic not in self._connections:
            self._connections[topic] = self._writer.add_connection(
                topic, name, typestore=messages.typestore(), offered_qos_profiles=[_qos(latched)])
        self._newest = max(self._newest + 1, stamp)
        data = messages.serialize(name, values)
        try:
            self._writer.write(self._connections[topic], self._newest, data)
        except OSError as error:
            raise unusable(self.path, error, WHAT_IS_LEFT) from error

    def close(self):
        """Write the index and the metadata.

        Raises
        ------
        UnusableOutput
            Where there is no place for them.
        """
        try:
            self._writer.close()
        except OSError as error:
            raise unusable(self.path, error, WHAT_IS_LEFT) from error
        finally:
            self._index.close()


class McapFile(BagWriter):
    """A single MCAP file, replaced only when it is whole.

    Until then it grows in a folder beside, from which what a crash left can be read.
    """

    def __init__(self, path: str | Path):
        """Make the folder; one that a crash left behind gives way."""
        self._file = Path(path)
        folder = self._file.with_suffix('')
        # A run may be killed before the file is there, or when it has left for its place.
        own = {self._file.name, METADATA}
        if folder.is_dir() and all(path.name in own for path in folder.iterdir()):
            shutil.rmtree(folder)
        super().__init__(folder, compressed=True)

    def close(self):
        """Finish the file and put it in its place."""
        super().close()
        try:
            (self.path / self._file.name).replace(self._file)
            shutil.rmtree(self.path)
        except OSError as error:
            raise unusable(self._file, error) from error


def _qos(latched: bool) -> Qos:
    durability = QosDurability.TRANSIENT_LOCAL if latched else QosDurability.VOLATILE
    return Qos(QosHistory.KEEP_LAST, 1 if latched else 100, QosReliability.RELIABLE, durability,
               FOREVER, FOREVER, QosLiveliness.AUTOMATIC, FOREVER, False)
