"""Small algebra of the kernels against numpy and scipy."""

from mv_slapse.kernels.binding import compiled
import numpy as np
import pytest
from scipy.spatial.transform import Rotation


def positive_definite(rng, n):
    A = rng.normal(size=(n, n))
    return A @ A.T + 0.1 * np.eye(n)


@pytest.mark.parametrize('angle', [0.0, 1e-9, 1e-4, 0.3, 3.0, np.pi - 1e-6, np.pi])
def test_a_rotation_and_its_vector(rng, angle):
    axis = rng.normal(size=3)
    w = angle * axis / np.linalg.norm(axis)
    R = Rotation.from_rotvec(w).as_matrix()
    np.testing.assert_allclose(compiled.rotation_exp(w), R, atol=1e-15)
    back = compiled.rotation_log(R)
    error = np.minimum(np.abs(back - w).max(), np.abs(back + w).max() if angle == np.pi else 9)
    assert error < (1e-9 if angle < 3.1 else 1e-7)


@pytest.mark.parametrize('values', [(1.0, 2.0, 5.0), (0.0, 0.0, 3.0), (2.0, 2.0, 2.0),
                                    (-1e6, 1e-6, 1.0)])
def test_eigenvectors_of_a_symmetric_matrix(rng, values):
    Q = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    A = Q @ np.diag(values) @ Q.T
    A = 0.5 * (A + A.T)
    found, vectors = compiled.eigen_symmetric(A)
    scale = np.abs(values).max()
    np.testing.assert_allclose(found, np.linalg.eigvalsh(A), atol=1e-14 * scale)
    np.testing.assert_allclose(vectors @ np.diag(found) @ vectors.T, A, atol=1e-14 * scale)
    np.testing.assert_allclose(vectors.T @ vectors, np.eye(3), atol=1e-14)


@pytest.mark.parametrize('n', [1, 2, 6, 12])
def test_systems_are_solved(rng, n):
    A, x = positive_definite(rng, n), rng.normal(size=n)
    np.testing.assert_allclose(compiled.cholesky_solve(A, A @ x), x, rtol=1e-9, atol=1e-10)
    A -= 0.5 * np.trace(A) / n * np.eye(n)
    np.testing.assert_allclose(compiled.ldlt_solve(A, A @ x), x, rtol=1e-6, atol=1e-7)


def test_a_system_without_a_solution_gives_none():
    singular = np.ones((2, 2))
    assert compiled.cholesky_solve(singular, np.ones(2)) is None
    assert compiled.ldlt_solve(singular, np.ones(2)) is None
    assert compiled.cholesky_solve(-np.eye(3), np.ones(3)) is None


@pytest.mark.parametrize('least', [-1e-3, -1e-5, -1e-8, 1e-3])
def test_a_covariance_is_told_by_the_eigenvalues_of_its_correlations(rng, least):
    vectors = np.linalg.qr(rng.normal(size=(20, 20)))[0]
    P = vectors * np.r_[least, rng.uniform(1, 2, 19)] @ vectors.T
    unit = np.sqrt(np.diagonal(P))
    correlation = P / unit[:, None] / unit
    scale = 10.0 ** rng.uniform(-4, 4, 20)
    good = np.linalg.eigvalsh(correlation)[0] > -1e-6
    assert compiled.is_covariance(scale[:, None] * correlation * scale, 1e-6) == good
    assert good == (least > -1e-6)


def test_what_is_not_finite_is_no_covariance():
    assert not compiled.is_covariance(np.full((3, 3), np.nan), 1e-6)
    assert compiled.is_covariance(np.zeros((3, 3)), 1e-6)
