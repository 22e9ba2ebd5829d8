"""Cells and macroblocks by small pictures."""

import formulas
from mv_slapse.geometry.blocks import count_macroblocks, lookup, paint
import numpy as np
import pytest


def centres(*macroblocks):
    """Return centres of 16 x 16 macroblocks (column, row)."""
    return 16.0 * np.array(macroblocks, float).reshape(-1, 2) + 7.5


def blocks(n, width=16, height=16):
    return np.tile(np.array([width, height], np.uint8), (n, 1))


def test_pixels_centred_at_integers_fall_into_their_cell():
    grid = np.arange(20, dtype=np.int32).reshape(4, 5)
    x = np.array([[-0.5, 0], [7.49, 8], [7.5, 15.5], [39.4, 31.4], [39.5, 0], [0, 31.5]])
    np.testing.assert_array_equal(lookup(grid, x), [0, 5, 11, 19, -1, -1])


def test_what_reaches_over_the_border_paints_the_cells_at_it():
    grid = paint(16, 16, np.array([[-99.0, 7.5], [40, 40]]), blocks(2), np.array([1, 2]))
    np.testing.assert_array_equal(grid, [[1, -1], [1, 2]])


def test_a_picture_that_is_no_multiple_of_a_cell_has_a_cell_for_the_rest():
    assert paint(1241, 376, np.zeros((0, 2)), blocks(0), np.zeros(0)).shape == (47, 156)


def test_a_macroblock_paints_its_four_cells():
    grid = paint(64, 32, centres((1, 0)), blocks(1), np.array([7]))
    expected = np.full((4, 8), -1)
    expected[:2, 2:4] = 7
    np.testing.assert_array_equal(grid, expected)


def test_partitions_paint_only_their_own_cells():
    x = np.array([[19.5, 3.5], [27.5, 7.5], [7.5, 27.5]])  # 8 x 8, 8 x 16 and 16 x 8
    size = np.array([[8, 8], [8, 16], [16, 8]], np.uint8)
    grid = paint(32, 32, x, size, np.array([1, 2, 3]))
    np.testing.assert_array_equal(grid, [[-1, -1, 1, 2], [-1, -1, -1, 2], [-1, -1, -1, -1],
                                         [3, 3, -1, -1]])


def test_the_later_of_two_blocks_wins():
    grid = paint(16, 16, centres((0, 0), (0, 0)), blocks(2), np.array([1, 2]))
    assert np.all(grid == 2)


def test_what_is_painted_is_found_within_its_block_and_nothing_outside_the_picture(rng):
    places = rng.permutation(12)[:6]
    x = centres(*np.c_[places % 4, places // 4])
    grid = paint(64, 48, x, blocks(6), np.arange(6))
    shift = rng.uniform(-7.9, 7.9, x.shape)
    np.testing.assert_array_equal(lookup(grid, x + shift), np.arange(6))
    outside = np.array([[-0.6, 5], [5, -0.6], [63.6, 5], [5, 47.6], [-1e9, 1e9]])
    np.testing.assert_array_equal(lookup(grid, outside), -1)


def test_macroblocks_are_counted_once_however_many_partitions_they_have():
    assert count_macroblocks(centres((0, 0), (3, 1), (1, 3))) == 3
    assert count_macroblocks(np.array([[3.5, 3.5], [11.5, 3.5], [19.5, 3.5]])) == 2
    assert count_macroblocks(np.zeros((0, 2))) == 0


@pytest.mark.parametrize(('gap', 'together'), [(1, True), (2, True), (3, True), (4, False)])
def test_components_reach_over_gaps_of_fewer_than_three_blocks(gap, together):
    component = formulas.components(centres((2, 2), (2 + gap, 2)))
    assert (component[0] == component[1]) is np.bool_(together)


def test_components_are_numbered_from_zero():
    component = formulas.components(centres((0, 0), (20, 0), (1, 0), (20, 20)))
    assert component[0] == component[2]
    np.testing.assert_array_equal(np.unique(component), [0, 1, 2])
    assert formulas.components(np.zeros((0, 2))).shape == (0,)


def test_only_components_of_enough_macroblocks_are_kept():
    x = np.vstack([centres((0, 0), (1, 0), (0, 1)), centres((20, 20), (21, 20)),
                   centres((20, 20)) + 3.0])  # twice the same macroblock
    np.testing.assert_array_equal(formulas.largest_components(x, 3), [1, 1, 1, 0, 0, 0])
    np.testing.assert_array_equal(formulas.largest_components(x, 2), True)
    assert formulas.largest_components(np.zeros((0, 2)), 1).shape == (0,)
