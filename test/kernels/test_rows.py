"""Rows of a record's columns against numpy."""

from mv_slapse.kernels.binding import compiled
import numpy as np
import pytest


@pytest.mark.parametrize('type_', [bool, np.int8, np.uint8, np.int32, np.int64, np.float32, float])
@pytest.mark.parametrize('shape', [(), (1,), (2,), (3,), (7,), (0,), (3, 3), (2, 0)])
def test_rows_are_taken_as_numpy_does(rng, type_, shape):
    columns = tuple(rng.integers(-99, 99, (50, *shape)).astype(type_) for _ in range(2))
    columns += (columns[0][::-1],)  # not contiguous
    for rows in (rng.integers(0, 50, 80), np.zeros(0, np.int64)):
        for column, found in zip(columns, compiled.take_rows(columns, rows), strict=True):
            assert found.dtype == column.dtype
            np.testing.assert_array_equal(found, column[rows])


@pytest.mark.parametrize(('columns', 'rows', 'says'), [
    ((), [0], 'there must be a column'),
    (([1.0],), [0], 'no numpy array'),
    ((np.ones(()),), [0], 'has no rows'),
    ((np.ones(3), np.ones(4)), [0], 'as many rows'),
    ((np.ones((3, 2, 2, 2)),), [0], 'one to three axes'),
    ((np.ones(3, np.int16),), [0], 'has dtype int16'),
    ((np.ones(3),), [3], 'not there'),
    ((np.ones(3),), [-1], 'not there'),
])
def test_wrong_columns_are_refused(columns, rows, says):
    with pytest.raises(ValueError, match=says):
        compiled.take_rows(columns, np.array(rows))
