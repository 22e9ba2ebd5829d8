"""Fresh processes: results depend on no order of imports, no number of threads, no processor."""

from hashlib import sha256
import os
from pathlib import Path
import platform
import subprocess
import sys
from typing import NamedTuple

from conftest import ROOT
from mv_slapse.codec.encoding.encoder import write_video
from mv_slapse.simulation.street import Street, StreetSettings
from mv_slapse.simulation.truth import film
from mv_slapse.storage.camera_info import write_camera
from mv_slapse.storage.tum import read_trajectory
import numpy as np
import pytest

FILES = ('trajectory.tum', 'planes.csv', 'obstacles.csv', 'labels.npz', 'map.json', 'results.mcap')
FIRST, THREADS = ('numpy', 'av', 'cv2'), (1, 2, 4)
N_FRAMES = 40  # of the street: 10 pairs; with two threads the ninth once was another
N_REAL = 12
#: kernels of the BLAS library, and what a processor must be able to do for them
KERNELS = {'Prescott': set(), 'Haswell': {'avx2', 'fma'},
           'SkylakeX': {'avx512f', 'avx512bw', 'avx512dq', 'avx512vl'}}
PROGRAM = 'import {first}, sys; from mv_slapse.__main__ import main; sys.exit(main())'


class Clip(NamedTuple):
    """A video and its calibration."""

    video: Path
    camera: Path
    n_frames: int


@pytest.fixture(scope='module')
def street(tmp_path_factory) -> Clip:
    folder = tmp_path_factory.mktemp('street')
    drawn = Street(StreetSettings(n_frames=N_FRAMES))
    write_camera(folder / 'camera.yaml', drawn.camera)
    write_video(folder / 'street.mpg', film(drawn, folder), drawn.settings.fps)
    return Clip(folder / 'street.mpg', folder / 'camera.yaml', N_FRAMES)


@pytest.fixture(scope='module')
def kitti(data) -> Clip:
    return Clip(data / 'kitti00' / 'mpeg2.mpg', data / 'kitti00' / 'camera.yaml', N_REAL)


def run(clip: Clip, out: Path, first: str, **variables: str) -> Path:
    """Run the command line in a process that imports ``first`` before the package."""
    env = {name: value for name, value in os.environ.items() if name not in (
        'OMP_NUM_THREADS', 'OPENBLAS_NUM_THREADS', 'MKL_NUM_THREADS')}
    subprocess.run([sys.executable, '-c', PROGRAM.format(first=first), 'run', clip.video,
                    '--camera', clip.camera, '--camera-height', '1.65', '--quiet', '--no-report',
                    '--max-frames', str(clip.n_frames), '-o', out],
                   env={**env, 'PYTHONPATH': str(ROOT), **variables}, check=True, timeout=120)
    return out


def hashes(out: Path) -> dict[str, str]:
    return {name: sha256((out / name).read_bytes()).hexdigest() for name in FILES}


def labels(out: Path) -> dict[str, np.ndarray]:
    with np.load(out / 'labels.npz') as archive:
        return dict(archive)


def flags() -> set[str]:
    """Return what this processor can do, as Linux names it."""
    if platform.machine() != 'x86_64' or not Path('/proc/cpuinfo').exists():
        return set()
    lines = Path('/proc/cpuinfo').read_text().splitlines()
    return set(next(line for line in lines if line.startswith('flags')).split())


def test_the_order_of_imports_and_the_number_of_threads_leave_every_byte(street, tmp_path):
    found = {(first, n): hashes(run(street, tmp_path / f'{first}{n}', first,
                                    OPENBLAS_NUM_THREADS=str(n), OMP_NUM_THREADS=str(n)))
             for first in FIRST for n in THREADS}
    expected = found['av', 1]
    assert {key for key, value in found.items() if value != expected} == set()
    assert len((tmp_path / 'av1' / 'trajectory.tum').read_text().splitlines()) > 8
    assert len((tmp_path / 'av1' / 'obstacles.csv').read_text().splitlines()) > 1


def test_neither_do_they_change_a_real_street(kitti, tmp_path):
    found = [hashes(run(kitti, tmp_path / first, first, OPENBLAS_NUM_THREADS=str(n),
                        OMP_NUM_THREADS=str(n)))
             for first, n in zip(FIRST, THREADS[::-1], strict=True)]
    assert found[1:] == found[:1] * 2


def test_the_kernels_of_a_processor_leave_labels_and_trajectory(street, tmp_path):
    """Other kernels have other last bits: no choice may hang on them."""
    able = flags()
    if not able:
        pytest.skip('these kernels are for x86-64 on Linux')
    out = [run(street, tmp_path / name, 'numpy', OPENBLAS_CORETYPE=name)
           for name, needs in KERNELS.items() if needs <= able]
    expected, trajectory = labels(out[0]), read_trajectory(out[0] / 'trajectory.tum')
    for other in out[1:]:
        for name, values in labels(other).items():
            np.testing.assert_array_equal(values, expected[name], name)
        moved = read_trajectory(other / 'trajectory.tum')
        np.testing.assert_allclose(moved.positions, trajectory.positions, atol=1e-7)
        np.testing.assert_allclose(moved.quaternions, trajectory.quaternions, atol=1e-7)
