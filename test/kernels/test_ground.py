"""The ground's kernels against numpy."""

from dataclasses import replace

from canyon import motion, views
import ground_reference
from mv_slapse.config import ExtractionSettings
from mv_slapse.kernels.binding import compiled
from mv_slapse.motion.observations import Depths
from mv_slapse.surfaces import ground, height
from mv_slapse.surfaces.ground import GroundPrior
from mv_slapse.surfaces.height import HeightBelief, RoadBlocks
import numpy as np
import pytest

UP = np.array([0, -1.0, 0])
RULES = ExtractionSettings(radius=96.0, max_uncertainty=0.2)
PRIORS = [GroundPrior(UP, 0.07), GroundPrior(UP, 0.02, 1 / 1.6, 0.05),
          GroundPrior(UP, 0.03, 1 / 1.7, 0.2), GroundPrior(UP, 0.02, 1.3, 0.02)]


def canyon_depths(rng, outliers):
    """Return depths of a canyon, some of them wrong."""
    scene = views(*motion('ahead'))
    near = scene.surface >= 0
    sigma = 0.003 * np.maximum(scene.rho[near], 0.05)
    wrong = rng.uniform(size=near.sum()) < outliers
    rho = scene.rho[near] * np.where(wrong, rng.uniform(0.05, 3, near.sum()), 1)
    return Depths(scene.pair.rays_cur[near], rho + sigma * rng.normal(size=len(rho)), sigma,
                  scene.x_cur[near])


@pytest.mark.parametrize('prior', PRIORS)
@pytest.mark.parametrize('outliers', [0.0, 0.3, 0.7])
def test_the_ground_is_that_of_numpy(rng, prior, outliers):
    depths = canyon_depths(rng, outliers)
    free, lone = rng.random((2, len(depths))) < [[0.8], [0.1]]
    draws = rng.random((64, 10))
    fit = ground.find_ground(depths, free, prior, RULES, draws, lone)
    expected = ground_reference.find_ground(depths, free, prior, RULES, draws, lone)
    assert (fit is None) == (expected is None)
    if fit is not None:
        np.testing.assert_allclose(fit.plane, expected[0], rtol=1e-8, atol=1e-10)
        np.testing.assert_allclose(fit.covariance, expected[1], rtol=1e-7, atol=1e-14)
        np.testing.assert_array_equal(fit.member, expected[2])


def road_blocks(rng, n=80):
    """Return blocks of a road, half of them wrong, in several places."""
    x = np.c_[rng.uniform(-0.3, 0.3, n), rng.uniform(0.04, 0.35, n)]
    sigma = 0.02 * x[:, 1]
    rho = x[:, 1] / 1.3 * np.where(rng.random(n) < 0.5, 1, np.exp(rng.normal(size=n)))
    depths = Depths(np.c_[x, np.ones(n)], rho, sigma, 700 * x)
    return RoadBlocks(depths, x[:, 1].copy(), 3 * rng.normal(size=n), rng.uniform(0.2, 1, n),
                      rng.uniform(2, 40, n), rng.random(n) < 0.9)


@pytest.mark.parametrize(('ceiling', 'n'), [(50.0, 80), (2.0, 80), (50.0, 900)])
def test_the_height_is_that_of_numpy(rng, ceiling, n):
    belief = HeightBelief.blank()
    for _ in range(3):
        blocks = road_blocks(rng, n)
        expected = ground_reference.seen(belief.probability, blocks, 0.01, 5.0, ceiling)
        belief = belief.seen(blocks, 0.01, 5.0, ceiling)
        np.testing.assert_allclose(belief.probability, expected, rtol=1e-9, atol=1e-15)
        for log_ratio, sigma in ((0.0, 0.0), (0.33, 0.01), (-2.0, 0.4), (0.1, 5.0), (9.0, 0.1)):
            width = min(np.hypot(sigma, height.DRIFT), 3.0)
            after = belief.moved(log_ratio, sigma).probability
            expected = ground_reference.moved(belief.probability, log_ratio, width)
            np.testing.assert_allclose(after, expected, rtol=1e-9, atol=1e-15)
        belief = belief.moved(0.01, 0.01)


def test_what_no_height_allows_leaves_nothing_known(rng):
    belief = HeightBelief.blank()
    assert belief.seen(road_blocks(rng), 0.01, 5.0, 0.01).spread == pytest.approx(belief.spread)


def test_the_ceiling_is_the_median_distance_of_what_is_sharp(rng):
    depths = canyon_depths(rng, 0.2)
    inlier, lone = rng.random((2, len(depths))) < [[0.9], [0.2]]
    parallax = rng.uniform(1, 30, len(depths))

    def way(depths):
        return compiled.find_way(*depths.columns, inlier, lone, parallax, UP, np.eye(3)[2], 0.1,
                                 ground.POLICY)

    *_, drop, ceiling, typical = way(depths)
    np.testing.assert_allclose(drop, -depths.rays @ UP)
    shown = inlier & ~lone & (depths.rho > 0)
    assert typical == pytest.approx(np.median(parallax[shown]))
    sharp = shown & (depths.sigma < ground.POLICY['max_blur'] * depths.rho)
    assert ceiling == pytest.approx(np.median(1 / depths.rho[sharp]))
    assert way(replace(depths, sigma=depths.rho))[-2] == height.MOST


def test_blocks_far_from_all_others_are_not_the_ground_by_chance(rng):
    depths = canyon_depths(rng, 0.0)
    x, y = depths.x.T
    road = np.abs(depths.rho - depths.rays[:, 1] / 1.6) < 0.01
    alone = np.flatnonzero(road & (y > y[road].max() - 20) & (x < x[road].min() + 20))
    free, lone = road & (x > x[road].mean()), np.isin(np.arange(len(x)), alone)
    for shown, joins in ((~road & road, False), (lone, True)):
        fit = ground.find_ground(depths, free | lone, replace(PRIORS[0], tilt=0.2), RULES,
                                 rng.random((256, 10)), shown)
        assert fit.member[free].mean() > 0.5
        assert fit.member[alone].any() == joins
