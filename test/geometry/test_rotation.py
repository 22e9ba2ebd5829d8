"""Rotations against scipy's matrix exponential and by definition."""

import formulas
from mv_slapse.geometry import rotation
import numpy as np
import pytest
from scipy.linalg import expm


def test_skew_is_the_cross_product(rng):
    v, a = rng.normal(size=(2, 3))
    np.testing.assert_allclose(rotation.skew(v) @ a, np.cross(v, a))


@pytest.mark.parametrize('size', [0.0, 1e-12, 1e-6, 0.1, 3.1])
def test_exp_is_the_exponential_of_the_cross_product(rng, size):
    w = rng.normal(size=3)
    w *= size / np.linalg.norm(w)
    np.testing.assert_allclose(rotation.exp(w), expm(rotation.skew(w)), atol=1e-12)


@pytest.mark.parametrize('size', [0.0, 1e-12, 1e-6, 0.1, 3.1])
def test_log_undoes_exp(rng, size):
    w = rng.normal(size=3)
    w *= size / np.linalg.norm(w)
    np.testing.assert_allclose(rotation.log(rotation.exp(w)), w, atol=1e-12)
    assert rotation.angle(rotation.exp(w)) == pytest.approx(size, abs=1e-12)


def test_tangent_basis_is_orthonormal_and_normal_to_its_direction(rng):
    for direction in (*np.eye(3), *-np.eye(3), *rng.normal(size=(10, 3))):
        basis = formulas.tangent_basis(direction)
        np.testing.assert_allclose(basis.T @ basis, np.eye(2), atol=1e-14)
        np.testing.assert_allclose(direction @ basis, 0, atol=1e-14)


@pytest.mark.parametrize('shapes', [((7, 3), (3,)), ((7, 3), (7, 3)), ((7, 2, 3), (7, 1, 3))])
def test_cross_is_the_cross_product(rng, shapes):
    a, b = (rng.normal(size=shape) for shape in shapes)
    np.testing.assert_array_equal(formulas.cross(a, b), np.cross(a, b))


def test_norm_is_numpys_bit_by_bit(rng):
    for vector in rng.normal(size=(100, 3)):
        assert rotation.norm(vector) == np.linalg.norm(vector)
