"""Connected components and counts of macroblocks against SciPy's."""

import formulas
from mv_slapse.geometry.blocks import count_macroblocks
from mv_slapse.kernels.binding import compiled
import numpy as np
import pytest
from scipy import ndimage


def components(x, reach):
    """Return components by dilation and labelling of a grid, 8-connected."""
    cell = np.floor((x + 0.5) / 16).astype(int)
    cell -= cell.min(axis=0)
    occupied = np.zeros(cell.max(axis=0)[::-1] + 1 + 2 * reach, bool)
    at = (cell[:, 1] + reach, cell[:, 0] + reach)
    occupied[at] = True
    grown = ndimage.binary_dilation(occupied, np.ones((2 * reach + 1, 2 * reach + 1)))
    return ndimage.label(grown, np.ones((3, 3)))[0][at] - 1


@pytest.mark.parametrize('reach', [0, 1, 2])
@pytest.mark.parametrize('n', [1, 5, 60, 250])
def test_components_are_those_of_a_dilated_grid(rng, n, reach):
    for _ in range(20):
        x = rng.uniform(-300, 1000, (n, 2)) * rng.uniform(0.2, 1, 2)
        np.testing.assert_array_equal(compiled.components(x, reach), components(x, reach))


@pytest.mark.parametrize('smallest', [0, 1, 4, 15])
def test_components_are_kept_by_the_macroblocks_that_they_cover(rng, smallest):
    x = rng.uniform(0, [1200, 370], (150, 2))
    cell, component = np.floor((x + 0.5) / 16), components(x, 1)
    covered = [len(np.unique(cell[component == i], axis=0)) for i in component]
    np.testing.assert_array_equal(formulas.largest_components(x, smallest),
                                  np.array(covered) >= smallest)
    assert count_macroblocks(x) == len(np.unique(cell, axis=0))


def test_what_lies_far_outside_the_picture_needs_no_large_grid():
    x = np.array([[0.0, 0], [1e9, -1e9], [1e300, -1e300]])
    np.testing.assert_array_equal(formulas.components(x), [1, 0, 0])


def test_pixels_that_are_no_numbers_are_refused():
    with pytest.raises(ValueError, match='components: x is not finite'):
        compiled.components(np.array([[0.0, np.nan]]), 1)
