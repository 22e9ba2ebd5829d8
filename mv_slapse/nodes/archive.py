"""~/save_map and ~/save_trajectory: what slam knows, as the files of the command line."""

from contextlib import suppress
from dataclasses import replace
import os
from pathlib import Path
import shutil
from tempfile import TemporaryFile

from mv_slapse.errors import MvSlapseError
from mv_slapse.frame_change import in_frames
from mv_slapse.geometry.ros_frames import Pose, RosFrames
from mv_slapse.nodes.scene_join import WITH_POSE
from mv_slapse.nodes.settings import SceneOutputSettings
from mv_slapse.nodes.shell import Shell
from mv_slapse.records import SceneEstimate
from mv_slapse.storage.archives import MapArchive, write_json
from mv_slapse.storage.tum import format_row
from mv_slapse.storage.whole_files import whole
import numpy as np
from std_srvs.srv import Trigger


class Archive:
    """Trajectory and map since the start, written when a service asks for them."""

    def __init__(self, node: Shell):
        """Offer the services; where the files go is a read-only parameter, no request says it."""
        self._folder = _folder(node.settings[SceneOutputSettings].output_directory)
        self._rows: _Rows | None = None
        self.restart()
        node.create_service(Trigger, '~/save_map', self._on_save_map)
        node.create_service(Trigger, '~/save_trajectory', self._on_save_trajectory)

    def restart(self):
        """Forget everything."""
        if self._rows is not None:
            self._rows.close()
        self._rows, self._map, self._has_planes = _Rows(), MapArchive(), False

    def add(self, scene: SceneEstimate, previous_stamp: int, frames: RosFrames, origin: Pose):
        """Take the estimate of a key frame; the first pair also gives the first key frame.

        All is kept in the {W} that belongs to odom's origin, where the base has the pose
        ``origin``, wherever the filter has begun.
        """
        scene = in_frames(scene, frames, replace(
            frames, R_odom_from_start=origin.R, t_odom_from_start=origin.t))
        self._map.add(scene)
        self._has_planes |= bool(scene.planes)
        if scene.status not in WITH_POSE:
            return
        if not self._rows.n:
            self._rows.add(format_row(previous_stamp, np.eye(3), np.zeros(3)))
        self._rows.add(format_row(scene.stamp, scene.R_world_from_cam, scene.t_world_from_cam))

    def _on_save_map(self, _request, response):
        if not self._has_planes:
            return _nothing(response, 'there is no plane in the map yet')
        return self._save(response, 'map.json',
                          lambda path: write_json(path, self._map.content()))

    def _on_save_trajectory(self, _request, response):
        if not self._rows.n:
            return _nothing(response, 'there is no pose yet')
        return self._save(response, 'trajectory.tum', self._rows.save)

    def _save(self, response, name: str, write):
        path = self._folder / name
        try:
            self._folder.mkdir(parents=True, exist_ok=True)
            write(path)
            response.success, response.message = True, str(path)
        except (OSError, MvSlapseError) as error:
            response.success = False
            response.message = (f'{path} cannot be written: {error}; start the node with '
                                'another output_directory')
        return response


class _Rows:
    """Rows of text; they wait on the disk, for a node may run for days.

    A disk that is full ends them, and not the node: what could not wait is told when it is asked
    for.
    """

    def __init__(self):
        self.n = 0
        self._error: OSError | None = None
        try:
            self._file = TemporaryFile('w+')  # noqa: SIM115 (as long as this)
        except OSError as error:
            self._file, self._error = None, error

    def add(self, row: str):
        """Keep a row, up to the first that cannot be kept."""
        self.n += 1
        if self._error is None:
            try:
                self._file.write(row + '\n')
            except OSError as error:
                self._error = error

    def save(self, path: Path):
        """Write all rows into a file."""
        if self._error is not None:
            raise self._error
        self._file.seek(0)  # what is buffered is written before
        with whole(path) as file:
            shutil.copyfileobj(self._file, file)
        self._file.seek(0, os.SEEK_END)

    def close(self):
        """Give them up; what a full disk does not take any more is not wanted either."""
        if self._file is not None:
            with suppress(OSError):
                self._file.close()


def _nothing(response, why: str):
    """Refuse to write a file without content."""
    response.success = False
    response.message = f'nothing to save: {why}; see /diagnostics for what is missing'
    return response


def _folder(parameter: str) -> Path:
    if parameter:
        return Path(parameter).expanduser()
    return Path(os.environ.get('ROS_HOME') or Path.home() / '.ros') / 'mv_slapse'
