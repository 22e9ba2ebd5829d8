"""The filter against other formulations of the same estimate."""

import ekf_reference
from mv_slapse.filters import ekf
from mv_slapse.kernels.binding import compiled
import numpy as np
import pytest
from scipy.stats import chi2


def random_covariance(rng, n):
    A = rng.normal(size=(n, n))
    return A @ A.T + 0.1 * np.eye(n)


@pytest.fixture
def state(rng):
    state = ekf.State()
    for name, n in (('a', 3), ('b', 2), ('camera', 4)):
        state.add(name, rng.normal(size=n), random_covariance(rng, n))
    ekf_reference.update(state, rng.normal(size=2), rng.normal(size=(2, 9)), np.eye(2))
    return state


def test_correction_of_elements_is_the_weighted_least_squares_solution(rng, state):
    mu, P, rows = state.mu, state.P, np.array([1, 4, 5])
    H, R, z = np.eye(9)[rows], random_covariance(rng, 9), rng.normal(size=9)
    own = np.linalg.inv(R[np.ix_(rows, rows)])
    information = np.linalg.inv(P) + H.T @ own @ H
    expected = np.linalg.solve(information, np.linalg.inv(P) @ mu + H.T @ own @ z[rows])
    mean, covariance = compiled.correct_elements(mu, P, z, R, rows)
    np.testing.assert_allclose(mean, expected, rtol=1e-6, atol=1e-9)
    np.testing.assert_allclose(covariance, np.linalg.inv(information), rtol=1e-6, atol=1e-9)


def test_a_suboptimal_update_still_leaves_a_symmetric_positive_covariance(rng, state):
    for _ in range(50):
        state.mu, state.P = compiled.correct_elements(
            state.mu, state.P, rng.normal(size=9), 1e-9 * np.eye(9), np.array([rng.integers(9)]))
    np.testing.assert_array_equal(state.P, state.P.T)
    assert np.linalg.eigvalsh(state.P).min() > -1e-12


def test_removing_a_block_leaves_the_rest_as_it_was(state):
    kept = [0, 1, 2, 5, 6, 7, 8]  # of a (3,), b (2,) and camera (4,)
    mu, P = state.mu[kept], state.P[np.ix_(kept, kept)]
    state.remove('b')
    np.testing.assert_array_equal(state.mu, mu)
    np.testing.assert_array_equal(state.P, P)
    assert (state.index('a'), state.index('camera')) == (slice(0, 3), slice(3, 7))
    with pytest.raises(KeyError):
        state.index('b')


def test_an_added_block_is_independent_and_comes_last(rng, state):
    P = random_covariance(rng, 2)
    state.add('new', np.array([1.0, 2.0]), P)
    np.testing.assert_array_equal(state.mu[9:], [1, 2])
    np.testing.assert_array_equal(state.covariance('new'), P)
    assert not np.any(state.P[9:, :9])
    with pytest.raises(KeyError, match='new'):
        state.add('new', np.zeros(1), np.eye(1))


def test_squared_distance_counts_standard_deviations():
    assert ekf.squared_distance(np.array([3.0, 2.0]), np.diag([9.0, 1.0])) == pytest.approx(5)


def test_bound_is_the_quantile_of_chi_square():
    for dof in (1, 3, 6):
        assert ekf.chi2_bound(0.999, dof) == pytest.approx(chi2.ppf(0.999, dof))


def test_lasting_errors_go_through_the_filter_as_a_shift_of_the_mean_does(rng, state):
    """What errors that last do to the mean, against a twin with a mean so shifted."""
    shift = rng.normal(size=9)
    lasting = ekf.State(1)
    lasting.add('all', state.mu, state.P)
    lasting.lasting[:] = shift[:, None]
    shifted = ekf.State()
    shifted.add('all', state.mu + shift, state.P)
    F, H, z = rng.normal(size=(9, 9)), rng.normal(size=(2, 9)), rng.normal(size=2)
    for twin in (lasting, shifted):
        ekf_reference.predict(twin, F @ twin.mu, F, np.eye(9))
        ekf_reference.update(twin, z - H @ twin.mu, H, np.eye(2))
    np.testing.assert_allclose(shifted.mu - lasting.mu, lasting.lasting[:, 0])
    np.testing.assert_allclose(lasting.P, shifted.P)
    np.testing.assert_allclose(lasting.total - lasting.P, np.outer(lasting.lasting,
                                                                   lasting.lasting))
    np.testing.assert_allclose(lasting.covariance('all'), lasting.total)


def test_blocks_come_and_go_with_their_lasting_errors():
    state = ekf.State(2)
    state.add('a', np.zeros(1), np.eye(1))
    state.add('b', np.zeros(2), np.eye(2))
    state.lasting = np.arange(6.0).reshape(3, 2)
    state.remove('a')
    np.testing.assert_array_equal(state.lasting, [[2, 3], [4, 5]])
    np.testing.assert_array_equal(state.covariance('b'), [[14, 23], [23, 42]])


def test_a_matrix_that_is_no_covariance_becomes_the_nearest_one(rng):
    """Elements of very different units: judged and mended by their correlations."""
    unit, A = np.array([1e-6, 1.0, 1e5, 1e-3]), rng.normal(size=(4, 9))
    state = ekf.State()
    state.add('all', np.zeros(4), A @ A.T * np.outer(unit, unit))
    sound = state.P.copy()
    assert not ekf.repair(state)
    np.testing.assert_array_equal(state.P, sound)
    state.P[0, 1] = state.P[1, 0] = 2 * np.sqrt(sound[0, 0] * sound[1, 1])
    assert ekf.repair(state)
    assert np.linalg.eigvalsh(state.P / np.outer(unit, unit)).min() > -1e-9
    assert not ekf.repair(state)
    np.testing.assert_array_equal(state.P, state.P.T)


def test_what_is_known_exactly_needs_no_repair():
    state = ekf.State()
    state.add('all', np.zeros(4), np.diag([0, 1e-20, 1, 0.0]))
    assert not ekf.repair(state)
