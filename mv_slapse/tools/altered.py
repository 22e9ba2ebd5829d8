"""Clips with known movers, mirrored and cut: the same scenes in other vectors.

What was tried on a few clips may fit them by chance. Mirrored, or cut by a few pixels so that
macroblocks lie elsewhere, and coded anew, they show how far a figure carries.
"""

from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import NamedTuple

from mv_slapse.codec.encoding.encoder import Encoding
from mv_slapse.evaluation.truth import read_arrays
from mv_slapse.geometry.camera import Camera
from mv_slapse.storage.tables import read_table
from mv_slapse.tools.cases import encoded, named, ORIGINAL, Scene, sequence
from mv_slapse.tools.inputs import pictures
import numpy as np

LABELLED, BOXED = 10.0, 30.0  # [Hz] of the clips with labelled points, and with boxes
RATES = {LABELLED: '9000000', BOXED: '2000000'}  # [bit/s] at which the given ones are coded
BOX_HEADER = 'frame,x,y,width,height'


class Alteration(NamedTuple):
    """A picture mirrored first, then cut at its left and upper end [px]; its sides stay even."""

    mirrored: bool
    left: int
    top: int

    def image(self, given: np.ndarray) -> np.ndarray:
        """Return a picture as it is then."""
        turned = given[:, ::-1] if self.mirrored else given
        width, height = self._size(*given.shape[::-1])
        return np.ascontiguousarray(turned[self.top:, self.left:][:height, :width])

    def camera(self, given: Camera) -> Camera:
        """Return the camera that took it; only one without distortion can be mirrored."""
        K = given.K.copy()
        K[:2, 2] = self.x(K[None, :2, 2], given.width)[0]
        width, height = self._size(given.width, given.height)
        return replace(given, width=width, height=height, K=K)

    def x(self, given: np.ndarray, width: int) -> np.ndarray:
        """Return where pixels (..., 2) of a camera of some width are then."""
        # An encoder has left out an odd last column.
        across = width // 2 * 2 - 1 - given[..., 0] if self.mirrored else given[..., 0]
        return np.stack([across - self.left, given[..., 1] - self.top], axis=-1)

    def _size(self, width, height):
        return (width // 2 * 2 - self.left) // 2 * 2, (height // 2 * 2 - self.top) // 2 * 2


KINDS = {'mirrored': Alteration(True, 0, 0), 'cut': Alteration(False, 10, 9)}


def altered(data: Path) -> list[Scene]:
    """Return the clips with labelled points or boxes, altered, in two encodings of their rate."""
    found = []
    for folder in sorted({path.parent for path in data.rglob('camera.yaml')}):
        for case in sequence(data, folder):
            if case.video.name == ORIGINAL and (case.labels or case.boxes):
                found += [Scene(name, partial(_altered, name, case, alteration))
                          for kind, alteration in KINDS.items()
                          for name in [f'{folder.name}, {kind}']
                          if not (alteration.mirrored and np.any(case.camera.distortion))]
    return found


def _altered(name, case, alteration, folder, only):
    wanted = named(name, _encodings(_rate(case)), only)
    if wanted:
        like = _with_camera_and_truth(case, alteration, folder)
        yield from encoded(wanted, folder, _rate(case),
                           lambda: map(alteration.image, pictures(case.video)), like)


def _rate(case):
    return LABELLED if case.labels else BOXED


def _encodings(fps):
    b_frames = 0 if fps == LABELLED else 3
    return {'mpeg2.mp4': Encoding('mpeg2video', b_frames, 12, {
                'strict': '-2', 'flags': '0', 'b': RATES[fps]}),
            ORIGINAL: Encoding('h264', 0, 30, {
                'preset': 'veryfast', 'crf': '-1', 'b': RATES[fps]})}


def _with_camera_and_truth(case, alteration, folder):
    """Write what is known of a clip as it is of the altered one; return its case."""
    width, camera = case.camera.width, alteration.camera(case.camera)
    # What else is known of it is not altered.
    alone = replace(case, camera=camera, ground_truth=None, labels=None, boxes=None,
                    annotation=None)
    if case.labels:
        known = read_arrays(case.labels, ('tracks', 'visible', 'label'))
        tracks = alteration.x(known['tracks'], width)
        inside = np.all((tracks >= 0) & (tracks <= (camera.width - 1, camera.height - 1)), axis=2)
        part = folder / f'part {case.labels.name}'
        np.savez(part, tracks=tracks, label=known['label'],
                 visible=known['visible'].astype(bool) & inside)
        part.replace(folder / case.labels.name)  # another run may be about to read it
        return replace(alone, labels=folder / case.labels.name)
    table = read_table(case.boxes, BOX_HEADER)
    corners = np.stack([table['x'], table['y']], axis=-1)
    if alteration.mirrored:  # what was the last column of a box is its first then
        corners[:, 0] += table['width'] - 1
    table['x'], table['y'] = alteration.x(corners, width).T
    rows = np.stack([table[column] for column in BOX_HEADER.split(',')], axis=-1)
    part = folder / f'part {case.boxes.name}'
    np.savetxt(part, rows, '%g', ',', header=BOX_HEADER, comments='')
    part.replace(folder / case.boxes.name)
    return replace(alone, boxes=folder / case.boxes.name)
