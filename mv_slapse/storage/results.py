"""The files of a run: trajectory, planes, obstacles, labels, map, bag, summary."""

from collections.abc import Sequence
import json
from pathlib import Path
from typing import Any, Protocol, TextIO

from mv_slapse import fields
from mv_slapse.errors import UsageError
from mv_slapse.geometry.ros_frames import RosFrames
from mv_slapse.records import (
    Correspondences,
    Extraction,
    MapPlane,
    Obstacle,
    PlaneHandover,
    ScaleStatus,
    SceneEstimate,
    TrackingStatus,
)
from mv_slapse.storage import labels, tables, tum
from mv_slapse.storage.bag_writer import McapFile
import numpy as np

SCHEMA_VERSION = 1
WITH_POSE = (TrackingStatus.OK, TrackingStatus.PREDICTED)


class Step(Protocol):
    """What the pipeline returns for a key frame pair."""

    correspondences: Correspondences
    extraction: Extraction
    scene: SceneEstimate
    obstacles: Sequence[Obstacle]
    handovers: Sequence[PlaneHandover]


class ResultsWriter:
    """Writes the steps of a run as they come; a context manager.

    Rows are on disk after each step, and closing completes the other files, so that a run that
    is interrupted leaves valid files of what it did.
    """

    def __init__(self, out: str | Path, frames: RosFrames | None = None):
        """Make the folder and its files.

        Raises
        ------
        UsageError
            Where the folder cannot be written.
        """
        self.out = Path(out)
        self._frames = frames or RosFrames()
        try:
            self.out.mkdir(parents=True, exist_ok=True)
            self._trajectory = self._text('trajectory.tum')
            self._planes = self._text('planes.csv', tables.PLANES_HEADER)
            self._obstacles = self._text('obstacles.csv', tables.OBSTACLES_HEADER)
        except OSError as error:
            raise UsageError(f'{out} cannot be written: {error.strerror}; choose another output '
                             'folder with -o') from None
        self._bag = McapFile(self.out / 'results.mcap')
        self._labels = LabelArchive()
        self._map = MapArchive()
        self._has_origin = self._has_camera_transform = self._is_closed = False

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
        self._labels.add(step.correspondences, step.extraction)
        self._map.add(scene)
        self._write_messages(step)

    def close(self, summary: dict[str, Any] | None = None):
        """Complete all files; a second call does nothing."""
        if self._is_closed:
            return
        self._is_closed = True
        for file in (self._trajectory, self._planes, self._obstacles):
            file.close()
        self._bag.close()
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

    def _write_messages(self, step: Step):
        scene, frames, stamp = step.scene, self._frames, step.scene.stamp
        put = self._bag.write
        put('/correspondences', 'mv_slapse_msgs/msg/Correspondences',
            fields.correspondences_to_fields(step.correspondences, frames), stamp)
        put('/planes/observations', 'mv_slapse_msgs/msg/PlaneObservations',
            fields.extraction_to_fields(step.extraction, frames), stamp)
        if scene.status in WITH_POSE:
            self._write_scene(scene)
        put('/planes/map', 'mv_slapse_msgs/msg/PlaneMap',
            fields.plane_map_to_fields(scene, frames), stamp, True)
        put('/obstacles', 'mv_slapse_msgs/msg/ObstacleArray',
            fields.obstacles_to_fields(stamp, step.obstacles, scene.scale_status, frames), stamp)
        for handover in step.handovers:
            put('/planes/handover', 'mv_slapse_msgs/msg/PlaneHandover',
                fields.handover_to_fields(handover, frames), stamp)

    def _write_scene(self, scene: SceneEstimate):
        frames, put, stamp = self._frames, self._bag.write, scene.stamp
        if not self._has_camera_transform:
            self._has_camera_transform = True
            camera = fields.camera_transform_to_fields(stamp, frames)
            put('/tf_static', 'tf2_msgs/msg/TFMessage', {'transforms': [camera]}, stamp, True)
        put('/tf', 'tf2_msgs/msg/TFMessage',
            {'transforms': [fields.transform_to_fields(scene, frames)]}, stamp)
        put('/odometry', 'nav_msgs/msg/Odometry', fields.odometry_to_fields(scene, frames), stamp)
        put('/pose', 'geometry_msgs/msg/PoseWithCovarianceStamped',
            fields.pose_to_fields(scene, frames), stamp)
        put('/twist', 'geometry_msgs/msg/TwistWithCovarianceStamped',
            fields.twist_to_fields(scene, frames), stamp)


class LabelArchive:
    """Labels of all key frames on one grid."""

    def __init__(self):
        """Hold nothing yet; the first key frame settles the grid."""
        self._size = (0, 0)
        self._stamps: list[int] = []
        self._grids: list[labels.LabelGrid] = []

    def add(self, correspondences: Correspondences, extraction: Extraction):
        """Take the labels of a key frame; one of another picture size is left out."""
        size = extraction.width, extraction.height
        if not self._stamps:
            self._size = size
        if size == self._size:
            self._stamps.append(extraction.stamp)
            self._grids.append(labels.vote(correspondences, extraction))

    def save(self, path: Path):
        """Write ``stamp`` [s], ``x``, ``y`` [px], ``label`` and ``plane``."""
        centres = labels.grid_centres(*self._size)
        shape = len(self._grids), len(centres)
        np.savez_compressed(
            path, stamp=np.array(self._stamps, np.int64) / 1e9, x=centres[:, 0], y=centres[:, 1],
            label=np.array([grid.label for grid in self._grids], np.int8).reshape(shape),
            plane=np.array([grid.plane for grid in self._grids], np.int32).reshape(shape))


class MapArchive:
    """All planes there ever were in the map, each as last known."""

    def __init__(self):
        """Hold nothing yet."""
        self._planes: dict[int, MapPlane] = {}
        self._scene: SceneEstimate | None = None

    def add(self, scene: SceneEstimate):
        """Take the map after a key frame."""
        self._scene = scene
        self._planes.update((plane.id, plane) for plane in scene.planes)

    def content(self) -> dict[str, Any]:
        """Return what ``map.json`` holds."""
        return map_content(self._scene, self._planes.values())


def map_content(scene: SceneEstimate | None, planes: Any) -> dict[str, Any]:
    """Return a map as plain values: planes in {W}, unit, and where the scale comes from."""
    is_metric = scene is not None and scene.scale_status is ScaleStatus.METRIC
    current = {plane.id for plane in scene.planes} if scene else set()
    return {
        'schema_version': SCHEMA_VERSION,
        'frame': 'camera of the first key frame: x right, y down, z forward',
        'units': 'm' if is_metric else 'map unit',
        'scale_status': 'metric' if is_metric else 'unknown',
        'scale_source': scene.scale_source if scene else '',
        'stamp': scene.stamp / 1e9 if scene else None,
        'planes': [_plane_content(plane, plane.id in current) for plane in planes]}


def write_json(path: str | Path, content: dict[str, Any]):
    """Write a JSON file that is either the old one or whole."""
    path = Path(path)
    part = path.with_name(path.name + '.part')
    part.write_text(json.dumps(content, indent=2) + '\n')
    part.replace(path)


def _plane_content(plane: MapPlane, is_current: bool) -> dict[str, Any]:
    return {'id': int(plane.id), 'normal': _list(plane.normal), 'depth': float(plane.depth),
            'covariance': _list(plane.covariance), 'outline': _list(plane.outline),
            'first_seen': plane.first_stamp / 1e9, 'last_seen': plane.last_stamp / 1e9,
            'n_observations': int(plane.n_observations), 'is_ground': bool(plane.is_ground),
            'is_current': is_current}


def _list(values: np.ndarray) -> list:
    return np.asarray(values, float).tolist()


def _put(file: TextIO, rows: Any):
    for row in rows:
        file.write(row + '\n')
