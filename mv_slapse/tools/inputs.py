"""A video, whatever holds it: file, stream or bag."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from mv_slapse.codec.encoder import ImageEncoder
from mv_slapse.codec.packet import Packet
from mv_slapse.codec.source import open_source
from mv_slapse.errors import UnusableInput, UsageError
from mv_slapse.geometry.camera import Camera
from mv_slapse.records import Speed
from mv_slapse.storage import tables
from mv_slapse.storage.bag_reader import BagReader, is_bag
from mv_slapse.video_messages import Picture


@dataclass(frozen=True)
class VideoInput:
    """An open video.

    Attributes
    ----------
    packets : iterator of Packet
        In the order of decoding.
    size : (int, int) or None
        Width and height [px] where the container tells them.
    n_frames : int
        As the container tells it; 0 where it does not.
    camera : Camera or None
        The calibration that comes with the video.
    warning : str
        What is wrong with the input although it can be used, else empty.
    """

    packets: Iterator[Packet]
    size: tuple[int, int] | None = None
    n_frames: int = 0
    camera: Camera | None = None
    warning: str = ''


@contextmanager
def open_input(name: str, topic: str | None = None) -> Iterator[VideoInput]:
    """Open a video file, a URL, or the video topic of a bag.

    Raises
    ------
    UnusableInput, UsageError
        Where there is no such input, or no video in it.
    """
    if is_from_bag(name, topic):
        yield _open_bag(name, topic)
        return
    with open_source(name) as source:
        yield VideoInput(source.packets(), (source.width, source.height), source.n_frames)


def is_from_bag(name: str, topic: str | None = None) -> bool:
    """Return whether an input is a bag; UsageError where a topic is named in something else."""
    found = '://' not in name and is_bag(name)
    if topic is not None and not found:
        raise UsageError(f'--topic {topic} names a topic, but {name} is not a bag')
    return found


def read_speeds(given: str, name: str) -> list[Speed]:
    """Return the speeds of a table (CSV), or of an odometry topic of the bag ``name``.

    Raises
    ------
    UnusableInput, UsageError
        Where there is neither, or no speed in it.
    """
    if Path(given).is_file():
        speeds = tables.read_speeds(given)
    elif is_from_bag(name):
        speeds = BagReader(name).speeds(given)
    else:
        raise UsageError(f'--speed {given}: no such file; give a table with the columns '
                         f'{tables.SPEEDS_HEADER}, or, where the input is a bag, a topic of it')
    if not speeds:
        raise UnusableInput(f'--speed {given} holds no speed; leave the option out, or give one '
                            'that does')
    return speeds


def coded(items: Iterator[Packet | Picture]) -> Iterator[Packet]:
    """Yield packets; pictures are coded in memory, so that their vectors can be read back."""
    encoder = ImageEncoder()
    for item in items:
        if isinstance(item, Picture):
            yield from encoder.feed(item.image, item.stamp)
        else:
            yield item
    yield from encoder.flush()


def _open_bag(name: str, topic: str | None) -> VideoInput:
    bag = BagReader(name)
    video = bag.video_topic(topic)
    warning = f'{name} has no end; what is whole before the cut is used' if bag.is_cut else ''
    return VideoInput(coded(bag.packets(video)), None, bag.counts.get(video, 0),
                      bag.camera(video), warning)
