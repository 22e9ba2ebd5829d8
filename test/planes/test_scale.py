"""Ratio of baselines from drawn pairs that share their middle key frame."""

from canyon import CANYON, HEIGHT, motion, views, WIDTH
from mv_slapse.geometry import plane as plane_geometry
from mv_slapse.planes import scale
import numpy as np
import pytest

BLOCK = np.full((1, 2), 16)


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
    before = scale.depth_map(WIDTH, HEIGHT, first.x_cur, np.repeat(BLOCK, len(rho), 0), rho,
                             sigma, first.surface >= 0)
    rho, sigma = depths_seen(second, rng, noise)
    wrong = rng.uniform(size=len(rho)) < outliers
    rho[wrong] *= rng.uniform(0.2, 5, wrong.sum())
    return scale.baseline_ratio(before, second.x_prev, second.pair.rays_cur, rho, sigma,
                                second.surface >= 0, R, t)


@pytest.mark.parametrize('factor', [0.5, 1.0, 1.3])
def test_the_ratio_is_that_of_the_baselines(rng, factor):
    # The cell a block comes from has its depth at another pixel: slanted planes blur it.
    assert drive(factor, rng).log == pytest.approx(np.log(factor), abs=0.02)


@pytest.mark.parametrize('factor', [0.7, 1.0, 1.4])
def test_noise_and_outliers_cost_a_few_per_cent(rng, factor):
    ratio = drive(factor, rng, noise=0.1, outliers=0.4)
    assert ratio.log == pytest.approx(np.log(factor), abs=0.04)
    assert 0.001 < ratio.sigma < 0.02


def test_nothing_in_common_is_an_unknown_ratio():
    R, t = motion('ahead')
    scene = views(R, t)
    sigma = np.full(len(scene.rho), 0.01)
    blocks = np.repeat(BLOCK, len(sigma), 0)
    nothing = np.zeros(len(sigma), bool)
    empty = scale.depth_map(WIDTH, HEIGHT, scene.x_cur, blocks, scene.rho, sigma, nothing)
    full = scale.depth_map(WIDTH, HEIGHT, scene.x_cur, blocks, scene.rho, sigma, ~nothing)
    arguments = scene.x_prev, scene.pair.rays_cur, scene.rho, sigma
    for before, usable in ((empty, ~nothing), (full, nothing)):
        assert scale.baseline_ratio(before, *arguments, usable, R, t) == scale.BaselineRatio()
    assert not np.isfinite(scale.BaselineRatio().sigma)


def test_a_depth_map_names_the_block_of_each_cell():
    scene = views(*motion('ahead'))
    usable = scene.surface == 0
    found = scale.depth_map(WIDTH, HEIGHT, scene.x_cur, np.repeat(BLOCK, len(usable), 0),
                            scene.rho, scene.rho, usable)
    shown = np.unique(found.index)
    np.testing.assert_array_equal(shown[1:], np.flatnonzero(usable))
    i = np.flatnonzero(usable)[3]
    column, row = (scene.x_cur[i] // 8).astype(int)
    assert found.index[row, column] == i


def test_points_behind_the_previous_camera_do_not_count():
    R, t = np.eye(3), np.array([0, 0, 10.0])  # backing off by ten: near points were behind
    x = np.stack(np.meshgrid(np.arange(7.5, 160, 16), np.arange(7.5, 80, 16)), -1).reshape(-1, 2)
    n = len(x)
    before = scale.depth_map(160, 80, x, np.repeat(BLOCK, n, 0), np.full(n, 0.5),
                             np.full(n, 0.01), np.ones(n, bool))
    rays = np.c_[np.zeros((n, 2)), np.ones(n)]
    ratio = scale.baseline_ratio(before, x, rays, np.full(n, 0.5), np.full(n, 0.01),
                                 np.ones(n, bool), R, t)
    assert ratio == scale.BaselineRatio()


def test_errors_of_the_depths_do_not_make_the_scale_drift():
    """The weights know nothing of the sign of an error, so its mean stays zero."""
    logs = [drive(1.0, np.random.default_rng(seed), noise=0.15).log for seed in range(30)]
    exact = drive(1.0, np.random.default_rng(0)).log
    assert abs(np.mean(logs) - exact) < 0.004


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
