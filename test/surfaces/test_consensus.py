"""Inverse depths of blocks."""

from canyon import motion, views
from mv_slapse.surfaces.consensus import Depths
import numpy as np
import pytest

SIGMA = 0.004


def depths_of(scene, rng=None, outliers=0.0, on=None):
    """Return inverse depths of the blocks off the sky with Gaussian errors and wrong ones."""
    use = scene.surface >= 0 if on is None else scene.surface == on
    rho = scene.rho[use]
    n = len(rho)
    if rng is not None:
        wrong = rng.uniform(size=n) < outliers
        rho = np.where(wrong, rng.uniform(0, 0.7, n), rho + SIGMA * rng.normal(size=n))
    return Depths(scene.pair.rays_cur[use], rho, np.full(n, SIGMA), scene.x_cur[use])


@pytest.fixture
def scene():
    return views(*motion('ahead'))


def test_error_counts_standard_deviations():
    depths = Depths(np.array([[0.2, 0.5, 1]]), np.array([0.3]), np.array([0.01]), np.zeros((1, 2)))
    # On the plane y = 2 the ray's inverse depth is 0.25: five standard deviations less.
    assert depths.error(np.array([0, -0.5, 0])) == pytest.approx([5.0])


def test_a_mask_selects_all_columns(scene):
    depths = depths_of(scene)
    part = depths[depths.x[:, 0] < 100]
    assert len(part) == len(part.x) == np.sum(depths.x[:, 0] < 100)
    assert part.x[:, 0].max() < 100
    np.testing.assert_array_equal(part.rays[:, 0], depths.rays[depths.x[:, 0] < 100, 0])
