"""What is gathered over a run and written at its end: labels, map, summary."""

from collections.abc import Iterable
from dataclasses import replace
import json
from pathlib import Path
from tempfile import TemporaryFile
from typing import Any, IO

from mv_slapse.errors import UnusableInput
from mv_slapse.geometry.blocks import grid_centres
from mv_slapse.geometry.plane import scaled_about
from mv_slapse.known_map import KnownMap
from mv_slapse.records import Extraction, MapPlane, ScaleStatus, SceneEstimate, WITH_POSE
from mv_slapse.storage.waiting_rows import WaitingRows
from mv_slapse.storage.whole_files import unusable, whole, write_text
import numpy as np

SCHEMA_VERSION = 1
MOST_PLANES = 10_000  # in map.json, about 20 MB; the oldest go first
BLOCK = 2_000_000  # ids of one extraction: planes from 0, movers from 100,000
LARGEST_MAP = 1 << 26  # bytes
UNIT = 1e-3  # by which a normal may be none
FARTHEST = 1e9  # [m or map unit]


class LabelArchive:
    """Labels of all key frames on one grid; they wait on the disk, for a run may last for days."""

    def __init__(self, folder: str | Path | None = None):
        """Hold nothing yet; the first key frame settles the grid.

        ``folder`` is where the labels wait, in files without a name; else where the system keeps
        such files.
        """
        self._size, self._n = (0, 0), 0
        self._stamps = TemporaryFile(dir=folder)  # noqa: SIM115 (as long as the archive)
        self._labels = TemporaryFile(dir=folder)  # noqa: SIM115
        self._planes = TemporaryFile(dir=folder)  # noqa: SIM115

    def close(self):
        """Give up what waits."""
        for file in (self._stamps, self._labels, self._planes):
            file.close()

    def add(self, extraction: Extraction):
        """Take the labels of a key frame; one of another picture size is left out."""
        size = extraction.width, extraction.height
        if not self._n:
            self._size = size
        if size == self._size:
            self._labels.write(np.asarray(extraction.macroblock_label, np.int8).tobytes())
            self._planes.write(np.asarray(extraction.macroblock_plane, np.int32).tobytes())
            self._stamps.write(np.int64(extraction.stamp).tobytes())
            self._n += 1

    def save(self, path: Path):
        """Write ``stamp`` [s], ``stamp_ns``, ``x``, ``y`` [px], ``label`` and ``plane``.

        Seconds since 1970 are known to 0.24 us in a float: only nanoseconds are the stamps of the
        other results.
        """
        stamps = _rows(self._stamps, np.int64, (self._n,))
        centres = grid_centres(*self._size)
        shape = self._n, len(centres)
        with whole(path, 'wb') as file:
            np.savez_compressed(
                file, stamp=stamps / 1e9, stamp_ns=stamps, x=centres[:, 0], y=centres[:, 1],
                label=_rows(self._labels, np.int8, shape),
                plane=_rows(self._planes, np.int32, shape))


def _rows(file: IO, dtype: type, shape: tuple[int, int]) -> np.ndarray:
    """Return a file's numbers without reading them all into memory."""
    file.flush()
    return np.memmap(file, dtype, 'r', shape=shape) if min(shape) else np.zeros(shape, dtype)


class MapArchive:
    """The planes there ever were in the map, each as last known; the newest MOST_PLANES of them.

    Those that have left the map wait on the disk, and follow where the map's unit changes. A disk
    that is full is told when they are asked for.
    """

    def __init__(self):
        """Hold nothing yet."""
        self._current: dict[int, MapPlane] = {}
        self._scene: SceneEstimate | None = None
        self._left = WaitingRows()
        self._offset = 0
        self._unit, self._place = 0.0, np.zeros(3)  # known from a map's first key frame on
        #: factors of the unit and the places they leave where they are, of each map that began
        self._changes: list[list[tuple[float, np.ndarray]]] = [[]]

    @property
    def has_planes(self) -> bool:
        """Whether there ever was a plane."""
        return bool(self._current or self._left.n)

    def close(self):
        """Give up what waits."""
        self._left.close()

    def begin_anew(self):
        """Keep what there is beside a map that begins: its planes are numbered from zero again."""
        self._leave(self._current.values())
        self._current, self._unit, self._place = {}, 0.0, np.zeros(3)
        self._offset += BLOCK
        self._changes.append([])

    def add(self, scene: SceneEstimate):
        """Take the map after a key frame."""
        before, self._scene = self._current, self._renumbered(scene)
        self._current = {plane.id: plane for plane in self._scene.planes}
        self._leave(plane for id, plane in before.items() if id not in self._current)
        if self._unit and scene.unit != self._unit:
            self._changes[-1].append((scene.unit / self._unit, self._place))
        self._unit = scene.unit
        if scene.status in WITH_POSE:
            self._place = scene.t_world_from_cam

    def _renumbered(self, scene: SceneEstimate) -> SceneEstimate:
        if not self._offset:
            return scene
        return replace(scene, planes=tuple(
            replace(plane, id=plane.id + self._offset) for plane in scene.planes))

    def _leave(self, planes: Iterable[MapPlane]):
        for plane in planes:
            since = {'since': (len(self._changes) - 1, len(self._changes[-1]))}
            self._left.add(json.dumps(_plane_content(plane, False) | since))

    def content(self) -> dict[str, Any]:
        """Return what ``map.json`` holds.

        Raises
        ------
        UnusableOutput
            Where the disk was full on the way.
        """
        left = {}
        try:
            for plane in map(json.loads, self._left):
                which, count = plane.pop('since')
                left.pop(plane['id'], None)  # the newest stand last
                left[plane['id']] = _rescaled(plane, self._changes[which][count:])
        except OSError as error:
            raise unusable('the map', error) from None
        content = map_content(self._scene, self._current.values())
        planes = [plane for id, plane in left.items() if id not in self._current]
        content['planes'] = [*planes, *content['planes']][-MOST_PLANES:]
        return content


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


def read_map(path: str | Path) -> KnownMap:
    """Return the map of an earlier run, as ``map.json`` or ``~/save_map`` holds it.

    Raises
    ------
    UnusableInput
        Where it cannot be read, is no such map, or says what cannot be.
    """
    try:
        with Path(path).open('rb') as file:
            text = file.read(LARGEST_MAP + 1)
        if len(text) > LARGEST_MAP:
            raise ValueError(f'it has more than {LARGEST_MAP} bytes')
        content = json.loads(text)
        planes = tuple(_plane(entry) for entry in content['planes'][:MOST_PLANES])
        return KnownMap(planes, content['units'] == 'm')
    except OSError as error:
        raise UnusableInput(f'{path} cannot be read: {error.strerror}; give the map.json of a '
                            'run, or what ~/save_map wrote') from None
    except (ValueError, TypeError, KeyError, IndexError, RecursionError, OverflowError) as error:
        raise UnusableInput(f'{path} is no map of mv_slapse ({type(error).__name__}: {error}); '
                            'give the map.json of a run, or what ~/save_map wrote') from None


def write_json(path: str | Path, content: dict[str, Any]):
    """Write a JSON file that is either the old one or whole."""
    write_text(path, json.dumps(content, indent=2) + '\n')


def _plane_content(plane: MapPlane, is_current: bool) -> dict[str, Any]:
    return {'id': int(plane.id), 'normal': _list(plane.normal), 'depth': float(plane.depth),
            'covariance': _list(plane.covariance), 'outline': _list(plane.outline),
            'first_seen': plane.first_stamp / 1e9, 'last_seen': plane.last_stamp / 1e9,
            'n_observations': int(plane.n_observations), 'is_ground': bool(plane.is_ground),
            'is_current': is_current}


def _rescaled(content: dict[str, Any], changes: Iterable[tuple[float, np.ndarray]]
              ) -> dict[str, Any]:
    """Return a plane's content after changes of the unit, each about a place (3,)."""
    for factor, place in changes:
        depth, covariance = scaled_about(place, factor, np.array(content['normal']),
                                         content['depth'], content['covariance'])
        outline = place + factor * (np.reshape(content['outline'], (-1, 3)) - place)
        content = content | {'depth': depth, 'covariance': _list(covariance),
                             'outline': _list(outline)}
    return content


def _plane(content: dict[str, Any]) -> MapPlane:
    normal, depth = _array(content['normal'], (3,)), float(content['depth'])
    covariance = _array(content['covariance'], (4, 4))
    outline = _array(content['outline'] or np.zeros((0, 3)), (-1, 3))
    if abs(np.linalg.norm(normal) - 1) > UNIT or not abs(depth) < FARTHEST:
        raise ValueError(f'the plane {content["id"]} has no unit normal or no depth')
    if np.linalg.eigvalsh(covariance + covariance.T).min() < -UNIT * np.trace(covariance):
        raise ValueError(f'the covariance of the plane {content["id"]} is none')
    return MapPlane(int(content['id']), normal, depth, covariance, outline,
                    round(content['first_seen'] * 1e9), round(content['last_seen'] * 1e9),
                    int(content['n_observations']), 0, bool(content['is_ground']))


def _array(values: Any, shape: tuple[int, ...]) -> np.ndarray:
    array = np.reshape(np.array(values, float), shape)
    if not np.all(np.abs(array) < FARTHEST):
        raise ValueError('a number is not finite, or absurdly large')
    return array


def _list(values: np.ndarray) -> list:
    return np.asarray(values, float).tolist()
