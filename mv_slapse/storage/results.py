"""The files of a run: trajectory, planes, obstacles, labels, map, bag, summary."""

from pathlib import Path
from typing import Any, TextIO

from mv_slapse.errors import UsageError
from mv_slapse.geometry.ros_frames import RosFrames
from mv_slapse.storage import tables, tum
from mv_slapse.storage.archives import LabelArchive, MapArchive, write_json
from mv_slapse.storage.message_log import MessageLog, Step, WITH_POSE
import numpy as np

AT_THE_END = ('labels.npz', 'map.json', 'results.mcap', 'summary.json')


class ResultsWriter:
    """Writes the steps of a run as they come; a context manager.

    Rows are on disk after each step, and closing completes the other files, so that a run that
    is interrupted leaves valid files of what it did.
    """

    def __init__(self, out: str | Path, frames: RosFrames | None = None):
        """Make the folder and its files; those of an earlier run go.

        Raises
        ------
        UsageError
            Where the folder cannot be written.
        """
        self.out = Path(out)
        try:
            self.out.mkdir(parents=True, exist_ok=True)
            for name in AT_THE_END:
                (self.out / name).unlink(missing_ok=True)
            self._trajectory = self._text('trajectory.tum')
            self._planes = self._text('planes.csv', tables.PLANES_HEADER)
            self._obstacles = self._text('obstacles.csv', tables.OBSTACLES_HEADER)
        except OSError as error:
            raise UsageError(f'{out} cannot be written: {error.strerror}; choose another output '
                             'folder with -o') from None
        self._messages = MessageLog(self.out / 'results.mcap', frames or RosFrames())
        self._labels = LabelArchive()
        self._map = MapArchive()
        self._has_origin = self._is_closed = False

    def __enter__(self) -> 'ResultsWriter':
        """Return itself."""
        return self

    def __exit__(self, *_):
        """Complete the files; the summary only where ``close`` was given one."""
        self.close()

    def write(self, step: Step):
        """Write what a key frame pair gave."""
        scene = step.scene
        if scene.status in WITH_POSE:
            self._write_pose(step)
            _put(self._planes, tables.plane_rows(scene))
        _put(self._obstacles, (tables.obstacle_row(o) for o in step.obstacles))
        self._labels.add(step.extraction)
        self._map.add(scene)
        self._messages.write(step)

    def close(self, summary: dict[str, Any] | None = None):
        """Complete all files; a second call does nothing."""
        if self._is_closed:
            return
        self._is_closed = True
        for file in (self._trajectory, self._planes, self._obstacles):
            file.close()
        self._messages.close()
        self._labels.save(self.out / 'labels.npz')
        write_json(self.out / 'map.json', self._map.content())
        if summary is not None:
            write_json(self.out / 'summary.json', summary)

    def _text(self, name: str, head: str = '') -> TextIO:
        # line-buffered: whole rows reach the disk, whatever ends the run
        file = (self.out / name).open('w', buffering=1)
        _put(file, [head] if head else [])
        return file

    def _write_pose(self, step: Step):
        scene, rows = step.scene, []
        if not self._has_origin:
            self._has_origin = True
            rows.append(tum.format_row(step.correspondences.previous_stamp, np.eye(3),
                                       np.zeros(3)))
        rows.append(tum.format_row(scene.stamp, scene.R_world_from_cam, scene.t_world_from_cam))
        _put(self._trajectory, rows)


def _put(file: TextIO, rows: Any):
    for row in rows:
        file.write(row + '\n')
