"""Pictures of a folder with their times, in the layouts of public data sets.

Known are KITTI odometry (``image_0/000000.png``, ``times.txt`` beside it), KITTI raw
(``image_00/data``, ``timestamps.txt``), EuRoC (``mav0/cam0/data.csv``), TUM RGB-D (``rgb.txt``),
and any folder of pictures, in the order of their names, numbers by their value, which then need a
rate.
"""

from collections import Counter
from collections.abc import Callable, Iterator
import csv
from datetime import datetime, UTC
from fnmatch import fnmatch
from itertools import pairwise
import os
from pathlib import Path
import re
from typing import NamedTuple

import cv2
from mv_slapse.codec.frames import MAX_PIXELS
from mv_slapse.codec.packet import Picture
from mv_slapse.errors import UnusableInput
from mv_slapse.picture_size import size_of_still
from mv_slapse.storage.tum import parse_stamp
import numpy as np

SUFFIXES = ('.png', '.jpg', '.jpeg', '.pgm', '.ppm', '.bmp', '.tif', '.tiff', '.webp')
# The camera of a data set's folder, where it is named as a whole: the first that there is.
CAMERAS = ('mav0/cam0', 'image_0', 'image_00', 'image_2', 'image_02', 'cam0')
PICTURES = ('data', 'rgb')
NUMBER = re.compile(r'%0?\d*d')
DIGITS = re.compile('([0-9]+)')
LONGEST_STEP = 10_000_000_000_000  # [ns] between pictures; milliseconds taken for seconds are less


class Entry(NamedTuple):
    """A picture's file and its time [ns]."""

    path: Path
    stamp: int


def is_folder(name: str) -> bool:
    """Return whether an input names a folder of pictures, or a pattern such as ``a/%06d.png``.

    What exists under such a name is no pattern.
    """
    return '://' not in name and (os.path.isdir(name) or _is_pattern(name))


def entries(name: str, rate: float = 0.0) -> list[Entry]:
    """Return the pictures of a folder, or of a pattern, in the order of time.

    Parameters
    ----------
    rate : float
        Of pictures that come without times [1/s]; 0 where it is not known.

    Raises
    ------
    UnusableInput
        Where there are no pictures, or no times of them and no rate; where times and pictures
        are not as many.
    """
    try:
        found = _entries(name, rate)
    except (OSError, ValueError, ArithmeticError, IndexError, csv.Error) as error:
        raise UnusableInput(f'{name} cannot be read as a folder of pictures: {error}') from error
    if not found:
        raise UnusableInput(f'{name}: no pictures there ({", ".join(SUFFIXES)}); give a folder '
                            'that holds them, or a video')
    return sorted(found, key=lambda entry: entry.stamp)


def _entries(name: str, rate: float) -> list[Entry]:
    path, pattern = Path(name), '*'
    if _is_pattern(name):
        path, pattern = path.parent, NUMBER.sub('*', path.name)
    folder = _camera(path)
    listed = _listed(folder)
    if listed is None:
        listed = _by_name(folder, pattern, rate)
    return listed


def pictures(found: list[Entry]) -> Iterator[Picture]:
    """Yield the pictures in grey.

    Raises
    ------
    UnusableInput
        Where one cannot be read, or says that it is larger than any camera's.
    """
    for path, stamp in found:
        try:
            data = path.read_bytes()
        except OSError as error:
            raise UnusableInput(f'{path} cannot be read: {error}') from error
        width, height = size_of_still(data) or (0, 0)  # before memory is taken for it
        image = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_GRAYSCALE) if (
            data and width * height <= MAX_PIXELS) else None
        if image is None:
            raise UnusableInput(f'{path} is no picture that can be read; is it whole?')
        yield Picture(image, stamp)


def warning(found: list[Entry]) -> str:
    """Return what the names of pictures show to be wrong with them, else an empty text."""
    return '; '.join(filter(None, [_doubles(found), _gaps(found)]))


def _doubles(found: list[Entry]) -> str:
    counts = Counter(path.with_suffix('') for path, _ in found)
    doubles = [path for path, count in counts.items() if count > 1]
    if not doubles:
        return ''
    return (f'{len(doubles)} pictures are there with more than one suffix, the first is '
            f'{doubles[0]}, and count as often; choose one kind by a pattern such as '
            f'{doubles[0].parent}/%06d.png')


def _gaps(found: list[Entry]) -> str:
    """Tell of numbers that are left out, where the names differ in one number."""
    names = [DIGITS.split(path.stem) for path, _ in found]
    if min(map(len, names)) < 3 or len({(*name[:-2], name[-1]) for name in names}) > 1:
        return ''
    numbers = sorted({int(name[-2]) for name in names})
    steps = [b - a for a, b in pairwise(numbers)]
    usual = min(steps, default=1)
    gaps = [number for number, step in zip(numbers, steps, strict=False) if step > usual]
    if not 0 < len(gaps) < len(steps) / 2:
        return ''
    return (f'{found[0].path.parent}: the names of the pictures leave out numbers, first after '
            f'{gaps[0]}; where pictures are missing, the times that a rate gives to the later '
            'ones are too early')


def _is_pattern(name: str) -> bool:
    return bool(NUMBER.search(Path(name).name)) and not os.path.exists(name)


def _in_order(path: Path) -> tuple[list[str | int], str]:
    """Return a key by which 2 comes before 10, and 02 beside 2."""
    parts = DIGITS.split(path.stem)
    return [int(part) if i % 2 else part for i, part in enumerate(parts)], path.name


def _camera(folder: Path) -> Path:
    """Return the folder of one camera in a data set's folder."""
    return next((folder / name for name in CAMERAS if (folder / name).is_dir()), folder)


def _listed(folder: Path) -> list[Entry] | None:
    """Return the pictures that a table beside them names; None where there is none."""
    for table in (folder / 'data.csv', folder.parent / 'data.csv'):
        if table.is_file():
            with table.open(newline='') as rows:
                return [Entry(table.parent / 'data' / row[1].strip(), int(row[0]))
                        for row in csv.reader(rows) if row and not row[0].startswith('#')]
    for table in (folder / 'rgb.txt', folder.parent / 'rgb.txt'):
        if table.is_file():
            lines = [line.split() for line in table.read_text().splitlines()]
            return [Entry(table.parent / line[1], parse_stamp(line[0]))
                    for line in lines if len(line) > 1 and not line[0].startswith('#')]
    return None


def _by_name(folder: Path, pattern: str, rate: float) -> list[Entry]:
    inner = next((folder / name for name in PICTURES if (folder / name).is_dir()), folder)
    paths = sorted((path for path in (inner.iterdir() if inner.is_dir() else ())
                    if path.suffix.lower() in SUFFIXES and not path.name.startswith('.')
                    and fnmatch(path.name, pattern)), key=_in_order)
    stamps = _times([inner, folder, folder.parent])
    if stamps is None:
        if paths and rate <= 0:
            raise UnusableInput(f'{folder}: no times of its pictures (times.txt, timestamps.txt, '
                                'data.csv, rgb.txt); give their rate: --set encoder.rate=30')
        stamps = [round(i * 1e9 / rate) for i in range(len(paths))]
    if paths and len(stamps) != len(paths):
        raise UnusableInput(f'{inner}: {len(paths)} pictures and {len(stamps)} times; each '
                            'picture needs one line')
    return [Entry(*pair) for pair in zip(paths, stamps, strict=False)]


def _times(folders: list[Path]) -> list[int] | None:
    """Return the times [ns] of a table with one line for each picture."""
    for folder in folders:
        for name, parse in (('times.txt', parse_stamp), ('timestamps.txt', _date)):
            if (folder / name).is_file():
                return _parsed(folder / name, parse)
    return None


def _parsed(table: Path, parse: Callable[[str], int]) -> list[int]:
    """Return the times [ns] of a table; UnusableInput names the line that is none."""
    stamps = []
    for number, line in enumerate(table.read_text().split('\n'), 1):
        try:
            stamps += [parse(line.strip())] if line.strip() else []
        except (ValueError, ArithmeticError):
            raise UnusableInput(f'{table}, line {number}: {line.strip()[:40]!r} is no time; give '
                                'seconds, one line for each picture') from None
    step = np.median(np.abs(np.diff(np.array(stamps, float)))) if len(stamps) > 1 else 0.0
    if step > LONGEST_STEP:
        raise UnusableInput(f'{table}: the times are {step / 1e9:g} s apart; give seconds, '
                            'not nanoseconds or microseconds')
    return stamps


def _date(text: str) -> int:
    """Return the time [ns] of a date with nanoseconds, as KITTI raw has it, or of seconds."""
    day, dot, fraction = text.partition('.')
    if '-' not in day:
        return parse_stamp(text)
    seconds = datetime.fromisoformat(day).replace(tzinfo=UTC).timestamp()
    return int(seconds) * 10**9 + int(fraction[:9].ljust(9, '0') or 0)
