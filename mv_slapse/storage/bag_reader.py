"""Video and calibration out of bags: rosbag2 folders, bare .mcap and .db3 files, cut ones too."""

from collections.abc import Callable, Collection, Iterator
from dataclasses import dataclass
from functools import partial
import os
from pathlib import Path, PurePosixPath
from typing import Any, NamedTuple, TypeVar

from mcap.records import Channel, Chunk, McapRecord, Message, Schema
from mcap.stream_reader import breakup_chunk, StreamReader
from mv_slapse import fields, video_messages
from mv_slapse.codec.packet import Packet, Picture
from mv_slapse.errors import MvSlapseError, UnusableInput, UsageError
from mv_slapse.geometry.camera import Camera
from mv_slapse.records import Speed
from mv_slapse.storage import bounded, messages
from rosbags.interfaces import Connection
from rosbags.rosbag2 import Reader

CAMERA_INFO = 'sensor_msgs/msg/CameraInfo'
ODOMETRY = 'nav_msgs/msg/Odometry'
SQLITE = '.db3'
SUFFIXES = ('.mcap', SQLITE, '.bag')
MAGIC = b'\x89MCAP0\r\n'

Made = TypeVar('Made')


class Raw(NamedTuple):
    """A serialised message of a bag; ``stamp`` is the log's [ns]."""

    topic: str
    type: str
    stamp: int
    data: bytes


@dataclass
class _Skipped:
    """How many messages of a topic cannot be used, and why the first cannot."""

    count: int = 0
    reason: str = ''

    def add(self, error: UnusableInput):
        """Count one more."""
        self.count, self.reason = self.count + 1, self.reason or str(error)


def is_bag(path: str | Path) -> bool:
    """Return whether a path is a bag rather than a video."""
    path = Path(path)
    if os.path.isdir(path):  # Path.is_dir raises where a name is too long
        return (path / 'metadata.yaml').exists() or bool(_files(path))
    return path.suffix in SUFFIXES


class BagReader:
    """Messages of a bag.

    Attributes
    ----------
    topics : dict
        Topic to message type.
    counts : dict
        Topic to number of messages; empty where the bag is cut.
    is_cut : bool
        Whether the end of the bag is missing; what is whole before the cut is read.
    """

    def __init__(self, path: str | Path):
        """Read which topics there are.

        Raises
        ------
        UnusableInput
            Where there is no bag, or nothing of it can be read.
        """
        self._path = Path(path)
        if not self._path.exists():
            raise UnusableInput(f'{path}: no such bag; check the path')
        if self._path.suffix == '.bag' and self._path.is_file():
            raise UnusableInput(f'{path} is a ROS 1 bag; convert it with: rosbags-convert '
                                f'--src {path} --dst {self._path.stem}')
        self.is_cut = False
        self._skipped: dict[str, _Skipped] = {}
        self.counts: dict[str, int] = {}
        try:
            connections = _connections(self._path)
            self.topics = {c.topic: c.msgtype for c in connections}
            self.counts = {c.topic: c.msgcount for c in connections}
        except UnusableInput as error:
            raise UnusableInput(f'{path} cannot be read as a bag: {error}') from None
        except Exception as error:  # rosbags raises whatever a damaged byte leads it to
            self.is_cut = True
            self.topics = {raw.topic: raw.type for raw in _salvage(self._path)}
            if not self.topics:
                raise UnusableInput(f'{path} cannot be read as a bag: {_text(error)}; is it a '
                                    'rosbag2 folder or an .mcap file with messages in it?'
                                    ) from None

    def messages(self, topics: Collection[str]) -> Iterator[tuple[Raw, Any]]:
        """Yield the messages of some topics with their serialised form, in the log's order."""
        for raw in self._raw(topics):
            yield raw, self._message(raw)

    @property
    def skipped(self) -> list[str]:
        """What is to be said of messages that were left out, a text for each topic read so far."""
        return [f'topic {topic}: {skipped.count} of its messages cannot be used and are left out; '
                f'of the first: {skipped.reason}' for topic, skipped in self._skipped.items()]

    def _raw(self, topics: Collection[str]) -> Iterator[Raw]:
        read = _salvage if self.is_cut else _whole
        for raw in self._guarded(read(self._path, topics)):
            if raw.topic in topics:
                yield raw

    def _usable(self, topic: str, make: Callable[[Any], Made]) -> Iterator[Made]:
        """Yield what is made of the messages of a topic; those that cannot be used are counted.

        Raises UnusableInput where that is all of them.
        """
        skipped, found = _Skipped(), False
        for raw in self._raw([topic]):
            try:
                made = make(self._message(raw))
            except UnusableInput as error:
                skipped.add(error)
                self._skipped[topic] = skipped
                continue
            found = True
            yield made
        if skipped.count and not found:
            raise UnusableInput(f'{self._path}: none of the {skipped.count} messages of topic '
                                f'{topic} can be used; of the first: {skipped.reason}')

    def _message(self, raw: Raw) -> Any:
        if raw.type not in messages.typestore().fielddefs:
            raise UnusableInput(f'{self._path}: topic {raw.topic} has type {raw.type}, '
                                'which is not known here')
        try:
            return messages.typestore().deserialize_cdr(raw.data, raw.type)
        except Exception as error:  # rosbags raises whatever a damaged byte leads it to
            raise UnusableInput(f'{self._path}: a message of topic {raw.topic} is damaged: '
                                f'{_text(error)}') from error

    def _guarded(self, items: Iterator[Raw]) -> Iterator[Raw]:
        """Yield items; what a damaged bag leads its reader to is one kind of error."""
        try:
            yield from items
        except MvSlapseError as error:
            raise UnusableInput(f'{self._path}: {error}') from None
        except Exception as error:
            raise UnusableInput(f'{self._path} is damaged: {_text(error)}; what comes before has '
                                'been read') from error

    def video_topic(self, topic: str | None = None) -> str:
        """Return the topic with the video, by name or because there is just one.

        Raises
        ------
        UnusableInput, UsageError
            Where there is none; where there are several and none is named. Both list them.
        """
        videos = [name for name, kind in self.topics.items() if self._is_video(name, kind)]
        if topic is not None:
            return self._named(topic, videos)
        if not videos:
            listed = ', '.join(f'{name} ({kind})' for name, kind in sorted(self.topics.items()))
            raise UnusableInput(f'{self._path} has no video topic; it has {listed or "none"}. '
                                f'Video types are {", ".join(video_messages.VIDEO_TYPES)}')
        if len(videos) > 1:
            raise UsageError(f'{self._path} has several video topics; choose one with --topic: '
                             f'{", ".join(sorted(videos))}')
        return videos[0]

    def packets(self, topic: str) -> Iterator[Packet | Picture]:
        """Yield the coded packets, or the pictures, of a video topic.

        Messages that cannot be used are left out, see ``skipped``. Raises UnusableInput where
        those are all, or the bag is damaged.
        """
        yield from self._usable(topic, partial(video_messages.from_message, self.topics[topic]))

    def camera(self, video_topic: str) -> Camera | None:
        """Return the camera of the ``camera_info`` beside a video topic; None in a bag without.

        It is that of the first message that holds one.

        Raises
        ------
        UnusableInput
            Where no message does; where the bag has such topics elsewhere only, as they may be
            those of other cameras.
        """
        infos = sorted(name for name, kind in self.topics.items() if kind == CAMERA_INFO)
        if not infos:
            return None
        beside = next((name for name in self._beside(video_topic) if name in infos), None)
        if beside is None:
            raise UnusableInput(f'{self._path} has no camera_info beside {video_topic}; it has '
                                f'{", ".join(infos)}, which may be of another camera; give the '
                                'calibration of this one with --camera camera.yaml (a '
                                'camera_info file)')
        return next(self._usable(beside, fields.camera_from_message), None)

    def _beside(self, video_topic: str) -> Iterator[str]:
        """Yield the names that ``camera_info`` may have beside a video topic, likeliest first."""
        base = PurePosixPath(video_topic)
        yield str(base.with_name('camera_info'))
        if self.topics[video_topic] != video_messages.IMAGE:  # base/transport is beside the base
            yield str(base.parent.parent / 'camera_info')

    def speeds(self, topic: str) -> list[Speed]:
        """Return the speeds of a topic with the odometry of wheels.

        Messages that cannot be used are left out, see ``skipped``.

        Raises
        ------
        UsageError
            Where there is no such topic, or one of another type; lists those there are.
        UnusableInput
            Where no message can be used, or the bag is damaged.
        """
        name = topic if topic.startswith('/') else '/' + topic
        if self.topics.get(name) != ODOMETRY:
            found = sorted(name for name, kind in self.topics.items() if kind == ODOMETRY)
            raise UsageError(f'{self._path} has no topic {name} of type {ODOMETRY}; topics of '
                             f'that type here: {", ".join(found) or "none"}')
        return list(self._usable(name, fields.speed_from_message))

    def _is_video(self, name: str, kind: str) -> bool:
        return kind in video_messages.VIDEO_TYPES

    def _named(self, topic: str, videos: list[str]) -> str:
        name = topic if topic.startswith('/') else '/' + topic
        if name not in self.topics:
            raise UsageError(f'{self._path} has no topic {name}; it has '
                             f'{", ".join(sorted(self.topics)) or "none"}')
        if name not in videos:
            raise UsageError(f'topic {name} has type {self.topics[name]}, which is no video; '
                             f'video topics here: {", ".join(sorted(videos)) or "none"}')
        return name


def _text(error: Exception) -> str:
    """Return an error of another library in one line, with its kind: some say nothing else."""
    return ' '.join(f'{type(error).__name__} {error}'.split())[:300]


def _connections(path: Path) -> list[Connection]:
    bounded.check_metadata(path)
    with Reader(path) as reader:
        return list(reader.connections)


def _whole(path: Path, topics: Collection[str] | None) -> Iterator[Raw]:
    with Reader(path) as reader:
        connections = [c for c in reader.connections if topics is None or c.topic in topics]
        for connection, stamp, data in reader.messages(connections) if connections else ():
            yield Raw(connection.topic, connection.msgtype, stamp, bytes(data))


def _salvage(path: Path, topics: Collection[str] | None = None) -> Iterator[Raw]:
    """Yield the whole messages of the files of a bag, without need of index, end or metadata."""
    for file in _files(path) if path.is_dir() else [path]:
        if file.suffix == SQLITE:
            yield from _whole_rows(file, topics)
            continue
        with file.open('rb') as stream:
            if stream.read(len(MAGIC)) != MAGIC:
                continue
            stream.seek(0)
            yield from _whole_records(StreamReader(
                stream, emit_chunks=True, record_size_limit=bounded.LARGEST))


def _whole_rows(file: Path, topics: Collection[str] | None) -> Iterator[Raw]:
    """Yield the messages of an SQLite file up to where it is damaged."""
    try:
        yield from _whole(file, topics)
    except UnusableInput:
        raise
    except Exception:  # rosbags raises whatever a damaged byte leads it to
        return


def _whole_records(reader: StreamReader) -> Iterator[Raw]:
    schemas: dict[int, str] = {}
    channels: dict[int, Channel] = {}
    for record in _records(reader):
        if isinstance(record, Schema):
            schemas[record.id] = record.name
        elif isinstance(record, Channel):
            channels[record.id] = record
        elif isinstance(record, Message) and record.channel_id in channels:
            channel = channels[record.channel_id]
            yield Raw(channel.topic, schemas.get(channel.schema_id, ''), record.log_time,
                      bytes(record.data))


def _records(reader: StreamReader) -> Iterator[McapRecord]:
    """Yield records up to the cut, or damage: what follows it cannot be trusted."""
    records = reader.records
    while True:
        try:
            record = next(records)
            inner = (breakup_chunk(bounded.uncompressed(record)) if isinstance(record, Chunk)
                     else [record])
        except UnusableInput:
            raise
        except Exception:  # StopIteration at the end, and all that damage leads mcap to
            return
        yield from inner


def _files(folder: Path) -> list[Path]:
    return sorted(path for path in folder.iterdir() if path.suffix in ('.mcap', SQLITE))
