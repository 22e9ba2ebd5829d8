"""Windows of the lattice: their planes, which plane fits a block's surroundings, and noise."""

from mv_slapse.surfaces import windows
import numpy as np
import pytest
from walls import UP, WALLS, walls


def excess(seen, depths, plane):
    """Return the excess of one plane at each block."""
    return seen.excess(np.square(depths.error(plane))[:, None])[:, 0]


def test_windows_on_one_surface_have_its_plane():
    depths, surface = walls()
    first = depths[surface == 0]
    seen = windows.look(first, UP)
    # A window at the edge of a surface may hold a single column, which knows no slope.
    close = np.linalg.norm(seen.planes - WALLS[0], axis=1) < 1e-4
    assert np.mean(close) > 0.7
    assert seen.cost.max() < 1e-3


def test_means_are_taken_over_each_window(rng):
    depths, _ = walls(rng)
    seen = windows.look(depths, UP)
    np.testing.assert_allclose(seen.mean @ np.ones(len(depths)), 1, rtol=1e-5)
    np.testing.assert_allclose(seen.mean @ depths.x, seen.centres)
    assert np.diff(seen.mean.indptr).min() >= windows.LEAST


def test_a_block_is_judged_by_a_window_of_its_own_surface():
    depths, surface = walls()
    seen = windows.look(depths, UP)
    members = [seen.mean[window].indices for window in seen.best]
    pure = [np.mean(surface[m] == s) for m, s in zip(members, surface, strict=True)]
    assert np.mean(np.array(pure) == 1) > 0.95


def test_the_true_plane_has_little_excess_and_a_slanted_one_much(rng):
    depths, surface = walls(rng)
    seen = windows.look(depths, UP)
    # Least squares through all three walls: within three sigma of most blocks.
    slanted = -np.linalg.lstsq(depths.rays / depths.sigma[:, None], depths.rho / depths.sigma,
                               rcond=None)[0]
    own = np.concatenate([excess(seen, depths, plane)[surface == i]
                          for i, plane in enumerate(WALLS)])
    assert np.mean(own < 0.7) > 0.8
    assert np.mean(excess(seen, depths, slanted) < 0.7) < 0.4


def test_noise_is_measured_where_vectors_are_worse_than_they_claim(rng):
    assert windows.look(walls(rng, 0.03, 0.03)[0], UP).noise == pytest.approx(1.0, abs=0.2)
    assert windows.look(walls(rng, 0.03, 0.01)[0], UP).noise == pytest.approx(3.0, rel=0.2)


def test_few_blocks_make_no_window():
    assert windows.look(walls()[0][:windows.LEAST - 1], UP) is None


def test_a_block_alone_fits_no_plane():
    depths, _ = walls()
    apart = depths[depths.x[:, 0] != 39.5]
    lonely = np.flatnonzero(depths.x[:, 1] < 20)[:1]
    chosen = np.r_[lonely, np.flatnonzero(apart.x[:, 1] > 200)]
    seen = windows.look(apart[chosen], UP)
    assert seen.best[0] == -1
    assert np.isinf(excess(seen, apart[chosen], WALLS[0])[0])


def test_planes_grow_to_their_whole_surface(rng):
    depths, surface = walls(rng)
    seen = windows.look(depths, UP)
    planes, squared = windows.grown(seen, np.ones(len(seen.planes), bool), depths, UP)
    for i in (0, 2):
        assert np.linalg.norm(planes - WALLS[i], axis=1).min() < 0.04 * np.linalg.norm(WALLS[i])
    near = np.isfinite(squared)
    expected = np.square(depths.rho[:, None] + depths.rays @ planes.T) / depths.sigma[:, None]**2
    np.testing.assert_allclose(squared[near], expected[near], rtol=0.05, atol=0.05)
    assert not near.all()


def test_a_wall_that_may_be_upright_is_made_so():
    planes = np.array([[0.2, 0.02, 0.0], [0.2, 0.08, 0.0]])
    covariance = np.tile(np.eye(3) * 1e-4, (2, 1, 1))
    better, less = windows.upright(planes, covariance, UP)
    assert abs(better[0] @ UP) < 0.003
    assert UP @ less[0] @ UP < 0.1 * UP @ covariance[0] @ UP
    np.testing.assert_array_equal(better[1], planes[1])
    np.testing.assert_array_equal(less[1], covariance[1])
