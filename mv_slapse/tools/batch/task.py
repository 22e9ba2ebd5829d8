"""One recording is one task: it runs what ``run`` runs and leaves the same folder, whole.

A folder grows beside its place under a name that ends in ``.part`` and is renamed when it is
whole, with ``row.json`` in it: what the run gave, and what it was run from. A worker that dies
leaves the folder that it had begun, so that the number of these is how often a run was begun.
"""

from collections.abc import Callable
from dataclasses import asdict
from functools import cache
from hashlib import sha256
import json
import os
from pathlib import Path
import shlex
import shutil
from typing import Any

from mv_slapse.config import Settings
from mv_slapse.errors import MvSlapseError, UnusableInput, UnusableOutput
from mv_slapse.storage import whole_files
from mv_slapse.storage.camera_info import read_camera
from mv_slapse.storage.tables import OBSTACLES_HEADER, read_table
from mv_slapse.storage.tum import read_trajectory
from mv_slapse.tools import run as running
from mv_slapse.tools import run_summary
from mv_slapse.tools.batch.manifest import Recording
from mv_slapse.tools.batch.places import BEGUN, check_replaceable, ROW
from mv_slapse.tools.batch.workers import worker_address
from mv_slapse.tools.eval import evaluate
from mv_slapse.tools.history import History
from mv_slapse.tools.inputs import read_speeds
from mv_slapse.tools.plain import plain
import numpy as np

TRIES = 3  # the first, and two more where its worker dies
DONE, LOST, FAILED, LEFT = 'done', 'lost', 'failed', 'not run'
FAULT, TRACKING_LOST, DIED = 1, 4, 6  # exit codes of a row, beside those of errors
SOURCES = ('.py', '.cpp', '.hpp')
NO_PART = {'nodes', 'launch', 'simulation', 'batch'}  # of what gives a run's results
SOON = 3.0  # s, time to contact of an obstacle that counts as a hazard

Row = dict[str, Any]


def run_recording(recording: Recording, output: str, call: str) -> Row:
    """Run a recording, unless it is done, and return its row.

    Parameters
    ----------
    output : str
        Folder of all runs.
    call : str
        Names the call of ``batch`` that asks; other calls' tries do not count.

    Raises
    ------
    UnusableOutput
        Where the folder cannot be written, or another one stands there that is no run's.
    """
    place = Path(output, recording.name)
    kept = kept_row(place, recording.key)
    if kept is not None and (is_finished(kept) or kept['call'] == call):
        return kept
    try:
        check_replaceable(place)
        part = _begun(place, call)
        if part is None:
            part, row = _last(place, call), _dead(recording, place, call)
        else:
            row = _row(recording, part)
        _write(part / ROW, row | {'call': call, 'key': recording.key})
        return _placed(part, place, recording.key)
    except OSError as error:
        raise whole_files.unusable(place, error) from error


@cache
def code() -> str:
    """Return a name of the code that runs: other files of the core give it another one."""
    package = Path(__file__).resolve().parents[2]
    digest = sha256()
    for path in sorted(package.rglob('*')):
        if path.suffix in SOURCES and NO_PART.isdisjoint(path.relative_to(package).parts):
            digest.update(str(path.relative_to(package)).encode() + path.read_bytes())
    return digest.hexdigest()[:16]


def kept_row(place: Path, key: str) -> Row | None:
    """Return the row of a folder that a run with this key has left, None where there is none."""
    try:
        row = json.loads((place / ROW).read_text())
        return row if row.pop('key') == key and row['call'] is not None else None
    except (OSError, ValueError, KeyError, TypeError):
        return None


def is_finished(row: Row) -> bool:
    """Return whether there is no need to run it again: a failed one is worth another try."""
    return row['status'] in (DONE, LOST)


def remains(output: Path, name: str = BEGUN) -> list[Path]:
    """Return the folders of runs that were not finished."""
    return [path for path in output.glob(f'{name}{whole_files.PART}') if path.is_dir()]


def _begun(place: Path, call: str) -> Path | None:
    """Make the folder of the next try and return it; None where there were enough."""
    for number in range(TRIES):
        part = whole_files.part_of(place.with_name(f'{place.name}.{call}-{number}'))
        try:
            part.mkdir(parents=True)
        except FileExistsError:
            continue
        _write(part / ROW, {'worker': worker_address(), 'call': None})
        return part
    return None


def _last(place: Path, call: str) -> Path:
    part = whole_files.part_of(place.with_name(f'{place.name}.{call}-{TRIES}'))
    part.mkdir(exist_ok=True)
    return part


def _dead(recording: Recording, place: Path, call: str) -> Row:
    """Return the row of a run whose workers died."""
    tried = [json.loads((part / ROW).read_text() or '{}').get('worker', '')
             for part in remains(place.parent, f'{place.name}.{call}-*') if (part / ROW).exists()]
    return empty_row(recording) | {
        'status': FAILED, 'exit_code': DIED, 'died_on': tried, 'worker': worker_address(),
        'reason': f'each of {TRIES} workers that ran it ended without a word: it needs more '
                  'memory than they have, or crashes them; run it alone to see which'}


def empty_row(recording: Recording) -> Row:
    """Return what is known of a run before it is run."""
    return {'name': recording.name, 'input': recording.input, 'swept': recording.swept,
            'status': LEFT, 'exit_code': None, 'reason': '',
            'ground_truth': recording.ground_truth}


def failed_row(recording: Recording, code: int, reason: str) -> Row:
    """Return the row of a run that came to nothing."""
    return empty_row(recording) | {'status': FAILED, 'exit_code': code, 'reason': reason}


def _row(recording: Recording, part: Path) -> Row:
    """Run, and return what came of it; a bad recording is a row, too."""
    row = empty_row(recording) | {'worker': worker_address()}
    try:
        if code() != recording.code:
            raise UnusableInput(f'worker {worker_address()} has another version of mv_slapse than '
                                'the call; give both the same')
        summary = _run(recording, part)
        row |= {'status': DONE, 'exit_code': 0} | _figures(summary, part)
        if summary.is_lost:
            row |= {'status': LOST, 'exit_code': TRACKING_LOST,
                    'reason': run_summary.lost_message(summary)}
        if recording.ground_truth:
            row['figures'] = plain(evaluate(part, recording.ground_truth))
            row |= _errors(row['figures'])
        return row
    except UnusableOutput:
        raise
    except MvSlapseError as error:
        return row | {'status': FAILED, 'exit_code': error.exit_code, 'reason': str(error)}
    except Exception as error:
        return row | {'status': FAILED, 'exit_code': FAULT,
                      'reason': f'a fault of mv_slapse: {type(error).__name__}: {error}'}


def _run(recording: Recording, part: Path) -> run_summary.Summary:
    camera = read_camera(recording.camera) if recording.camera else None
    speeds, warnings = (read_speeds(recording.speed, recording.input) if recording.speed
                        else ([], []))
    history = History()
    options = running.Options(recording.max_frames or None, recording.topic or None,
                              command(recording), speeds, history, warnings=warnings)
    summary = running.run(recording.input, camera, recording.settings, part, options)
    if recording.report:
        from mv_slapse.tools import run_report  # brings the plotting along
        run_report.write(part, summary.to_dict(), history)
    return summary


def command(recording: Recording) -> str:
    """Return the command that does the same."""
    words = ['mv_slapse', 'run', recording.input]
    for name in ('camera', 'speed', 'topic', 'max_frames'):
        if value := getattr(recording, name):
            words += [f'--{name.replace("_", "-")}', str(value)]
    default = asdict(Settings())
    for section, values in asdict(recording.settings).items():
        words += [word for name, value in values.items() if value != default[section][name]
                  for word in ('--set', f'{section}.{name}={value}')]
    words += [] if recording.report else ['--no-report']
    return shlex.join([*words, '-o', recording.name])


def _figures(summary: run_summary.Summary, part: Path) -> Row:
    path = read_trajectory(part / 'trajectory.tum').positions
    obstacles = read_table(part / 'obstacles.csv', OBSTACLES_HEADER)
    soon = (obstacles['state'] == 'confirmed') & (obstacles['ttc'] < SOON)
    return {
        'duration_s': summary.last_stamp - summary.first_stamp, 'frames': summary.frames,
        'way': float(np.linalg.norm(np.diff(path, axis=0), axis=1).sum()),
        'key_frames': summary.key_frames, 'poses': summary.poses,
        'lost_percent': 100 * (1 - summary.poses / max(summary.key_frames, 1)),
        'scale': summary.scale_status, 'scale_source': summary.scale_source,
        'planes': summary.planes, 'obstacles': summary.obstacles_confirmed,
        'hazards': len(np.unique(obstacles['id'][soon])),
        'cpu_ms': 1e3 * summary.cpu_seconds['total'] / max(summary.frames, 1),
        'warnings': summary.warnings}


def _errors(figures: Row) -> Row:
    """Return the errors of the positions: ATE [m], and as a share of the way."""
    return {'ate_m': figures.get('ate_mean_m'),
            'epsilon_d_percent': figures.get('epsilon_d_percent',
                                             figures.get('ate_mean_percent'))}


def _placed(part: Path, place: Path, key: str) -> Row:
    """Give a whole folder its place; an earlier run's goes, unless another worker was first."""
    aside = whole_files.part_of(part.with_suffix('.old'))
    while True:
        first = kept_row(place, key)
        if first is not None and is_finished(first):
            shutil.rmtree(part, ignore_errors=True)
            return first
        try:
            part.rename(place)
            break
        except OSError:
            if not place.exists():
                raise
            check_replaceable(place)
            os.replace(place, aside)
    shutil.rmtree(aside, ignore_errors=True)
    return kept_row(place, key) or {}


def _write(path: Path, row: Row):
    whole_files.write_text(path, json.dumps(plain(row), indent=1) + '\n')


Task = Callable[[Recording, str, str], Row]
