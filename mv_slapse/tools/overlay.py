"""A video of a run: coloured blocks, obstacles' boxes with id, speed and time to contact."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import cv2
from mv_slapse.codec.encoding.encoder import Encoding, write_video
from mv_slapse.codec.encoding.recoder import PictureDecoder
from mv_slapse.config import EncoderSettings
from mv_slapse.errors import UsageError
from mv_slapse.evaluation import detection
from mv_slapse.geometry.blocks import MACROBLOCK
from mv_slapse.records import Label
from mv_slapse.storage.whole_files import part_of, put_in_place
from mv_slapse.tools.eval import read_results, Results
from mv_slapse.tools.inputs import open_input
import numpy as np

CODED = Encoding('h264', 0, 30, {'crf': '23', 'preset': 'veryfast'})
RED, WHITE = (0, 80, 230), (255, 255, 255)  # BGR
FAR = (200, 160, 60)
# Planes next to one another in number are told apart.
PLANES = ((115, 158, 0), (178, 114, 0), (66, 228, 240), (167, 121, 204), (230, 200, 120))
STRENGTH = 0.4


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
    decoder, stamps = PictureDecoder(), results.labels.stamps
    boxes = detection.confirmed(results.obstacles)
    unit = 'm/s' if results.is_metric else 'u/s'
    for packet in (*packets, None):
        frames = decoder.flush() if packet is None else decoder.feed(packet)
        for frame, stamp in frames:
            row = int(np.searchsorted(stamps, stamp))
            if row == len(stamps):
                return
            count[0] += 1
            yield draw(frame.to_ndarray(format='bgr24'), results, row, detection.select(
                boxes, boxes['stamp'] == stamps[row]), unit)


def draw(image: np.ndarray, results: Results, row: int, obstacles: detection.Table,
         unit: str = 'm/s') -> np.ndarray:
    """Return a picture (H, W, 3) uint8 with the labels of a key frame and some obstacles."""
    labels, height, width = results.labels, *image.shape[:2]
    colour = np.zeros((len(labels.x), 3), np.float32)
    plane, label = labels.plane[row], labels.label[row]
    of_plane = (label == Label.STATIONARY) & (plane >= 0)
    colour[of_plane] = np.array(PLANES, np.float32)[plane[of_plane] % len(PLANES)]
    colour[label == Label.INFINITY] = FAR
    colour[label == Label.MOVING] = RED
    paint = np.zeros((height, width, 3), np.float32)
    half = MACROBLOCK // 2
    for (x, y), value in zip(np.c_[labels.x, labels.y].round().astype(int), colour, strict=True):
        if value.any():
            paint[max(y - half, 0):y + half, max(x - half, 0):x + half] = value
    shown = paint.any(axis=2, keepdims=True) * STRENGTH
    drawn = np.ascontiguousarray((image * (1 - shown) + paint * shown).astype(np.uint8))
    for i in range(len(obstacles['id'])):
        _draw_box(drawn, {name: column[i] for name, column in obstacles.items()}, unit)
    return drawn


def _draw_box(image: np.ndarray, obstacle: dict[str, Any], unit: str):
    x, y, w, h = (round(float(obstacle[name])) for name in ('x', 'y', 'width', 'height'))
    speed = np.linalg.norm([obstacle[name] for name in ('vx', 'vy', 'vz')])
    text = f'{obstacle["id"]:.0f}: {speed:.1f} {unit}'
    if np.isfinite(obstacle['ttc']):
        text += f', {obstacle["ttc"]:.1f} s'
    cv2.rectangle(image, (x, y), (x + w, y + h), RED, 2)
    place = (max(x, 0), max(y - 5, 12))
    cv2.putText(image, text, place, cv2.FONT_HERSHEY_SIMPLEX, 0.5, (0, 0, 0), 3, cv2.LINE_AA)
    cv2.putText(image, text, place, cv2.FONT_HERSHEY_SIMPLEX, 0.5, WHITE, 1, cv2.LINE_AA)
