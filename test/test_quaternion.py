from mv_slapse import quaternion
import numpy as np
from numpy.testing import assert_allclose
import pytest
from scipy.spatial.transform import Rotation

TURNS = [*np.eye(3) * np.pi, *np.eye(3) * 3.1, np.zeros(3), np.full(3, 1e-9)]


def rotations(rng):
    return [Rotation.from_rotvec(turn) for turn in TURNS] + list(
        Rotation.random(20, random_state=int(rng.integers(1 << 31))))


def test_both_ways_are_those_of_scipy(rng):
    for rotation in rotations(rng):
        q = quaternion.from_matrix(rotation.as_matrix())
        expected = Rotation.from_matrix(rotation.as_matrix()).as_quat()
        assert_allclose(q * np.sign(q @ expected), expected, atol=1e-12)
        assert_allclose(quaternion.to_matrix(q), rotation.as_matrix(), atol=1e-12)


@pytest.mark.parametrize('length', [0.9, 1.0, 1.01])
def test_a_quaternion_need_not_have_unit_length(rng, length):
    rotation = rotations(rng)[-1]
    assert_allclose(quaternion.to_matrix(length * rotation.as_quat()), rotation.as_matrix(),
                    atol=1e-12)
