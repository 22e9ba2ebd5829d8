"""Which recordings are run, and how: from files, bags, folders, globs and tables."""

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
import csv
from dataclasses import asdict, dataclass, field, replace
from glob import glob, has_magic
from hashlib import sha256
from itertools import product
import json
import os
from pathlib import Path
import re
from typing import Any

from mv_slapse.config import Settings
from mv_slapse.errors import UnusableInput, UsageError
from mv_slapse.storage import picture_folder
from mv_slapse.storage.bag_reader import SUFFIXES as BAGS
from mv_slapse.storage.whole_files import PART
from mv_slapse.tools import settings_arguments
from mv_slapse.tools.batch.places import is_left

VIDEOS = ('.264', '.3gp', '.avi', '.flv', '.h264', '.m2ts', '.m2v', '.m4v', '.mkv', '.mov', '.mp4',
          '.mpeg', '.mpg', '.mts', '.ts')
TABLE = '.csv'
METADATA = 'metadata.yaml'  # what makes a folder one bag
RESULTS = 'results.mcap'  # of a run; no recording
FILES = ('camera', 'speed', 'ground_truth')  # columns that name files
COLUMNS = ('input', *FILES, 'topic', 'max_frames', 'name', 'camera_height', 'settings')
LONGEST = 120  # characters of a folder's name; file systems take 255 bytes


@dataclass(frozen=True)
class Recording:
    """One run.

    Attributes
    ----------
    input : str
        File or bag.
    name : str
        Of its folder of results.
    camera, speed, ground_truth, topic : str
        As ``run`` and ``eval`` take them; empty: not given.
    max_frames : int
        0 takes all.
    settings : Settings
    swept : str
        The values that a sweep gave it.
    report : bool
        Whether each run writes its report.
    size : int
        Bytes of the input; the larger ones are run first.
    code : str
        State of the code that runs it.
    key : str
        Differs where the input, a file beside it, the settings or the code differ.
    """

    input: str
    name: str = ''
    camera: str = ''
    speed: str = ''
    ground_truth: str = ''
    topic: str = ''
    max_frames: int = 0
    settings: Settings = field(default_factory=Settings)
    swept: str = ''
    report: bool = True
    size: int = 0
    code: str = ''
    key: str = ''


def recordings(inputs: Sequence[str], like: Recording, sweeps: Sequence[str], output: Path,
               code: str) -> list[Recording]:
    """Return the runs that some inputs and sweeps make, each with a name of its own.

    Parameters
    ----------
    like : Recording
        What holds for all inputs that do not say otherwise.
    sweeps : sequence of str
        ``section.name=value,value``: each multiplies the runs.
    output : Path
        Not looked for recordings; an input that is this folder, or what a batch has left in it,
        is passed over, as a pattern may match it, too.
    code : str
        Names the state of the code.

    Raises
    ------
    UsageError, UnusableInput
        Where an input does not exist, holds no recording, or a table is wrong.
    """
    output = output.resolve()
    found = [item for text in inputs for item in _found(text, like, output)]
    if not found:
        raise UsageError(f'{", ".join(inputs)}: there is nothing but {output}, where the results '
                         'go; give recordings, or another folder with -o')
    settings = [list(_swept(text)) for text in sweeps]
    rows = [_with(item, values) for item in found for values in product(*settings)]
    return [_identified(row, code) for row in _named(rows)]


def _found(text: str, like: Recording, output: Path) -> Iterator[Recording]:
    paths = sorted(glob(text, recursive=True)) if has_magic(text) and not Path(text).exists() \
        else [text]
    if not paths:
        raise UsageError(f'nothing matches {text}; check the pattern')
    for path in map(Path, paths):
        if is_left(path, output):
            continue
        if not path.exists():
            raise UsageError(f'there is no {path}; give a video, bag, folder, pattern or table')
        if path.suffix == TABLE:
            yield from read_table(path, like)
        elif path.is_dir() and not _is_one(path):
            inside = sorted(item for item in _inside(path) if output not in item.resolve().parents)
            if not inside and path.resolve() not in (output, *output.parents):
                raise UsageError(f'{path} holds neither videos nor bags; give a pattern such as '
                                 f'{path}/*.xyz where their names end otherwise')
            yield from (replace(like, input=str(item), name=_slug(item.relative_to(path)))
                        for item in inside)
        else:
            yield replace(like, input=str(path), name=_slug(Path(path.resolve().name)))


def _is_one(folder: Path) -> bool:
    """Return whether a folder is one recording: a bag, or pictures with no videos beside them."""
    if (folder / METADATA).exists():
        return True
    if any(_is_file_of_one(path) for path in folder.iterdir()):
        return False
    try:
        return bool(picture_folder.entries(str(folder), 1.0))
    except UnusableInput:
        return False


def _is_file_of_one(path: Path) -> bool:
    return path.suffix.lower() in VIDEOS + BAGS and path.name != RESULTS and path.is_file()


def _inside(folder: Path) -> Iterator[Path]:
    """Yield the recordings below a folder; what a bag's folder holds is not looked at."""
    for path in folder.iterdir():
        if path.is_dir():
            if _is_one(path):
                yield path
            else:
                yield from _inside(path)
        elif _is_file_of_one(path):
            yield path


def read_table(path: Path, like: Recording) -> Iterator[Recording]:
    """Yield the runs of a table, a row each; its files are looked for beside it.

    Raises
    ------
    UsageError
        Naming the row and what is wrong with it.
    """
    try:
        with path.open(newline='', encoding='utf-8-sig') as file:
            rows = list(csv.DictReader(file, skipinitialspace=True))
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise UnusableInput(f'{path} cannot be read as a table of recordings: {error}') from None
    if not rows or 'input' not in rows[0]:
        raise UsageError(f'{path} is not a table of recordings; its first line names the columns: '
                         f'input, and any of {", ".join(COLUMNS[1:])}, section.name of a setting')
    for number, row in enumerate(rows, 2):
        try:
            yield _of_row(row, path.parent, like)
        except UsageError as error:
            raise UsageError(f'{path}, line {number}: {error}') from None


def _of_row(row: Mapping[str | None, Any], folder: Path, like: Recording) -> Recording:
    if None in row or None in row.values():
        raise UsageError('it has not as many values as the first line has names')
    given = {name.strip(): value.strip() for name, value in row.items() if value.strip()}
    unknown = [name for name in given if name not in COLUMNS and '.' not in name]
    if unknown:
        raise UsageError(f'there is no column {unknown[0]}; there are {", ".join(COLUMNS)} and '
                         'section.name of a setting')
    if 'input' not in given:
        raise UsageError('it names no input')
    files = {name: _beside(folder, given[name], name) for name in FILES if name in given}
    name = given.get('name') or Path(given['input']).name
    return replace(
        like, **files, input=_beside(folder, given['input']), name=_slug(Path(name)),
        topic=given.get('topic', like.topic), max_frames=_count(given, like.max_frames),
        settings=_settings(given, folder, like.settings))


def _beside(folder: Path, text: str, column: str = 'input') -> str:
    """Return a file named in a table; topics and URLs stay what they are."""
    path = str(folder / text)
    return text if '://' in text or _is_topic(path, column) else path


def _is_topic(path: str, column: str) -> bool:
    """Return whether a text names a topic, as ``run`` takes it: where there is no such file."""
    return column == 'speed' and not os.path.isfile(path)


def _count(given: Mapping[str, str], default: int) -> int:
    text = given.get('max_frames', str(default))
    if not text.isdecimal() or len(text) > 9:
        raise UsageError(f'max_frames is no whole number below 10^9: {text!r}')
    return int(text)


def _settings(given: Mapping[str, str], folder: Path, settings: Settings) -> Settings:
    if 'settings' in given:
        settings = settings_arguments.read_settings(folder / given['settings'], settings)
    values = {'scene.camera_height': given['camera_height']} if 'camera_height' in given else {}
    values |= {name: value for name, value in given.items() if '.' in name}
    return settings_arguments.override(settings, (f'{name}={value}'
                                                  for name, value in values.items()))


def _swept(text: str) -> Iterator[str]:
    name, equals, values = text.partition('=')
    if not equals or not values:
        raise UsageError(f'--sweep {text!r}: write it as section.name=value,value')
    # a tuple's commas are its own
    for value in re.split(r',(?![^(\[]*[)\]])', values):
        yield f'{name.strip()}={value.strip()}'


def _with(recording: Recording, values: Sequence[str]) -> Recording:
    if not values:
        return recording
    settings = settings_arguments.override(recording.settings, values)
    short = ','.join(value.partition('.')[2] for value in values)
    return replace(recording, settings=settings, swept=' '.join(values),
                   name=_slug(Path(f'{recording.name},{short}')))


def _slug(path: Path) -> str:
    """Return a name of a folder that tells a path."""
    name = re.sub(r'[^\w.,=+-]+', '-', str(path)).strip('-.').removesuffix(PART) or 'recording'
    return name if len(name) <= LONGEST else name[:LONGEST - 9] + '-' + _digest(name)[:8]


def _named(rows: Iterable[Recording]) -> list[Recording]:
    """Return runs of which no two have one name, and none stands there twice."""
    rows = list(dict.fromkeys(rows))
    taken = Counter(row.name for row in rows)
    return [row if taken[row.name] == 1 else
            replace(row, name=f'{row.name}-{_digest(repr(row))[:8]}') for row in rows]


def _identified(row: Recording, code: str) -> Recording:
    """Return a run with its size and its key, and with files that mean the same everywhere."""
    files = {name: _absolute(getattr(row, name), name) for name in ('input', *FILES)}
    stamps = [_stamp(file) for file in files.values()]
    row = replace(row, **files, size=stamps[0][0], code=code)
    said = replace(row, name='', swept='')
    return replace(row, key=_digest(json.dumps([asdict(said), stamps]))[:32])


def _absolute(path: str, column: str) -> str:
    is_file = path and '://' not in path and not _is_topic(path, column)
    return os.path.abspath(path) if is_file else path


def _stamp(path: str) -> tuple[int, int]:
    """Return size [bytes] and time of change [ns] of a file, or of all files of a folder."""
    if not path:
        return 0, 0
    place = Path(path)
    try:
        files = [place] if not place.is_dir() else [item for item in place.rglob('*')
                                                    if item.is_file()]
        stats = [item.stat() for item in files]
    except OSError:
        return 0, 0  # the run itself tells what is wrong with it
    return sum(stat.st_size for stat in stats), max((stat.st_mtime_ns for stat in stats),
                                                    default=0)


def _digest(text: str) -> str:
    return sha256(text.encode()).hexdigest()
