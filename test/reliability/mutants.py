"""Do the tests bite? Sixty mistakes, planted one after another in a copy, and the tests near by.

A mistake is caught where a test fails. What is planted stands in planted.py.
"""

import argparse
import os
from pathlib import Path
import shutil
import subprocess
import sys
import tempfile

from reliability.planted import PLANTED

ROOT = Path(__file__).resolve().parents[2]
COPIED = ('mv_slapse', 'test', 'benchmarks', 'config', 'msg_defs', 'docs', 'setup.cfg',
          'package.xml', 'README.md')
PATIENCE = 900  # s; a mistake that makes the tests hang is caught as well


def copy(folder: Path):
    """Copy what the tests read."""
    for name in COPIED:
        source = ROOT / name
        if source.is_dir():
            shutil.copytree(source, folder / name, symlinks=True,
                            ignore=shutil.ignore_patterns('__pycache__'))
        elif source.exists():
            shutil.copy(source, folder / name)


def is_caught(folder: Path, number: int) -> bool:
    """Plant a mistake in the copy, run its tests, and take it out again."""
    path, old, new, tests = PLANTED[number]
    whole = (folder / path).read_text()
    (folder / path).write_text(whole.replace(old, new))
    command = [sys.executable, '-m', 'pytest', '-q', '-x', '-p', 'no:cacheprovider',
               *(f'test/{name}' for name in tests.split())]
    environment = {**os.environ, 'PYTHONPATH': os.pathsep.join(
        [str(folder), str(folder / 'test'), os.environ.get('PYTHONPATH', '')])}
    try:
        done = subprocess.run(command, cwd=folder, env=environment, capture_output=True,
                              timeout=PATIENCE)
        if done.returncode > 1:
            raise RuntimeError(f'{tests} cannot be run: {done.stdout.decode()[-1000:]}')
        return done.returncode == 1
    except subprocess.TimeoutExpired:
        return True
    finally:
        (folder / path).write_text(whole)


def main() -> int:
    """Print each mistake that no test catches, and the share that is; 1 below nine tenths."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--every', type=int, default=1, help='plant each n-th only')
    parser.add_argument('--first', type=int, default=0)
    args = parser.parse_args()
    chosen = range(args.first, len(PLANTED), args.every)
    caught = 0
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        copy(folder)
        for number in chosen:
            found = is_caught(folder, number)
            caught += found
            path, old, new, _ = PLANTED[number]
            print(f'{number:2} {"caught" if found else "MISSED"} {path}: {old!r} -> {new!r}'[:140],
                  flush=True)
    print(f'{caught} of {len(chosen)} caught')
    return int(caught < 0.9 * len(chosen))


if __name__ == '__main__':
    sys.exit(main())
