"""Ratio of baselines from drawn pairs that share their middle key frame."""

from canyon import CANYON, HEIGHT, motion, views, WIDTH
from mv_slapse.geometry import plane as plane_geometry
from mv_slapse.planes import scale
import numpy as np
import pytest


def depths_seen(scene, rng, noise):
    """Return inverse depths with their errors and standard deviations."""
    sigma = noise * np.maximum(scene.rho, 1e-3)
    return scene.rho + sigma * rng.normal(size=len(sigma)), np.maximum(sigma, 1e-6)


def drive(factor, rng, noise=0.0, outliers=0.0):
    """Return the ratio found where the second baseline is ``factor`` times the first."""
    R, t = motion('ahead')
    first = views(R, t)
    planes = np.array([plane_geometry.transform(p * factor, R, t) for p in CANYON])
    second = views(R, t, planes=planes)
    rho, sigma = depths_seen(first, rng, noise)
    before = scale.depth_map(WIDTH, HEIGHT, first.x_cur, rho, sigma, first.surface >= 0)
    rho, sigma = depths_seen(second, rng, noise)
    wrong = rng.uniform(size=len(rho)) < outliers
    rho[wrong] *= rng.uniform(0.2, 5, wrong.sum())
    return scale.baseline_ratio(before, second.x_prev, second.pair.rays_cur, rho, sigma,
                                second.surface >= 0, R, t)


@pytest.mark.parametrize('factor', [0.5, 1.0, 1.3])
def test_the_ratio_is_that_of_the_baselines(rng, factor):
    assert drive(factor, rng).log == pytest.approx(np.log(factor), abs=0.002)


@pytest.mark.parametrize('factor', [0.7, 1.0, 1.4])
def test_noise_and_outliers_cost_a_few_per_cent(rng, factor):
    ratio = drive(factor, rng, noise=0.1, outliers=0.4)
    assert ratio.log == pytest.approx(np.log(factor), abs=0.04)
    assert 0.001 < ratio.sigma < 0.02


def test_nothing_in_common_is_an_unknown_ratio():
    R, t = motion('ahead')
    scene = views(R, t)
    sigma = np.full(len(scene.rho), 0.01)
    nothing = np.zeros(len(sigma), bool)
    empty = scale.depth_map(WIDTH, HEIGHT, scene.x_cur, scene.rho, sigma, nothing)
    full = scale.depth_map(WIDTH, HEIGHT, scene.x_cur, scene.rho, sigma, ~nothing)
    arguments = scene.x_prev, scene.pair.rays_cur, scene.rho, sigma
    for before, usable in ((empty, ~nothing), (full, nothing)):
        assert scale.baseline_ratio(before, *arguments, usable, R, t) == scale.BaselineRatio()
    assert not np.isfinite(scale.BaselineRatio().sigma)


def test_a_depth_map_is_exact_between_the_blocks_of_a_plane(rng):
    x = np.stack(np.meshgrid(np.arange(7.5, 160, 16), np.arange(7.5, 96, 16)), -1).reshape(-1, 2)
    slope = np.array([2e-3, -1e-3])
    rho = 0.8 + x @ slope
    found = scale.depth_map(160, 96, x, rho, np.full(len(x), 0.01), np.ones(len(x), bool))
    places = rng.uniform([16, 16], [143, 79], (50, 2))  # a corner has four
    value, sigma = found.at(places)
    np.testing.assert_allclose(value, 0.8 + places @ slope, atol=1e-12)
    assert np.all(sigma < 0.03)


def test_a_depth_map_knows_nothing_where_too_few_blocks_are_of_one_surface():
    x = np.array([[7.5, 7.5], [23.5, 7.5], [7.5, 23.5], [23.5, 23.5], [39.5, 23.5]])
    rho = np.array([0.5, 0.5, 0.5, 1.5, 1.5])
    found = scale.depth_map(48, 32, x, rho, np.full(5, 0.01), np.ones(5, bool))
    assert np.isnan(found.at(x)[0]).all()


def test_points_behind_the_previous_camera_do_not_count():
    R, t = np.eye(3), np.array([0, 0, 10.0])  # backing off by ten: near points were behind
    x = np.stack(np.meshgrid(np.arange(7.5, 160, 16), np.arange(7.5, 80, 16)), -1).reshape(-1, 2)
    n = len(x)
    before = scale.depth_map(160, 80, x, np.full(n, 0.5), np.full(n, 0.01),
                             np.ones(n, bool))
    rays, usable = np.c_[np.zeros((n, 2)), np.ones(n)], np.ones(n, bool)
    behind, far = np.full(n, 0.5), np.full(n, 1 / 12)  # 2 - 10 < 0, and 12 - 10 = 2 as before
    ratio = scale.baseline_ratio(before, x, rays, behind, np.full(n, 0.01), usable, R, t)
    assert ratio == scale.BaselineRatio()
    mixed = np.where(np.arange(n) % 2, behind, far)
    ratio = scale.baseline_ratio(before, x, rays, mixed, np.full(n, 1e-4), usable, R, t)
    assert ratio.log == pytest.approx(0, abs=1e-3)


def test_errors_of_the_depths_do_not_make_the_scale_drift():
    """The weights know nothing of the sign of an error, so its mean stays zero."""
    logs = [drive(1.0, np.random.default_rng(seed), noise=0.15).log for seed in range(30)]
    assert abs(np.mean(logs)) < 0.004


def test_robust_mean_finds_the_mode_among_outliers(rng):
    value = np.r_[0.3 + 0.05 * rng.normal(size=60), rng.uniform(-3, 3, 60)]
    found = scale.robust_mean(value, np.full(120, 0.05))
    assert found.log == pytest.approx(0.3, abs=0.03)
    assert found.sigma < 0.02


def test_robust_mean_weighs_by_accuracy(rng):
    value = np.r_[0.1 + 0.001 * rng.normal(size=50), 0.2 + 0.2 * rng.normal(size=50)]
    sigma = np.r_[np.full(50, 0.001), np.full(50, 0.2)]
    assert scale.robust_mean(value, sigma).log == pytest.approx(0.1, abs=0.01)


def test_too_few_values_have_no_mean():
    few = scale.MIN_BLOCKS - 1
    assert scale.robust_mean(np.zeros(few), np.ones(few)) == scale.BaselineRatio()
    assert scale.robust_mean(np.zeros(few + 1), np.ones(few + 1)).log == 0
