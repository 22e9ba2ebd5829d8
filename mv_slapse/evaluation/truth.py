"""The truth that comes with a rendered street: planes, movers, labels of macroblocks."""

from dataclasses import dataclass
import json
from pathlib import Path

from mv_slapse.errors import UnusableInput
from mv_slapse.storage.tables import read_table
from mv_slapse.storage.tum import read_trajectory, Trajectory
import numpy as np

MOVER_COLUMNS = ('stamp,id,x,y,width,height,px,py,pz,vx,vy,vz,ttc,n_macroblocks,range,'
                 'closing,aside')


@dataclass(frozen=True)
class TruePlane:
    """A plane normal @ X + depth = 0 in {W} [m]."""

    id: int
    name: str
    normal: np.ndarray
    depth: float


@dataclass(frozen=True)
class LabelTable:
    """Labels of macroblocks over time, estimated or true.

    Attributes
    ----------
    stamps : (F,) int64
        [ns].
    x, y : (M,) float64
        Centres [px].
    label, plane : (F, M) int
    """

    stamps: np.ndarray
    x: np.ndarray
    y: np.ndarray
    label: np.ndarray
    plane: np.ndarray


@dataclass(frozen=True)
class Truth:
    """What is known of an input; None where it is not."""

    trajectory: Trajectory | None = None
    planes: list[TruePlane] | None = None
    movers: dict[str, np.ndarray] | None = None
    labels: LabelTable | None = None


def read_truth(path: str | Path) -> Truth:
    """Return the truth in a folder, or the trajectory in a file.

    Raises
    ------
    UnusableInput
        Where there is nothing, or a file cannot be read.
    """
    path = Path(path)
    if not path.is_dir():
        return Truth(read_trajectory(path))
    found = {name: path / name for name in ('ground_truth.tum', 'scene.json', 'movers.csv',
                                            'truth_labels.npz') if (path / name).exists()}
    if not found:
        raise UnusableInput(f'{path} holds no truth: no ground_truth.tum, scene.json, movers.csv '
                            'or truth_labels.npz')
    return Truth(
        read_trajectory(found['ground_truth.tum']) if 'ground_truth.tum' in found else None,
        read_planes(found['scene.json']) if 'scene.json' in found else None,
        read_table(found['movers.csv'], MOVER_COLUMNS) if 'movers.csv' in found else None,
        read_labels(found['truth_labels.npz']) if 'truth_labels.npz' in found else None)


def read_planes(path: Path) -> list[TruePlane]:
    """Return the planes of a scene.json."""
    try:
        content = json.loads(path.read_text())
        return [TruePlane(int(plane['id']), str(plane.get('name', plane['id'])),
                          np.array(plane['normal'], float), float(plane['depth']))
                for plane in content['planes']]
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise UnusableInput(f'{path} is not a scene file: {error!r}') from None


def read_labels(path: str | Path) -> LabelTable:
    """Return the labels of a labels.npz or truth_labels.npz."""
    content = read_arrays(path, ('stamp', 'x', 'y', 'label', 'plane'), ('stamp_ns',))
    stamps = content.get('stamp_ns')
    if stamps is None:  # as the simulator writes it
        stamps = np.round(content['stamp'] * 1e9).astype(np.int64)
    return LabelTable(stamps, content['x'], content['y'], content['label'].astype(int),
                      content['plane'].astype(int))


def read_arrays(path: str | Path, names: tuple[str, ...],
                optional: tuple[str, ...] = ()) -> dict[str, np.ndarray]:
    """Return named arrays of an .npz file, or raise UnusableInput."""
    try:
        with np.load(path, allow_pickle=False) as archive:
            return {name: archive[name] for name in (
                *names, *(name for name in optional if name in archive))}
    except (OSError, ValueError, KeyError) as error:
        raise UnusableInput(f'{path} does not hold the arrays {", ".join(names)}: {error}'
                            ) from None


def on_common_blocks(a: LabelTable, b: LabelTable) -> tuple[LabelTable, LabelTable]:
    """Return two tables cut to the macroblocks that both have, in the same order."""
    places = {(x, y): i for i, (x, y) in enumerate(zip(b.x, b.y, strict=True))}
    pairs = [(i, places[x, y]) for i, (x, y) in enumerate(zip(a.x, a.y, strict=True))
             if (x, y) in places]
    of_a, of_b = np.array(pairs, int).reshape(-1, 2).T
    return _cut(a, of_a), _cut(b, of_b)


def _cut(table: LabelTable, index: np.ndarray) -> LabelTable:
    return LabelTable(table.stamps, table.x[index], table.y[index], table.label[:, index],
                      table.plane[:, index])
