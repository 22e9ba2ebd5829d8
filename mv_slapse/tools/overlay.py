"""A video of a run: coloured blocks, obstacles' boxes with id, speed and time to contact."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

from mv_slapse import drawing
from mv_slapse.codec.encoding.encoder import Encoding, write_video
from mv_slapse.codec.encoding.recoder import PictureDecoder
from mv_slapse.config import EncoderSettings
from mv_slapse.errors import UsageError
from mv_slapse.evaluation import detection
from mv_slapse.storage.whole_files import part_of, put_in_place
from mv_slapse.tools.eval import read_results, Results
from mv_slapse.tools.inputs import open_input, through
import numpy as np

CODED = Encoding('h264', 0, 30, {'crf': '23', 'preset': 'veryfast'})


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
    UsageError
        Where the input is a stream, which cannot be read twice.
    UnusableInput
        Where it, or the results, cannot be read.
    """
    if '://' in name or Path(name).is_fifo() or Path(name).is_char_device():
        raise UsageError(f'--overlay reads the input twice, which {name} does not allow; record '
                         'it first')
    path, found = Path(path), read_results(results)
    part = part_of(path).with_suffix('.part' + path.suffix)
    count = [0]
    with open_input(name, topic, encoder) as source:
        fps = found.summary.get('fps') or 25.0
        write_video(part, _drawn(source.packets, found, count), fps, CODED)
    part.replace(part_of(path))
    put_in_place(path)
    return count[0]


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
