"""A video of a run: coloured blocks, obstacles' boxes with id, speed and time to contact."""

from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from mv_slapse import drawing
from mv_slapse.codec.encoding.encoder import Encoding, write_video
from mv_slapse.codec.encoding.recoder import PictureDecoder
from mv_slapse.config import EncoderSettings
from mv_slapse.errors import UnusableOutput, UsageError
from mv_slapse.evaluation import detection
from mv_slapse.storage.whole_files import PART, part_of, put_in_place, unusable
from mv_slapse.tools.eval import read_results, Results
from mv_slapse.tools.inputs import open_input, through
import numpy as np

CODED = Encoding('h264', 0, 30, {'crf': '23', 'preset': 'veryfast'})


def check(path: str | Path, name: str):
    """Refuse before a run what ``write`` could not do after it; the folder of the video is made.

    Raises
    ------
    UsageError
        Where the input is a stream, which cannot be read twice, or the video itself; where no
        video can be written under this name, which one of two pictures shows.
    """
    if '://' in name or Path(name).is_fifo() or Path(name).is_char_device():
        raise UsageError(f'--overlay reads the input twice, which {name} does not allow; record '
                         'it first')
    path = Path(path)
    try:
        if path.is_dir() or path.resolve() == Path(name).resolve():
            raise UsageError(f'--overlay {path} is a directory or the input itself; name another '
                             'video to write, such as overlay.mp4')
        path.parent.mkdir(parents=True, exist_ok=True)
        with _growing(path) as part:
            write_video(part, [np.zeros((16, 16), np.uint8)] * 2, 25.0, CODED)
    except (OSError, UnusableOutput) as error:
        reason = error.__cause__ or error
        raise UsageError(f'--overlay {path} cannot be written: {reason}; name a video such as '
                         'overlay.mp4, in a folder that may be written') from None


def write(path: str | Path, name: str, results: str | Path, topic: str | None = None,
          encoder: EncoderSettings | None = None) -> int:
    """Draw what a run found into its input's pictures; return how many pictures there are.

    Parameters
    ----------
    path : str or Path
        Video to write; its suffix chooses the container.
    name, topic, encoder
        The input of the run, which is read a second time.
    results : str or Path
        Folder of the run.

    Raises
    ------
    UnusableInput
        Where the input, or the results, cannot be read.
    UnusableOutput
        Where the video cannot be written.
    """
    path, found = Path(path), read_results(results)
    count = [0]
    with _growing(path) as part:
        with open_input(name, topic, encoder) as source:
            fps = found.summary.get('fps') or 25.0
            write_video(part, _drawn(source.packets, found, count), fps, CODED)
        try:
            part.replace(part_of(path))
            put_in_place(path)
        except OSError as error:
            raise unusable(path, error) from error
    return count[0]


@contextmanager
def _growing(path: Path) -> Iterator[Path]:
    """Give where a video grows, with a suffix that FFmpeg knows; what is left there goes."""
    part = part_of(path).with_suffix(PART + path.suffix)
    try:
        yield part
    finally:
        with suppress(OSError):
            part.unlink(missing_ok=True)


def _drawn(packets: Any, results: Results, count: list[int]) -> Iterator[np.ndarray]:
    """Yield the pictures up to the last key frame, each with the labels of the next one."""
    labels, stamps = results.labels, results.labels.stamps
    centres = np.c_[labels.x, labels.y]
    boxes = detection.confirmed(results.obstacles)
    unit = 'm/s' if results.is_metric else 'u/s'
    for frame, stamp in through(PictureDecoder(), packets):
        row = int(np.searchsorted(stamps, stamp))
        if row == len(stamps):
            return
        count[0] += 1
        yield drawing.draw(frame.to_ndarray(format='bgr24'), centres, labels.label[row],
                           labels.plane[row], _boxes(detection.select(
                               boxes, boxes['stamp'] == stamps[row])), unit)


def _boxes(table: detection.Table) -> list[drawing.Box]:
    """Return what is drawn of the rows of a table."""
    speeds = np.linalg.norm([table[name] for name in ('vx', 'vy', 'vz')], axis=0)
    boxes = zip(*(table[name] for name in ('x', 'y', 'width', 'height')), strict=True)
    return [drawing.Box(int(id_), box, float(speed), float(ttc)) for id_, box, speed, ttc in zip(
        table['id'], boxes, speeds, table['ttc'], strict=True)]
