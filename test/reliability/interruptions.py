"""Disk full, SIGKILL and cut bags: whole files, own errors, nothing else.

A short video is run in child processes: with a bound on the size of files, at which writing fails
as on a full disk; and killed at many moments. A bag is cut at many places.
"""

import argparse
from collections.abc import Callable
import io
import json
import os
from pathlib import Path
import resource
import signal
import sys
import tempfile
import time

from mv_slapse.codec.encoding.encoder import Encoding, write_video
from mv_slapse.errors import MvSlapseError
from mv_slapse.geometry.camera import Camera
from mv_slapse.storage.bag_reader import BagReader
from mv_slapse.storage.camera_info import write_camera
from mv_slapse.storage.tables import OBSTACLES_HEADER, PLANES_HEADER, read_table
from mv_slapse.storage.tum import read_trajectory
from mv_slapse.tools import main as command_line
import numpy as np
import pictures

SIZE = 192, 160
CAMERA = Camera(*SIZE, np.array([[150.0, 0, 95.5], [0, 150, 79.5], [0, 0, 1]]))
READERS: dict[str, Callable[[Path], object]] = {
    'trajectory.tum': read_trajectory,
    'planes.csv': lambda path: read_table(path, PLANES_HEADER),
    'obstacles.csv': lambda path: read_table(path, OBSTACLES_HEADER),
    'labels.npz': lambda path: [np.load(path)[name].shape for name in ('stamp', 'label', 'plane')],
    'map.json': lambda path: json.loads(path.read_text()),
    'summary.json': lambda path: json.loads(path.read_text()),
    'results.mcap': lambda path: [raw for raw, _ in BagReader(path).messages(
        list(BagReader(path).topics))]}


class Scene:
    """A folder with a video, its camera, and the results of a whole run."""

    def __init__(self, folder: Path, pictures_in_all: int = 40):
        self.folder = folder
        write_camera(folder / 'camera.yaml', CAMERA)
        write_video(folder / 'video.mpg', pictures.sliding(
            np.random.default_rng(0), pictures_in_all, (3, 1), SIZE), 25.0, Encoding(b_frames=1))
        begin = time.monotonic()
        code = self.run(folder / 'whole')
        assert code in (0, 4), code
        self.seconds = time.monotonic() - begin

    def run(self, out: Path, most: int | None = None, kill_after: float | None = None) -> int:
        """Run the video in a child; return its exit code, below zero for a signal.

        Parameters
        ----------
        most : int or None
            Bytes that a file may have.
        kill_after : float or None
            Seconds until SIGKILL.
        """
        child = os.fork()
        if not child:
            os._exit(self._child(out, most))
        if kill_after is not None:
            time.sleep(kill_after)
            os.kill(child, signal.SIGKILL)
        return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])

    def _child(self, out: Path, most: int | None) -> int:
        sys.stdout, sys.stderr = io.StringIO(), io.StringIO()
        if most is not None:
            signal.signal(signal.SIGXFSZ, signal.SIG_IGN)  # Python's way, for a sure thing
            resource.setrlimit(resource.RLIMIT_FSIZE, (most, resource.RLIM_INFINITY))
        try:
            code = command_line.main([
                'run', str(self.folder / 'video.mpg'), '--camera',
                str(self.folder / 'camera.yaml'), '-o', str(out), '--no-report', '--quiet'])
        except BaseException as error:
            code, said = 100, repr(error)
        else:
            said = sys.stderr.getvalue()
        if most is not None:
            resource.setrlimit(resource.RLIMIT_FSIZE, (resource.RLIM_INFINITY,) * 2)
        (out.parent / f'{out.name}.said').write_text(said)
        return code


def unwhole(out: Path) -> list[str]:
    """Return the files of a run that have their names and cannot be read to their ends."""
    found = []
    for name, read in READERS.items():
        if (out / name).exists():
            try:
                read(out / name)
            except Exception as error:
                found.append(f'{name}: {type(error).__name__}: {error}')
    return found


def full_disk(scene: Scene, places: int) -> list[str]:
    """Let files end at many sizes; return what is wrong."""
    largest = max(path.stat().st_size for path in (scene.folder / 'whole').iterdir())
    wrong = []
    for most in np.geomspace(10, largest * 0.9, places).astype(int):
        out = scene.folder / f'full_{most}'
        code = scene.run(out, int(most))
        said = (out.parent / f'{out.name}.said').read_text()
        if code != 3 or 'cannot be written' not in said or 'fault of mv_slapse' in said:
            wrong.append(f'files of {most} bytes: exit code {code}, {said.strip()}')
        wrong += [f'files of {most} bytes: {text}' for text in unwhole(out)]
    return wrong


def kills(scene: Scene, moments: int, seed: int = 0) -> list[str]:
    """Kill a run at many moments; return what is wrong."""
    wrong = []
    for i, share in enumerate(np.random.default_rng(seed).uniform(0, 1.1, moments)):
        out = scene.folder / f'killed_{i % 3}'  # what an earlier one left is there
        code = scene.run(out, kill_after=share * scene.seconds)
        if code not in (0, 4, -signal.SIGKILL):
            wrong.append(f'killed at {share:.2f}: exit code {code}')
        wrong += [f'killed at {share:.2f}: {text}' for text in unwhole(out)]
        grown = out / 'results' / 'results.mcap'
        if grown.exists():
            wrong += _prefix_of(grown, _messages(scene.folder / 'whole' / 'results.mcap'),
                                f'killed at {share:.2f}')
    code, left = scene.run(out), [*unwhole(out), *(path.name for path in out.glob('*.part'))]
    if code not in (0, 4) or left:
        said = (out.parent / f'{out.name}.said').read_text()
        wrong.append(f'a run over what a killed one left: exit code {code}, {left}, {said}')
    return wrong


def cuts(scene: Scene, places: int) -> list[str]:
    """Cut a bag at many places; return what is wrong."""
    whole = scene.folder / 'whole' / 'results.mcap'
    content, expected = whole.read_bytes(), _messages(whole)
    wrong, cut = [], scene.folder / 'cut.mcap'
    for size in np.linspace(0, len(content) - 1, places).astype(int):
        cut.write_bytes(content[:size])
        wrong += _prefix_of(cut, expected, f'cut at {size} of {len(content)} bytes')
    return wrong


def _messages(path: Path) -> list[tuple[str, bytes]]:
    reader = BagReader(path)
    return [(raw.topic, bytes(raw.data)) for raw, _ in reader.messages(list(reader.topics))]


def _prefix_of(path: Path, expected: list[tuple[str, bytes]], what: str) -> list[str]:
    """Return what is wrong with a bag that should hold the first of the messages expected."""
    try:
        found = _messages(path)
    except MvSlapseError:
        return []
    except Exception as error:
        return [f'{what}: {type(error).__name__}: {error}']
    return [] if found == expected[:len(found)] else [f'{what}: other messages than before']


def main() -> int:
    """Print what is wrong, and how much was tried; return 1 where something is."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--places', type=int, default=20, help='sizes of files (default: 20)')
    parser.add_argument('--moments', type=int, default=100, help='of kills (default: 100)')
    parser.add_argument('--cuts', type=int, default=100, help='of a bag (default: 100)')
    args = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        scene = Scene(Path(folder))
        wrong = {'full disk': full_disk(scene, args.places), 'killed': kills(scene, args.moments),
                 'cut': cuts(scene, args.cuts)}
    print(json.dumps({name: len(found) for name, found in wrong.items()}))
    print(*(text for found in wrong.values() for text in found), sep='\n', file=sys.stderr)
    return int(any(wrong.values()))


if __name__ == '__main__':
    sys.exit(main())
