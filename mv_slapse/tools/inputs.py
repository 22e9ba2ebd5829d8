"""A video, whatever holds it: file, stream, folder of pictures or bag."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import chain, islice
from pathlib import Path
from typing import Any

from mv_slapse.codec.encoding.recoder import PictureDecoder, Recoder
from mv_slapse.codec.packet import Packet, Picture
from mv_slapse.codec.source import open_source
from mv_slapse.config import EncoderSettings
from mv_slapse.errors import UnusableInput, UsageError
from mv_slapse.geometry.camera import Camera
from mv_slapse.records import Speed
from mv_slapse.storage import picture_folder, tables
from mv_slapse.storage.bag_reader import BagReader, is_bag
import numpy as np

RECODED = ('this codec has no motion vectors that can be read, so that each picture is decoded '
           'and encoded again here; a camera that sends H.264 spares that')


@dataclass(frozen=True)
class VideoInput:
    """An open video.

    Attributes
    ----------
    packets : iterator of Packet
        In the order of decoding.
    size : (int, int) or None
        Width and height [px] as they are encoded here, else as the container tells them.
    n_frames : int
        As the container tells it; 0 where it does not.
    find_camera : function
        Looks for the calibration that comes with the video; called where it is asked for only.
    warning : str
        What is wrong with the input although it can be used, else empty.
    skipped : function
        Tells what has been left out so far, a text for each topic.
    fps : float
        As the container tells it [1/s]; 0 where it does not.
    recoder : Recoder
        What the packets have passed through.
    """

    packets: Iterator[Packet]
    size: tuple[int, int] | None = None
    n_frames: int = 0
    find_camera: Callable[[], Camera | None] = lambda: None
    warning: str = ''
    skipped: Callable[[], list[str]] = list
    fps: float = 0.0
    recoder: Recoder = field(default_factory=Recoder)

    @property
    def camera(self) -> Camera | None:
        """The calibration that comes with the video; UnusableInput where it is none."""
        return self.find_camera()

    @property
    def warnings(self) -> list[str]:
        """What is to be said of the input, as far as it has been read."""
        said = [self.warning, *self.skipped()] if self.warning else self.skipped()
        codec = self.recoder.recoded
        return said + [f'{codec}: {RECODED}'] if codec else said


@contextmanager
def open_input(name: str, topic: str | None = None,
               encoder: EncoderSettings | None = None) -> Iterator[VideoInput]:
    """Open a video file, a URL, a folder of pictures, or the video topic of a bag.

    What has no motion vectors is encoded in memory, as the settings of the encoder say.

    Raises
    ------
    UnusableInput, UsageError
        Where there is no such input, or no video in it.
    """
    recoder = Recoder(encoder)
    if is_from_bag(name, topic):
        yield _open_bag(name, topic, recoder)
        return
    if picture_folder.is_folder(name):
        found = picture_folder.entries(name, encoder.rate if encoder else 0.0)
        yield _begun(picture_folder.pictures(found), recoder, n_frames=len(found),
                     warning=picture_folder.warning(found))
        return
    with open_source(name) as source:
        yield _begun(source.packets(), recoder, size=(source.width, source.height),
                     n_frames=source.n_frames, fps=source.fps)


def pictures(path: str | Path) -> Iterator[np.ndarray]:
    """Yield the pictures of a video file, (height, width) uint8 grey, in order of presentation.

    Raises UnusableInput where it cannot be read.
    """
    with open_source(path) as source:
        for frame, _ in through(PictureDecoder(), source.packets()):
            yield frame.to_ndarray(format='gray')


def is_from_bag(name: str, topic: str | None = None) -> bool:
    """Return whether an input is a bag; UsageError where a topic is named in something else."""
    found = '://' not in name and is_bag(name)
    if topic is not None and not found:
        raise UsageError(f'--topic {topic} names a topic, but {name} is not a bag')
    return found


def read_speeds(given: str, name: str) -> tuple[list[Speed], list[str]]:
    """Return the speeds of a table (CSV), or of an odometry topic of the bag ``name``.

    The second are texts of what was left out.

    Raises
    ------
    UnusableInput, UsageError
        Where there is neither, or no speed in it.
    """
    skipped: list[str] = []
    if Path(given).is_file():
        speeds = tables.read_speeds(given)
    elif is_from_bag(name):
        bag = BagReader(name)
        speeds, skipped = bag.speeds(given), bag.skipped
    else:
        raise UsageError(f'--speed {given}: no such file; give a table with the columns '
                         f'{tables.SPEEDS_HEADER}, or, where the input is a bag, a topic of it')
    if not speeds:
        raise UnusableInput(f'--speed {given} holds no speed; leave the option out, or give one '
                            'that does')
    return speeds, skipped


def through(stage: Recoder | PictureDecoder, items: Iterator[Packet | Picture]) -> Iterator:
    """Yield what a stage makes of items: packets with vectors, or pictures with their stamps."""
    for item in items:
        yield from stage.feed(item)
    yield from stage.flush()


def _open_bag(name: str, topic: str | None, recoder: Recoder) -> VideoInput:
    bag = BagReader(name)
    video = bag.video_topic(topic)
    warning = f'{name} has no end; what is whole before the cut is used' if bag.is_cut else ''
    return _begun(bag.packets(video), recoder, n_frames=bag.counts.get(video, 0),
                  find_camera=partial(bag.camera, video), warning=warning,
                  skipped=lambda: bag.skipped)


def _begun(items: Iterator[Packet | Picture], recoder: Recoder, **told: Any) -> VideoInput:
    """Return the input of which the first packet is read: it shows the size that is encoded."""
    packets = through(recoder, items)
    first = list(islice(packets, 1))
    video = VideoInput(chain(first, packets), recoder=recoder, **told)
    return replace(video, size=recoder.size or video.size)
