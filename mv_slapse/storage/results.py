"""The files of a run: trajectory, planes, obstacles, labels, map, bag, summary."""

from collections.abc import Callable
from contextlib import ExitStack, suppress
import errno
from functools import partial
from pathlib import Path
from typing import Any, IO, TextIO

from mv_slapse.codec.packet import Packet
from mv_slapse.errors import MvSlapseError, UnusableOutput, UsageError
from mv_slapse.geometry.camera import Camera
from mv_slapse.ros_frames import ORIGIN, RosFrames
from mv_slapse.storage import tables, tum
from mv_slapse.storage.archives import LabelArchive, MapArchive, write_json
from mv_slapse.storage.message_log import MessageLog, Step
from mv_slapse.storage.whole_files import locked, PART, part_of, put_in_place, unusable

ROWS = ('trajectory.tum', 'planes.csv', 'obstacles.csv')
FULL = {errno.ENOSPC, errno.EDQUOT, errno.EFBIG}
AT_THE_END = ('labels.npz', 'map.json', 'results.mcap', 'summary.json')
LOCK = '.run.lock'  # while a run writes; .lock is a batch's
RESULTS = (*AT_THE_END, *ROWS, 'report.html')  # the last is another writer's


class ResultsWriter:
    """Writes the steps of a run as they come; a context manager.

    All files grow beside their places, rows line by line, and closing puts them there, so that a
    run that is interrupted leaves whole files of what it did. One that is killed leaves rows in
    files that end in ``.part``. No other run writes into the folder meanwhile.
    """

    def __init__(self, out: str | Path, frames: RosFrames | None = None,
                 camera: Camera | None = None, held: ExitStack | None = None):
        """Make the folder and its files; those of an earlier run go.

        Parameters
        ----------
        held : ExitStack or None
            Keeps other runs out until it is closed, for those who go on to read the files; None:
            until the files are complete.

        Raises
        ------
        UsageError, UnusableOutput
            Where the folder cannot be written, or another run writes there; where the disk is
            full.
        """
        self.out = Path(out)
        try:
            self.out.mkdir(parents=True, exist_ok=True)
            self._lock = self._locked()
            if held is not None:
                held.callback(self._unlock)
            self._is_held = held is not None
            for name in RESULTS:
                (self.out / name).unlink(missing_ok=True)
            self._trajectory = self._text('trajectory.tum')
            self._planes = self._text('planes.csv', tables.PLANES_HEADER)
            self._obstacles = self._text('obstacles.csv', tables.OBSTACLES_HEADER)
            self._labels = LabelArchive(self.out)
        except OSError as error:
            if error.errno in FULL:
                raise unusable(self.out, error, 'free the disk or choose another folder with -o'
                               ) from error
            raise UsageError(f'{out} cannot be written: {error.strerror}; choose another output '
                             'folder with -o') from None
        self._messages = MessageLog(self.out / 'results.mcap', frames or RosFrames(), camera)
        self._map = MapArchive()
        self._size = (camera.width, camera.height) if camera else (0, 0)
        self._rows, self._is_closed = tum.TrajectoryRows(), False
        #: pose of the first key frame's camera
        self.origin = ORIGIN

    def __enter__(self) -> 'ResultsWriter':
        """Return itself."""
        return self

    def __exit__(self, *_):
        """Complete the files; the summary only where ``close`` was given one."""
        self.close()

    def write(self, step: Step):
        """Write what a key frame pair gave.

        Raises
        ------
        UnusableOutput
            Where it cannot be written; names what there is.
        """
        scene = step.scene
        rows = self._rows.of(scene, step.correspondences.previous_stamp, self.origin)
        try:
            if rows:
                _put(self._trajectory, rows)
                _put(self._planes, tables.plane_rows(scene))
            _put(self._obstacles, (tables.obstacle_row(o) for o in step.obstacles))
            self._labels.add(step.extraction)
        except OSError as error:
            raise self._unusable(error) from error
        self._map.add(scene)
        self._messages.write(step)

    def write_packet(self, packet: Packet):
        """Put a packet of the video among the messages."""
        self._messages.write_packet(packet, self._size)

    def close(self, summary: dict[str, Any] | None = None):
        """Complete all files; a second call does nothing.

        Where one cannot be completed the others still are.

        Raises
        ------
        UnusableOutput
            Naming the first that cannot be, why, and what was written.
        """
        if self._is_closed:
            return
        self._is_closed = True
        steps = [*(partial(self._finish, file, name) for name, file in zip(
            ROWS, (self._trajectory, self._planes, self._obstacles), strict=True)),
            self._messages.close, partial(self._labels.save, self.out / 'labels.npz'),
            lambda: write_json(self.out / 'map.json', self._map.content())]
        if summary is not None:
            steps.append(partial(write_json, self.out / 'summary.json', summary))
        steps.append(self._labels.close)
        errors = [error for step in steps if (error := _failure(step))]
        if not self._is_held:
            self._unlock()
        if errors:
            raise self._unusable(errors[0]) from errors[0]

    def _locked(self) -> IO:
        lock = locked(self.out / LOCK)
        if lock is None:
            raise UsageError(f'another run writes into {self.out}; wait for it, or choose another '
                             'folder with -o')
        return lock

    def _unlock(self):
        with suppress(OSError):  # a file without a lock keeps nobody out
            (self.out / LOCK).unlink(missing_ok=True)
        self._lock.close()

    def _finish(self, file: TextIO, name: str):
        file.close()
        put_in_place(self.out / name)

    def _unusable(self, error: OSError | MvSlapseError) -> UnusableOutput:
        found = sorted(path.name for path in self.out.iterdir()
                       if path.is_file() and path.name != LOCK)
        reason = getattr(error, 'strerror', None) or error
        return UnusableOutput(f'{self.out} cannot be written: {reason}; these files are whole: '
                              f'{", ".join(n for n in found if not n.endswith(PART)) or "none"}; '
                              'free the disk or choose another folder with -o')

    def _text(self, name: str, head: str = '') -> TextIO:
        # line-buffered: whole rows reach the disk, whatever ends the run
        file = part_of(self.out / name).open('w', buffering=1)
        _put(file, [head] if head else [])
        return file


def _failure(step: Callable[[], None]) -> OSError | MvSlapseError | None:
    """Return why a step failed, None where it did not."""
    try:
        step()
    except (OSError, MvSlapseError) as error:
        return error
    return None


def _put(file: TextIO, rows: Any):
    for row in rows:
        file.write(row + '\n')
