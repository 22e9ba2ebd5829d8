"""What ``mv_slapse batch`` holds: speed, killed workers and calls, bad recordings, many rows.

Each proof prints its figures as a line of JSON and ends with an error where a bound is missed;
docs/batch.md has what they gave last. Recordings are rendered once and kept.
"""

import argparse
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
import csv
from itertools import product
import json
from pathlib import Path
import random
import shutil
import signal
import subprocess
import sys
import time
from typing import Any

from mv_slapse.codec.encoding.encoder import Encoding, write_video
from mv_slapse.config import SceneSettings, Settings
from mv_slapse.simulation.street import Street, StreetSettings
from mv_slapse.simulation.truth import film
from mv_slapse.storage.camera_info import read_camera, write_camera
from mv_slapse.tools import run as running
from mv_slapse.tools.batch import scheduling, task
from mv_slapse.tools.batch.manifest import Recording
from mv_slapse.tools.batch.workers import open_pool, Workers
import numpy as np
import psutil

SIZE = {'width': 480, 'height': 352, 'focal': 375.0, 'fps': 30.0}
CODINGS = {f'{name}-{quality}': Encoding(codec, b_frames, 12, options)
           for (name, codec, b_frames), (quality, options) in product(
               (('mpeg2', 'mpeg2video', 0), ('mpeg2b', 'mpeg2video', 2), ('h264', 'h264', 0)),
               (('good', {}), ('poor', {'b': '600000'})))}
FILES = ('trajectory.tum', 'planes.csv', 'obstacles.csv', 'labels.npz', 'map.json', 'results.mcap')
HEIGHT = '1.65'
LARGE = (7680, 4320)  # px of pictures that a worker of LIMIT cannot decode
LIMIT = '420MiB'
MANY = 10_000


def rendered(folder: Path, streets: int, frames: int, codings: int = len(CODINGS)) -> Path:
    """Return a folder of recordings, streets in some codings; made where it is missing."""
    place = folder / f'{streets}x{codings}x{frames}'
    if not place.exists():
        part = place.with_name(f'{place.name} part')
        shutil.rmtree(part, ignore_errors=True)
        (part / 'in').mkdir(parents=True)
        for seed in range(streets):
            street = Street(StreetSettings(seed=seed, n_frames=frames, **SIZE))
            pictures = list(film(street, part / 'truth'))
            for name, coding in [*CODINGS.items()][:codings]:
                write_video(part / 'in' / f'{seed}-{name}.mp4', pictures, SIZE['fps'], coding)
            write_camera(part / 'camera.yaml', street.camera)
        part.rename(place)
    return place


def command(place: Path, output: Path, *more: str) -> list[str]:
    """Return the call of ``mv_slapse batch`` over a folder of recordings."""
    return [sys.executable, '-m', 'mv_slapse', 'batch', str(place / 'in'), '--camera',
            str(place / 'camera.yaml'), '--camera-height', HEIGHT, '-o', str(output), '--quiet',
            *more]


def called(place: Path, output: Path, *more: str) -> tuple[int, float]:
    """Call ``mv_slapse batch``; return its exit code and how long it took [s]."""
    start = time.monotonic()
    done = subprocess.run(command(place, output, *more), check=False, stdout=subprocess.DEVNULL)
    return done.returncode, time.monotonic() - start


def table(output: Path) -> list[dict[str, str]]:
    """Return the rows of a batch."""
    with (output / 'batch.csv').open(newline='') as file:
        return list(csv.DictReader(file))


def stamps(output: Path) -> dict[str, int]:
    """Return when each finished folder was made."""
    return {path.parent.name: path.stat().st_mtime_ns for path in output.glob(f'*/{task.ROW}')
            if path.parent.suffix != '.part'}


def differing(place: Path, output: Path, work: Path, names: Iterable[str]) -> list[str]:
    """Return the files of some runs that differ from those of ``mv_slapse run``."""
    camera, found = read_camera(place / 'camera.yaml'), []
    settings = Settings(scene=SceneSettings(camera_height=float(HEIGHT)))
    for name in names:
        running.run(place / 'in' / name, camera, settings, work)
        found += [f'{name}/{file}' for file in FILES
                  if (work / file).read_bytes() != (output / name / file).read_bytes()]
    return found


def whole(output: Path, names: Iterable[str]) -> bool:
    """Return whether each run has one folder with all its files, and there is nothing else."""
    names = set(names)
    there = {path.name for path in output.iterdir() if path.is_dir()}
    return there == names and all((output / name / file).exists() for name in names
                                  for file in (*FILES, 'summary.json', task.ROW))


def speed(options: argparse.Namespace) -> dict[str, Any]:
    """60 recordings, two workers against one, by turns; the files of some against ``run``'s."""
    place, out = rendered(options.folder, 10, 300), options.folder / 'speed'
    taken: dict[int, list[float]] = {1: [], 2: []}
    loads = []
    for turn, n in product(range(options.turns), (1, 2)):
        shutil.rmtree(out / f'{n}', ignore_errors=True)
        loads.append(round(_others_load(), 2))
        code, seconds = called(place, out / f'{n}', '--workers', f'{n}')
        assert code in (0, 5), code
        taken[n].append(round(seconds, 2))
        print(f'turn {turn}, {n} workers: {seconds:.1f} s, others use {loads[-1]} cores before',
              file=sys.stderr, flush=True)
    names = sorted(path.name for path in (place / 'in').iterdir())
    ratio = min(taken[1]) / min(taken[2])
    return {'recordings': len(names), 'one': taken[1], 'two': taken[2],
            'faster': round(ratio, 3), 'others': loads,
            'differing': differing(place, out / '2', out / 'alone', names[::7]),
            'holds': ratio >= 1.8 and len(names) == 60}


def _others_load(seconds: float = 2.0) -> float:
    """Return how many cores others use now."""
    return psutil.cpu_percent(seconds) / 100 * psutil.cpu_count()


def workers_killed(options: argparse.Namespace) -> dict[str, Any]:
    """SIGKILL of a worker at ten moments, each of another batch."""
    place, rng, bad = rendered(options.folder, 2, 90), random.Random(0), []
    names = sorted(path.name for path in (place / 'in').iterdir())
    for moment in range(options.moments):
        out = options.folder / f'worker-{moment}'
        shutil.rmtree(out, ignore_errors=True)
        process = subprocess.Popen(command(place, out, '--workers', '2'))
        _wait_until(process, out, moment)
        time.sleep(rng.uniform(0, 1.0))
        victims = [child for child in psutil.Process(process.pid).children(recursive=True)
                   if 'spawn_main' in ' '.join(child.cmdline())] if process.poll() is None else []
        before = stamps(out)
        if victims:
            rng.choice(victims).kill()
        code = process.wait()
        bad += _wrong(out, names, code, before, moment)
        shutil.rmtree(out)
    return {'moments': options.moments, 'recordings': len(names), 'wrong': bad, 'holds': not bad}


def calls_killed(options: argparse.Namespace) -> dict[str, Any]:
    """SIGKILL of the whole call at ten moments, and a second call."""
    place, rng, bad = rendered(options.folder, 2, 90), random.Random(1), []
    names, done_before = sorted(path.name for path in (place / 'in').iterdir()), []
    for moment in range(options.moments):
        out = options.folder / f'call-{moment}'
        shutil.rmtree(out, ignore_errors=True)
        process = subprocess.Popen(command(place, out, '--workers', '2'))
        _wait_until(process, out, moment)
        time.sleep(rng.uniform(0, 1.0))
        workers = psutil.Process(process.pid).children(recursive=True)
        process.send_signal(signal.SIGKILL)
        process.wait()
        psutil.wait_procs(workers, 30)
        before = stamps(out)
        done_before.append(len(before))
        half = [name for name in before if not all(
            (out / name / file).exists() for file in (*FILES, 'summary.json'))]
        code, _ = called(place, out, '--workers', '2')
        bad += half + _wrong(out, names, code, before, moment)
        shutil.rmtree(out)
    return {'moments': options.moments, 'recordings': len(names), 'done_before': done_before,
            'wrong': bad, 'holds': not bad}


def _wrong(out: Path, names: list[str], code: int, before: dict[str, int], moment: int
           ) -> list[str]:
    """Return what is wrong with a batch that was to survive."""
    rows, after = table(out), stamps(out)
    findings = {'exit code': code != 0, 'rows': sorted(row['name'] for row in rows) != names,
                'status': any(row['status'] != task.DONE for row in rows),
                'folders': not whole(out, names),
                'run twice': any(after[name] != stamp for name, stamp in before.items())}
    return [f'{moment}: {name}' for name, is_so in findings.items() if is_so]


def _wait_until(process: subprocess.Popen, out: Path, n_done: int):
    """Wait until a batch has done so many runs, or has ended."""
    _wait_for(lambda: process.poll() is not None or out.exists() and len(stamps(out)) >= n_done)


def _wait_for(condition: Callable[[], bool], seconds: float = 300.0):
    end = time.monotonic() + seconds
    while not condition():
        if time.monotonic() > end:
            raise TimeoutError
        time.sleep(0.02)


def bad_recordings(options: argparse.Namespace) -> dict[str, Any]:
    """Three broken recordings, and one that exceeds the worker's memory, among twenty."""
    source, place = rendered(options.folder, 3, 90), options.folder / 'bad'
    if not place.exists():
        (part := place.with_name('bad part')).mkdir(exist_ok=True)
        (part / 'in').mkdir(exist_ok=True)
        shutil.copy(source / 'camera.yaml', part)
        for path in sorted((source / 'in').iterdir())[:16]:
            shutil.copy(path, part / 'in')
        some = (part / 'in' / path.name).read_bytes()
        (part / 'in' / 'broken-text.mp4').write_text('no video')
        (part / 'in' / 'broken-empty.mp4').write_bytes(b'')
        (part / 'in' / 'broken-cut.mp4').write_bytes(some[:len(some) // 2])
        _write_large(part)
        part.rename(place)
    out = options.folder / 'bad-out'
    shutil.rmtree(out, ignore_errors=True)
    large = place / 'large.csv'
    rows = [[str(path), str(place / 'camera.yaml'), HEIGHT]
            for path in sorted((place / 'in').iterdir())]
    rows.append([str(place / 'large.mp4'), str(place / 'large.yaml'), ''])
    large.write_text('\n'.join(','.join(row) for row in
                               [['input', 'camera', 'camera_height'], *rows]) + '\n')
    done = subprocess.run([sys.executable, '-m', 'mv_slapse', 'batch', str(large), '-o', str(out),
                           '--quiet', '--workers', '2', '--memory-limit', LIMIT], check=False)
    failed = {row['name']: f'{row["exit_code"]}: {row["reason"]}' for row in table(out)
              if row['status'] == task.FAILED}
    n_done = sum(row['status'] == task.DONE for row in table(out))
    return {'exit_code': done.returncode, 'done': n_done, 'failed': failed,
            'holds': done.returncode == 5 and n_done == 16 and len(failed) == 4 and
            all(failed.values()) and failed['large.mp4'].startswith(f'{task.DIED}: it takes more')}


def _write_large(folder: Path):
    """Write a recording of pictures so large that they alone take hundreds of megabytes."""
    width, height = LARGE
    scene = np.random.default_rng(0).integers(0, 256, (height // 32, width // 32 + 2), np.uint8)
    scene = np.kron(scene, np.ones((32, 32), np.uint8))
    write_video(folder / 'large.mp4', (scene[:, 4 * i:4 * i + width] for i in range(12)), 10.0,
                Encoding('h264', 0, 30, {'preset': 'ultrafast'}))
    from mv_slapse.geometry.camera import Camera
    K = np.array([[0.8 * width, 0, width / 2], [0, 0.8 * width, height / 2], [0, 0, 1]])
    write_camera(folder / 'large.yaml', Camera(width, height, K))


def simulated(item: Recording, output: str, call: str) -> task.Row:
    """Return the row of a run of one frame that costs nothing."""
    return task.empty_row(item) | {'status': task.DONE, 'exit_code': 0, 'frames': 1,
                                   'duration_s': 0.0, 'lost_percent': 0.0, 'cpu_ms': 0.0}


def many_rows(options: argparse.Namespace) -> dict[str, Any]:
    """10,000 rows of one frame: what scheduler and client take for each, and their memory."""
    items = [Recording(f'{i}.mp4', f'{i}.mp4') for i in range(MANY)]
    memory, count = [], 0
    with open_pool(Workers(2)) as pool:
        for row in scheduling.run_all(items[:100], Path('.'), pool, simulated):
            count += row['status'] == task.DONE
        start, wall, count = time.process_time(), time.monotonic(), 0
        for i, row in enumerate(scheduling.run_all(items, Path('.'), pool, simulated)):
            count += row['status'] == task.DONE
            if i % 1000 == 0:
                memory.append(psutil.Process().memory_info().rss >> 10)
        cpu, wall = time.process_time() - start, time.monotonic() - wall
    share = 1e3 * cpu / MANY
    growth = memory[-1] / memory[1] - 1
    return {'rows': count, 'cpu_ms_a_row': round(share, 3), 'wall_ms_a_row':
            round(1e3 * wall / MANY, 3), 'memory_MiB': [round(kib / 1024, 1) for kib in memory],
            'growth': round(growth, 4), 'holds': count == MANY and share <= 5 and growth < 0.1}


@contextmanager
def by_hand(folder: Path, n_workers: int = 2) -> Iterator[str]:
    """Start a scheduler and workers on loopback, as a user would, and give the address."""
    file = folder / 'scheduler.json'
    file.unlink(missing_ok=True)
    dask = [sys.executable, '-m', 'dask']
    quiet = {'stdout': subprocess.DEVNULL, 'stderr': subprocess.DEVNULL}
    processes = [subprocess.Popen([*dask, 'scheduler', '--host', '127.0.0.1', '--port', '0',
                                   '--no-dashboard', '--scheduler-file', str(file)], **quiet)]
    try:
        processes += [subprocess.Popen([*dask, 'worker', '--scheduler-file', str(file),
                                        '--nthreads', '1', '--no-dashboard', '--host',
                                        '127.0.0.1'], **quiet) for _ in range(n_workers)]
        _wait_for(file.exists)
        yield json.loads(file.read_text())['address']
    finally:
        for process in reversed(processes):
            process.terminate()
        for process in processes:
            process.wait()


def scheduler_by_hand(options: argparse.Namespace) -> dict[str, Any]:
    """Two workers and a scheduler started by hand: the same result by ``--scheduler``."""
    place, out = rendered(options.folder, 2, 90), options.folder / 'hand'
    shutil.rmtree(out, ignore_errors=True)
    names = sorted(path.name for path in (place / 'in').iterdir())
    with by_hand(options.folder) as address:
        code, _ = called(place, out, '--scheduler', address)
    found = differing(place, out, options.folder / 'alone', names)
    workers = {row['worker'] for row in table(out)}
    return {'exit_code': code, 'recordings': len(names), 'workers': len(workers),
            'differing': found, 'holds': code == 0 and not found and whole(out, names)
            and len(workers) == 2}


PROOFS = {'kills': workers_killed, 'calls': calls_killed, 'bad': bad_recordings,
          'rows': many_rows, 'hand': scheduler_by_hand, 'speed': speed}


def main(arguments: list[str] | None = None) -> int:
    """Give the proofs that are asked for, and return 1 where one does not hold."""
    parser = argparse.ArgumentParser(prog='batch.py', description=__doc__,
                                     formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument('proofs', nargs='*', choices=[[], *PROOFS], default=[],
                        help='default: all')
    parser.add_argument('--folder', type=Path, default=Path('out/batch'))
    parser.add_argument('--moments', type=int, default=10, help='at which something is killed')
    parser.add_argument('--turns', type=int, default=2, help='of the measurement of speed')
    options = parser.parse_args(arguments)
    options.folder = options.folder.resolve()
    options.folder.mkdir(parents=True, exist_ok=True)
    holds = True
    for name in options.proofs or PROOFS:
        found = PROOFS[name](options)
        print(json.dumps({'proof': name, **found}), flush=True)
        holds &= found['holds']
    return 0 if holds else 1


if __name__ == '__main__':
    sys.exit(main())
