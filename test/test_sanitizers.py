"""The kernels' tests once more, with kernels that watch their memory and their arithmetic."""

import os
from pathlib import Path
import shutil
import subprocess
import sys

import pytest

ROOT = Path(__file__).resolve().parents[1]


def library(compiler: str, name: str) -> str:
    """Return the path of a library of the compiler; '' where it has none."""
    done = subprocess.run([compiler, f'-print-file-name={name}'], capture_output=True, text=True)
    path = done.stdout.strip()
    return os.path.realpath(path) if os.path.isabs(path) and os.path.exists(path) else ''


@pytest.fixture(scope='module')
def watched(tmp_path_factory):
    """Environment in which Python loads kernels that were compiled with sanitizers."""
    compiler = os.environ.get('CXX') or shutil.which('c++')
    if not compiler or not shutil.which('cmake'):
        pytest.skip('no C++ compiler or no CMake')
    runtime = [library(compiler, f'lib{name}.so') for name in ('asan', 'ubsan', 'stdc++')]
    if not all(runtime):
        pytest.skip('the compiler has no address and undefined behaviour sanitizer')
    folder = tmp_path_factory.mktemp('sanitizers')
    for command in (
            ['cmake', '-S', ROOT / 'mv_slapse' / 'kernels', '-B', folder / 'build',
             '-DSANITIZE=ON', f'-DPython_EXECUTABLE={sys.executable}',
             f'-DCMAKE_INSTALL_PREFIX={folder}'],
            ['cmake', '--build', folder / 'build', '--parallel', '2'],
            ['cmake', '--install', folder / 'build']):
        done = subprocess.run(command, capture_output=True, text=True)
        assert done.returncode == 0, done.stdout + done.stderr
    # Python frees nothing at its end. Arrays are malloc's, whatever Python's own objects are.
    return {**os.environ, 'LD_PRELOAD': ' '.join(runtime), 'PYTHONPATH': str(folder),
            'ASAN_OPTIONS': 'detect_leaks=0:malloc_context_size=4'}


def test_kernels_neither_leave_their_arrays_nor_the_language(watched):
    code = 'import mv_slapse_kernels, pytest, sys; assert mv_slapse_kernels.sanitized; ' \
        'sys.exit(pytest.main(["-q", "-p", "no:cacheprovider", "test/kernels"]))'
    done = subprocess.run([sys.executable, '-c', code], cwd=ROOT, env=watched,
                          capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr
