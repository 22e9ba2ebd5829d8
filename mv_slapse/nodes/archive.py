"""~/save_map and ~/save_trajectory: what slam knows, as the files of the command line."""

from dataclasses import replace
import os
from pathlib import Path

from mv_slapse.errors import MvSlapseError
from mv_slapse.frame_change import in_frames
from mv_slapse.nodes.settings import SceneOutputSettings
from mv_slapse.nodes.shell import Shell
from mv_slapse.records import SceneEstimate
from mv_slapse.ros_frames import Pose, RosFrames
from mv_slapse.storage.archives import MapArchive, write_json
from mv_slapse.storage.tum import TrajectoryRows
from mv_slapse.storage.waiting_rows import WaitingRows
from mv_slapse.storage.whole_files import whole
from std_srvs.srv import Trigger


class Archive:
    """Trajectory and map since the start, written when a service asks for them."""

    def __init__(self, node: Shell):
        """Offer the services; where the files go is a read-only parameter, no request says it."""
        self._folder = _folder(node.settings[SceneOutputSettings].output_directory)
        self._trajectory, self._rows, self._map = TrajectoryRows(), WaitingRows(), MapArchive()
        node.create_service(Trigger, '~/save_map', self._on_save_map)
        node.create_service(Trigger, '~/save_trajectory', self._on_save_trajectory)

    def restart(self):
        """Forget everything."""
        self._rows.close()
        self._map.close()
        self._trajectory, self._rows, self._map = TrajectoryRows(), WaitingRows(), MapArchive()

    def begin_anew(self):
        """Go on with the map of a new filter, which numbers its planes from zero again."""
        self._map.begin_anew()

    def add(self, scene: SceneEstimate, previous_stamp: int, frames: RosFrames, origin: Pose):
        """Take the estimate of a key frame; the first in motion also gives where it began.

        All is kept in the {W} that belongs to odom's origin, where the base has the pose
        ``origin``, wherever the filter has begun.
        """
        scene = in_frames(scene, frames, replace(
            frames, R_odom_from_start=origin.R, t_odom_from_start=origin.t))
        self._map.add(scene)
        for row in self._trajectory.of(scene, previous_stamp):
            self._rows.add(row)

    def _on_save_map(self, _request, response):
        if not self._map.has_planes:
            return _nothing(response, 'there is no plane in the map yet')
        return self._save(response, 'map.json',
                          lambda path: write_json(path, self._map.content()))

    def _on_save_trajectory(self, _request, response):
        if not self._rows.n:
            return _nothing(response, 'there is no pose yet')
        return self._save(response, 'trajectory.tum', self._save_rows)

    def _save_rows(self, path: Path):
        with whole(path) as file:
            file.writelines(self._rows)

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


def _nothing(response, why: str):
    """Refuse to write a file without content."""
    response.success = False
    response.message = f'nothing to save: {why}; see /diagnostics for what is missing'
    return response


def _folder(parameter: str) -> Path:
    if parameter:
        return Path(parameter).expanduser()
    return Path(os.environ.get('ROS_HOME') or Path.home() / '.ros') / 'mv_slapse'
