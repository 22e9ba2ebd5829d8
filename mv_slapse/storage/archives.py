"""What is gathered over a run and written at its end: labels, map, summary."""

import json
from pathlib import Path
from typing import Any

from mv_slapse.geometry.blocks import grid_centres
from mv_slapse.records import Extraction, MapPlane, ScaleStatus, SceneEstimate
import numpy as np

SCHEMA_VERSION = 1


class LabelArchive:
    """Labels of all key frames on one grid."""

    def __init__(self):
        """Hold nothing yet; the first key frame settles the grid."""
        self._size = (0, 0)
        self._stamps: list[int] = []
        self._labels: list[np.ndarray] = []
        self._planes: list[np.ndarray] = []

    def add(self, extraction: Extraction):
        """Take the labels of a key frame; one of another picture size is left out."""
        size = extraction.width, extraction.height
        if not self._stamps:
            self._size = size
        if size == self._size:
            self._stamps.append(extraction.stamp)
            self._labels.append(extraction.macroblock_label)
            self._planes.append(extraction.macroblock_plane)

    def save(self, path: Path):
        """Write ``stamp`` [s], ``x``, ``y`` [px], ``label`` and ``plane``."""
        centres = grid_centres(*self._size)
        shape = len(self._stamps), len(centres)
        np.savez_compressed(
            path, stamp=np.array(self._stamps, np.int64) / 1e9, x=centres[:, 0], y=centres[:, 1],
            label=np.array(self._labels, np.int8).reshape(shape),
            plane=np.array(self._planes, np.int32).reshape(shape))


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
