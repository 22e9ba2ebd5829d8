import made_up
from mv_slapse.errors import UnusableInput
from mv_slapse.storage import tum
import numpy as np
import pytest


def test_a_row_has_nine_decimals_and_all_digits_of_the_stamp():
    row = tum.format_row(1_700_000_000_123_456_789, np.eye(3), np.array([1, -2, 0.5]))
    assert row == ('1700000000.123456789 1.000000000 -2.000000000 0.500000000 '
                   '0.000000000 0.000000000 0.000000000 1.000000000')


def test_stamps_keep_their_nanoseconds():
    stamps = [0, 1, 999_999_999, 1_700_000_000_123_456_789, -5]
    assert [tum.parse_stamp(tum.format_stamp(stamp)) for stamp in stamps] == stamps


@pytest.mark.parametrize('text', ['9000000001', '-9000000001', '1e400', 'nan', 'inf', 'x', ''])
def test_a_time_that_no_clock_shows_is_none(text):
    with pytest.raises((ValueError, ArithmeticError)):
        tum.parse_stamp(text)


def test_a_trajectory_comes_back_as_it_was(rng, tmp_path):
    path = tmp_path / 'path.tum'
    stamps = np.sort(rng.integers(0, 10**18, 5))
    R, t = np.stack([made_up.rotation(rng) for _ in stamps]), rng.normal(size=(5, 3))
    path.write_text('\n'.join(map(tum.format_row, stamps.tolist(), R, t)))
    again = tum.read_trajectory(path)
    np.testing.assert_array_equal(again.stamps, stamps)
    np.testing.assert_allclose(again.positions, t, atol=1e-9)
    np.testing.assert_allclose(again.rotations(), R, atol=1e-8)
    tum.write_trajectory(path, again)
    np.testing.assert_array_equal(tum.read_trajectory(path).positions, again.positions)


def test_of_the_two_quaternions_of_a_rotation_that_with_positive_w_is_written(rng):
    for _ in range(20):
        row = tum.format_row(0, made_up.rotation(rng), np.zeros(3))
        assert float(row.split()[-1]) >= 0


def test_comments_are_skipped_and_rows_sorted(tmp_path):
    path = tmp_path / 'path.tum'
    path.write_text('# stamp tx ty tz qx qy qz qw\n0.2 2 0 0 0 0 0 1\n\n0.1 1 0 0 0 0 0 2\n')
    trajectory = tum.read_trajectory(path)
    np.testing.assert_array_equal(trajectory.stamps, [100_000_000, 200_000_000])
    np.testing.assert_array_equal(trajectory.positions[:, 0], [1, 2])
    np.testing.assert_array_equal(trajectory.quaternions, [[0, 0, 0, 1]] * 2)


@pytest.mark.parametrize('row', ['0.1 1 2 3', '0.1 a 0 0 0 0 0 1', 'x 0 0 0 0 0 0 1',
                                 '0.1 0 0 0 0 0 0 0', '0.1 nan 0 0 0 0 0 1'])
def test_a_wrong_row_is_refused_with_its_number(tmp_path, row):
    path = tmp_path / 'path.tum'
    path.write_text('0 0 0 0 0 0 0 1\n' + row)
    with pytest.raises(UnusableInput, match='path.tum, line 2: expected'):
        tum.read_trajectory(path)
