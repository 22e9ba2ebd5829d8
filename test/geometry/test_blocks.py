from mv_slapse.evaluation.detection import grid_index
from mv_slapse.geometry.blocks import grid_centres, grid_shape
import numpy as np


def test_the_grid_covers_blocks_that_the_border_cuts():
    assert grid_shape(1240, 376) == (78, 24)
    np.testing.assert_array_equal(grid_centres(40, 32)[:4],
                                  [[7.5, 7.5], [23.5, 7.5], [39.5, 7.5], [7.5, 23.5]])


def test_a_pixel_has_the_number_of_the_centre_beside_it_or_none_outside():
    centres = grid_centres(40, 32)
    np.testing.assert_array_equal(grid_index(centres + (7.9, -7.9), 40, 32), np.arange(6))
    np.testing.assert_array_equal(
        grid_index(np.array([[-0.6, 5.0], [47.6, 5.0], [5.0, -0.6], [5.0, 31.6]]), 40, 32), -1)
