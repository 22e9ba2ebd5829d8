"""~/save_map and ~/save_trajectory: what slam knows, as the files of the command line."""

from array import array
from dataclasses import replace
import os
from pathlib import Path

from mv_slapse.frame_change import in_frames
from mv_slapse.geometry.ros_frames import RosFrames
from mv_slapse.nodes.scene_join import WITH_POSE
from mv_slapse.nodes.settings import SceneOutputSettings
from mv_slapse.nodes.shell import Shell
from mv_slapse.records import MapPlane, SceneEstimate
import numpy as np
from std_srvs.srv import Trigger


class Archive:
    """Trajectory and map since the start, written when a service asks for them."""

    def __init__(self, node: Shell):
        """Offer the services; where the files go is a read-only parameter, no request says it."""
        self._folder = _folder(node.settings[SceneOutputSettings].output_directory)
        self.restart()
        node.create_service(Trigger, '~/save_map', self._on_save_map)
        node.create_service(Trigger, '~/save_trajectory', self._on_save_trajectory)

    def restart(self):
        """Forget everything."""
        self._scene: SceneEstimate | None = None
        self._planes: dict[int, MapPlane] = {}
        self._stamps, self._poses = array('q'), array('d')

    def add(self, scene: SceneEstimate, previous_stamp: int, frames: RosFrames):
        """Take the estimate of a key frame; the first pair also gives the first key frame.

        All is kept in the {W} that belongs to odom's origin, wherever the filter has begun.
        """
        scene = in_frames(scene, frames, replace(
            frames, R_odom_from_start=np.eye(3), t_odom_from_start=np.zeros(3)))
        self._scene = scene
        self._planes.update((plane.id, plane) for plane in scene.planes)
        if scene.status not in WITH_POSE:
            return
        if not self._stamps:
            self._add_pose(previous_stamp, np.eye(3), np.zeros(3))
        self._add_pose(scene.stamp, scene.R_world_from_cam, scene.t_world_from_cam)

    def _add_pose(self, stamp: int, R: np.ndarray, t: np.ndarray):
        self._stamps.append(stamp)
        self._poses.extend([*R.ravel(), *t])

    def _on_save_map(self, _request, response):
        if not self._planes:
            return _nothing(response, 'there is no plane in the map yet')
        return self._save(response, 'map.json', self._write_map)

    def _on_save_trajectory(self, _request, response):
        if not self._stamps:
            return _nothing(response, 'there is no pose yet')
        return self._save(response, 'trajectory.tum', self._write_trajectory)

    def _write_map(self, path: Path):
        # here, so that a robot without the libraries for bags can run the node
        from mv_slapse.storage.archives import map_content, write_json
        write_json(path, map_content(self._scene, self._planes.values()))

    def _write_trajectory(self, path: Path):
        from mv_slapse.storage import tum
        poses = np.reshape(self._poses, (-1, 12))
        tum.write_poses(path, ((stamp, pose[:9].reshape(3, 3), pose[9:])
                               for stamp, pose in zip(self._stamps, poses, strict=True)))

    def _save(self, response, name: str, write):
        path = self._folder / name
        try:
            self._folder.mkdir(parents=True, exist_ok=True)
            write(path)
            response.success, response.message = True, str(path)
        except (OSError, ImportError) as error:
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
