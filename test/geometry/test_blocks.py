from mv_slapse.geometry.blocks import grid_centres, grid_shape
import numpy as np


def test_the_grid_covers_blocks_that_the_border_cuts():
    assert grid_shape(1240, 376) == (78, 24)
    np.testing.assert_array_equal(grid_centres(40, 32)[:4],
                                  [[7.5, 7.5], [23.5, 7.5], [39.5, 7.5], [7.5, 23.5]])
