"""The wheel: what it holds, and its kernels' tests with memory and arithmetic watched.

One compilation serves both: the wheel is built, as a user gets it, from the archive of sources,
with the sanitizers of the compiler where it has them.
"""

import os
from pathlib import Path
import shutil
import subprocess
import sys
import sysconfig
from typing import NamedTuple
import zipfile

import pytest

ROOT = Path(__file__).resolve().parents[1]
NOT_SHIPPED = ('test', 'docs', 'benchmarks')
BUILD = """
import os, shutil, sys, setuptools.build_meta as b
folder = sys.argv[1]  # setuptools changes it
os.chdir(folder + '/source')
name = b.build_sdist(folder)
os.chdir(folder)
shutil.unpack_archive(name)
os.chdir(name.removesuffix('.tar.gz'))
b.build_wheel(folder)
"""


class Wheel(NamedTuple):
    """A wheel, where it is unpacked, and the environment in which Python loads what it holds."""

    path: Path
    site: Path
    env: dict
    watched: bool  # compiled with sanitizers


def library(compiler: str, name: str) -> str:
    """Return the path of a library of the compiler; '' where it has none."""
    done = subprocess.run([compiler, f'-print-file-name={name}'], capture_output=True, text=True)
    path = done.stdout.strip()
    return os.path.realpath(path) if os.path.isabs(path) and os.path.exists(path) else ''


@pytest.fixture(scope='module')
def wheel(tmp_path_factory) -> Wheel:
    """Return the wheel of this clone's sources."""
    pytest.importorskip('pybind11')
    compiler = os.environ.get('CXX') or shutil.which('c++')
    if not compiler or not shutil.which('cmake'):
        pytest.skip('no C++ compiler or no CMake')
    names = subprocess.run(['git', 'ls-files', '-z', '--cached', '--others', '--exclude-standard'],
                           cwd=ROOT, capture_output=True, text=True)
    if names.returncode:
        pytest.skip('not a clone')
    folder = tmp_path_factory.mktemp('wheel')
    for name in filter(None, names.stdout.split('\0')):
        if name.split('/')[0] not in NOT_SHIPPED and (ROOT / name).exists():
            target = folder / 'source' / name
            target.parent.mkdir(parents=True, exist_ok=True)
            shutil.copy(ROOT / name, target)
    runtime = [library(compiler, f'lib{name}.so') for name in ('asan', 'ubsan', 'stdc++')]
    options = '-DSANITIZE=ON' if all(runtime) else ''
    done = subprocess.run([sys.executable, '-c', BUILD, folder], cwd=folder, capture_output=True,
                          text=True, env={**os.environ, 'CMAKE_ARGS': options})
    assert done.returncode == 0, done.stdout + done.stderr
    path, = folder.glob('*.whl')
    site = folder / 'site'
    zipfile.ZipFile(path).extractall(site)
    env = {**os.environ, 'PYTHONPATH': str(site)}
    if options:
        # Python frees nothing at its end. Arrays are malloc's, whatever Python's own objects are;
        # 16 MB of those that are freed hold what many calls of a kernel use, 256 MB take longer.
        env |= {'LD_PRELOAD': ' '.join(runtime), 'ASAN_OPTIONS':
                'detect_leaks=0:malloc_context_size=4:quarantine_size_mb=16'}
    return Wheel(path, site, env, bool(options))


def test_a_wheel_holds_the_kernels_and_the_messages(wheel):
    assert sysconfig.get_platform().replace('-', '_') in wheel.path.name
    held = {path.name for path in (ROOT / 'msg_defs' / 'msg').glob('*.msg')}
    shared = [name for name in zipfile.ZipFile(wheel.path).namelist()
              if '.data/data/share/mv_slapse_msgs/msg/' in name]
    assert {Path(name).name for name in shared} == held  # else it could write no results
    found = subprocess.run(
        [sys.executable, '-c', 'import mv_slapse.codec.decoder as d, mv_slapse_kernels as k; '
         'print(d.__file__, k.__file__)'], cwd=wheel.site, capture_output=True, text=True,
        env=wheel.env)
    assert found.stdout.count(str(wheel.site)) == 2, found.stdout + found.stderr


def test_kernels_neither_leave_their_arrays_nor_the_language(wheel):
    if not wheel.watched:
        pytest.skip('the compiler has no address and undefined behaviour sanitizer')
    code = 'import mv_slapse_kernels, pytest, sys; assert mv_slapse_kernels.sanitized; ' \
        'sys.exit(pytest.main(["-q", "-p", "no:cacheprovider", "test/kernels"]))'
    done = subprocess.run([sys.executable, '-c', code], cwd=ROOT, env=wheel.env,
                          capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr
