"""Planes from inverse depths: samples, the best of them, and least squares."""

from canyon import CANYON, motion, views
from mv_slapse.surfaces import consensus
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


def test_every_sample_of_one_plane_is_that_plane(rng, scene):
    samples = consensus.sample_planes(depths_of(scene, on=1), 96.0, 50, rng)
    assert len(samples) > 40
    np.testing.assert_allclose(samples, np.tile(CANYON[1], (len(samples), 1)), atol=1e-6)


def test_neighbours_share_a_plane_more_often_than_not(rng, scene):
    samples = consensus.sample_planes(depths_of(scene), 64.0, 200, rng)
    distance = np.linalg.norm(samples[:, None] - CANYON, axis=2).min(axis=1)
    assert np.mean(distance < 1e-6) > 0.5


def test_the_same_seed_draws_the_same_planes(scene):
    first, second = (consensus.sample_planes(depths_of(scene), 96.0, 50, np.random.default_rng(3))
                     for _ in range(2))
    np.testing.assert_array_equal(first, second)


def test_blocks_in_a_line_make_no_plane(rng):
    x = np.c_[np.arange(0, 160, 16), np.full(10, 100)]
    rays = np.c_[x / 500, np.ones(10)]
    depths = Depths(rays, np.full(10, 0.1), np.full(10, SIGMA), x)
    assert len(consensus.sample_planes(depths, 96.0, 50, rng)) == 0


def test_the_best_plane_is_the_one_with_the_least_truncated_error(rng, scene):
    depths = depths_of(scene, rng, outliers=0.3)
    plane, cost = consensus.best_plane(depths, np.vstack([CANYON, CANYON + 0.05]))
    costs = [np.minimum(np.square(depths.error(p)), 9).sum() / 9 for p in CANYON]
    np.testing.assert_array_equal(plane, CANYON[np.argmin(costs)])
    assert cost == pytest.approx(min(costs))


def test_a_prior_turns_the_choice(scene):
    depths, prior = depths_of(scene), np.array([1e6, 0, 1e6, 1e6])
    plane, cost = consensus.best_plane(depths, CANYON, prior=prior)
    np.testing.assert_array_equal(plane, CANYON[1])
    assert cost < 1e6


def test_a_far_plane_is_not_chosen_for_blocks_that_would_fit_any(rng):
    rays = np.c_[rng.uniform(-0.5, 0.5, 80), rng.uniform(0.1, 0.4, 80), np.ones(80)]
    near, far = np.array([0, -1.0, 0]), np.array([0, -0.02, 0])
    on_it = np.arange(80) < 20
    rho = np.where(on_it, -rays @ near, 0.02 * rng.uniform(size=80))
    depths = Depths(rays, rho, np.full(80, 0.01), np.zeros((80, 2)))
    planes = np.stack([near, far])
    np.testing.assert_array_equal(consensus.best_plane(depths, planes)[0], far)
    np.testing.assert_array_equal(consensus.best_plane(depths, planes, blur=0.1)[0], near)


def test_no_hypotheses_give_no_plane(scene):
    assert consensus.best_plane(depths_of(scene), np.zeros((0, 3))) == (None, np.inf)


def test_refinement_is_exact_without_noise(rng, scene):
    for i, truth in enumerate(CANYON):
        start = truth + rng.normal(0, 2e-3, 3)
        plane, _ = consensus.refine_plane(depths_of(scene, on=i), start)
        np.testing.assert_allclose(plane, truth, atol=1e-7)


def test_forty_percent_outliers_do_not_pull_the_plane(rng, scene):
    for i, truth in enumerate(CANYON[:3]):
        depths = depths_of(scene, rng, outliers=0.4, on=i)
        start, _ = consensus.best_plane(depths, consensus.sample_planes(depths, 96.0, 256, rng))
        plane, covariance = consensus.refine_plane(depths, start)
        assert np.abs(depths.rays @ (plane - truth)).max() < 2 * SIGMA
        error = plane - truth
        assert error @ np.linalg.solve(covariance, error) < 25


def test_errors_have_the_size_that_the_covariance_says(scene):
    distances = []
    for seed in range(60):
        depths = depths_of(scene, np.random.default_rng(seed), on=1)
        plane, covariance = consensus.refine_plane(depths, CANYON[1])
        error = plane - CANYON[1]
        distances.append(error @ np.linalg.solve(covariance, error))
    # The kernel of width 2 weighs right blocks less too: the covariance is a little large.
    assert 1.0 < np.mean(distances) < 3.5


def test_a_prior_counts_as_much_as_its_information(scene):
    depths, prior = depths_of(scene, on=1), CANYON[1] + 0.01
    firm, _ = consensus.refine_plane(depths, CANYON[1], prior_plane=prior,
                                     prior_information=1e12 * np.eye(3))
    np.testing.assert_allclose(firm, prior, atol=1e-6)
    weak, _ = consensus.refine_plane(depths, CANYON[1], prior_plane=prior,
                                     prior_information=1e-6 * np.eye(3))
    np.testing.assert_allclose(weak, CANYON[1], atol=1e-6)
    nothing = depths[np.zeros(len(depths), bool)]
    alone, covariance = consensus.refine_plane(nothing, CANYON[1], prior_plane=prior,
                                               prior_information=1e4 * np.eye(3))
    np.testing.assert_allclose(alone, prior, atol=1e-6)
    np.testing.assert_allclose(covariance, 1e-4 * np.eye(3), rtol=1e-6)


def test_the_error_of_each_is_that_from_its_own_plane(rng, scene):
    depths = depths_of(scene, rng)
    planes = CANYON[rng.integers(4, size=len(depths))]
    expected = [depths[[i]].error(plane)[0] for i, plane in enumerate(planes)]
    np.testing.assert_allclose(depths.error_each(planes), expected)
