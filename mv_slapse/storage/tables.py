"""Rows of ``planes.csv`` and ``obstacles.csv``, written and read."""

from collections.abc import Callable, Iterable, Iterator
import csv
from pathlib import Path

from mv_slapse.errors import UnusableInput
from mv_slapse.fields import MAX_SPEED
from mv_slapse.records import Obstacle, SceneEstimate, Speed
from mv_slapse.storage import whole_files
from mv_slapse.storage.tum import format_stamp, parse_stamp
import numpy as np

PLANES_HEADER = 'stamp,id,nx,ny,nz,d,n_macroblocks'
SPEEDS_HEADER = 'stamp,speed'
OBSTACLES_HEADER = ('stamp,id,state,x,y,width,height,px,py,pz,vx,vy,vz,ttc,n_macroblocks')


def plane_rows(scene: SceneEstimate) -> Iterator[str]:
    """Yield a row for each plane seen in the key frame, in its camera's frame, d >= 0."""
    for plane in scene.planes:
        if not plane.n_macroblocks:
            continue
        normal = scene.R_world_from_cam.T @ plane.normal
        depth = plane.depth + plane.normal @ scene.t_world_from_cam
        sign = -1.0 if depth < 0 else 1.0
        scale = sign / np.linalg.norm(normal)
        values = _numbers(np.r_[scale * normal, scale * depth])
        yield f'{format_stamp(scene.stamp)},{plane.id},{values},{plane.n_macroblocks}'


def obstacle_row(obstacle: Obstacle) -> str:
    """Return the row of an obstacle: box in px, position and velocity in {W}."""
    o = obstacle
    values = _numbers([*o.box, *o.position, *o.velocity, o.time_to_contact])
    return (f'{format_stamp(o.stamp)},{o.id},{o.state.name.lower()},{values},{o.n_macroblocks}')


def write_speeds(path: str | Path, speeds: Iterable[Speed]):
    """Write speeds [m/s] as a table of stamps [s] and values."""
    rows = [f'{format_stamp(speed.stamp)},{speed.value:.9g}' for speed in speeds]
    whole_files.write_text(path, '\n'.join([SPEEDS_HEADER, *rows]) + '\n')


def read_speeds(path: str | Path) -> list[Speed]:
    """Return the speeds [m/s] of a table with the columns stamp [s] and speed.

    Raises
    ------
    UnusableInput
        As ``read_table`` does, and where a speed is not finite or beyond MAX_SPEED.
    """
    table = read_table(path, SPEEDS_HEADER)
    for k in np.flatnonzero(~(np.abs(table['speed']) <= MAX_SPEED)):
        raise UnusableInput(f'{path}: the speed at stamp {format_stamp(table["stamp"][k])} is '
                            f'{table["speed"][k]:g} m/s, which no vehicle has (at most '
                            f'{MAX_SPEED:g}); correct it, or leave the row out')
    return [Speed(int(stamp), float(value))
            for stamp, value in zip(table['stamp'], table['speed'], strict=True)]


def read_table(path: str | Path, required: str) -> dict[str, np.ndarray]:
    """Return the columns of a CSV file by name; ``stamp`` as ns, texts as str, else float64.

    Raises
    ------
    UnusableInput
        Where the file cannot be read, a required column (comma-separated names) is missing, a
        row has another number of values, or a value is no number.
    """
    try:
        with Path(path).open(newline='', encoding='utf-8-sig') as file:
            rows = list(csv.reader(file))
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise UnusableInput(f'{path} cannot be read as a table: {error}') from None
    names = [name.strip() for name in rows[0]] if rows else []
    missing = [name for name in required.split(',') if name not in names]
    if missing:
        raise UnusableInput(f'{path}: no column {", ".join(missing)}; expected {required}')
    body = []
    for number, row in enumerate(rows[1:], 2):
        if len(row) == len(names):
            body.append(row)
        elif any(value.strip() for value in row):
            raise UnusableInput(f'{path}: row {number} has {len(row)} values for {len(names)} '
                                'columns; mend it, or leave it out')
    columns = zip(*body, strict=True) if body else [()] * len(names)
    return {name: _column(path, name, values)
            for name, values in zip(names, columns, strict=True)}


def _column(path: str | Path, name: str, values: tuple[str, ...]) -> np.ndarray:
    if name in ('state', 'name'):
        return np.array(values, str)
    convert: Callable = parse_stamp if name == 'stamp' else float
    numbers = []
    for value in values:
        try:
            numbers.append(convert(value))
        except (ValueError, ArithmeticError):
            cure = ' of seconds; stamps are in seconds' if name == 'stamp' else ''
            raise UnusableInput(f'{path}: a value in column {name} is not a number{cure}: '
                                f'{value[:40]!r}') from None
    return np.array(numbers, np.int64 if name == 'stamp' else float)


def _numbers(values: np.ndarray | list) -> str:
    return ','.join(f'{value:.9g}' for value in values)
