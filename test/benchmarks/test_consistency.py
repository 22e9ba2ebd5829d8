"""The covariance of the pose is honest: errors of drawn drives against it."""

import importlib.util
import json
from pathlib import Path
import sys

import numpy as np
import pytest
from scipy.stats import chi2

SCRIPT = Path(__file__).resolve().parents[2] / 'benchmarks' / 'consistency.py'


@pytest.fixture(scope='module')
def consistency():
    spec = importlib.util.spec_from_file_location('consistency', SCRIPT)
    module = importlib.util.module_from_spec(spec)
    sys.modules['consistency'] = module  # where dataclasses look up their annotations
    spec.loader.exec_module(module)
    yield module
    del sys.modules['consistency']


@pytest.mark.parametrize('height_known', [False, True])
def test_errors_of_drawn_drives_have_the_size_that_the_covariance_says(consistency, height_known):
    drives = 12
    found = consistency.measure('some', drives, 12, (), height_known)
    # Steps of a drive go together: bounds of 99.9 % of the mean of so many drives.
    low, high = chi2.ppf([0.0005, 0.9995], 6 * drives) / drives
    by_step = np.array(found.by_step[3:])  # at first the noise of the stream is a guess
    assert np.all((by_step > low) & (by_step < high))
    assert found.plane_share > 0.9


def test_with_free_scale_the_first_pose_has_five_degrees_of_freedom(consistency):
    low, high = consistency.bounds(100, 3, False)
    np.testing.assert_allclose(low, [4.40, 5.34, 5.34], atol=0.005)
    np.testing.assert_allclose(high, [5.64, 6.70, 6.70], atol=0.005)
    assert np.all(consistency.bounds(100, 3, True)[0] == low[1])
    # The length of the first way has no error: it is the unit.
    street = consistency.Street(consistency.StreetSettings(seed=0, n_frames=4, movers=()))
    vectors = consistency.NoisyVectors(street, consistency.VectorNoise(),
                                       np.random.default_rng(0))
    scene = consistency.SceneFilter(consistency.SceneSettings())
    extractor = consistency.PlaneExtractor(street.camera, consistency.ExtractionSettings())
    first, _ = scene.step(extractor.extract(vectors.pair(0, 3)))
    assert np.linalg.norm(first.t_world_from_cam) == pytest.approx(1.0, abs=1e-4)


def test_a_line_tells_what_was_found(consistency, capsys):
    assert consistency.main(['--drives', '1', '--steps', '2', '--json']) == 0
    found = json.loads(capsys.readouterr().out)['consistency']
    assert [one['kind'] for one in found] == ['free scale', 'camera height',
                                              'camera height, movers']
    one = consistency.Consistency(**{**found[0], 'by_step': (5.0, 7.0), 'mean': 6.0})
    assert 'mean NEES 6.00' in consistency.text(one)
    assert consistency.text(one).endswith('by step: 5.0 7.0')
