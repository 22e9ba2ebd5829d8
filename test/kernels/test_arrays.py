"""Arrays at the border of the kernels: a wrong one is refused with its name, none is copied."""

from mv_slapse.kernels.binding import compiled
import numpy as np
import pytest

EYE = np.eye(3)


@pytest.mark.parametrize(('A', 'why'), [
    (EYE.astype(np.float32), 'has dtype float32'),
    (EYE.astype('>f8'), 'has dtype >f8'),
    (EYE[:2], r'has shape \(2, 3\)'),
    (EYE.ravel(), r'has shape \(9,\)'),
    (EYE * np.nan, 'is not finite'),
    (EYE - np.inf, 'is not finite'),
    (EYE.tolist(), 'is no numpy array'),
    (None, 'is no numpy array')])
def test_a_wrong_array_is_refused_with_its_name(A, why):
    with pytest.raises(ValueError, match=rf'^rotation_log: A {why}.*float64 of shape \(3, 3'):
        compiled.rotation_log(A)


@pytest.mark.parametrize('A', [
    np.repeat(np.diag([1.0, 2, 4]) + 0.5, 2, axis=1)[:, ::2],
    np.asfortranarray(np.arange(9.0).reshape(3, 3)),
    np.frombuffer(b' ' + (np.diag([1.0, 2, 4]) + 0.5).tobytes(), np.uint8)[1:].view(float).reshape(
        3, 3)], ids=['strided', 'columns first', 'not aligned'])
def test_an_array_may_lie_in_memory_as_it_likes(A):
    np.testing.assert_array_equal(compiled.rotation_log(A),
                                  compiled.rotation_log(np.array(A, order='C')))


def test_arguments_that_contradict_each_other_are_refused():
    with pytest.raises(ValueError, match='cholesky_solve: b has shape'):
        compiled.cholesky_solve(EYE, np.ones(2))
    with pytest.raises(ValueError, match='of at most 12 rows'):
        compiled.ldlt_solve(np.eye(13), np.ones(13))


def test_arguments_are_left_as_they_are():
    A, b = 4 * EYE, np.arange(3.0)
    A.flags.writeable = b.flags.writeable = False
    np.testing.assert_array_equal(compiled.cholesky_solve(A, b), b / 4)
    np.testing.assert_array_equal(A, 4 * EYE)
