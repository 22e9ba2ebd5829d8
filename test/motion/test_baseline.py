"""Ratio of baselines from drawn pairs that share their middle key frame."""

from dataclasses import replace

from canyon import CANYON, HEIGHT, K, motion, views, WIDTH
import formulas
from kernels.motion_reference import reach
from mv_slapse.geometry import plane as plane_geometry
from mv_slapse.geometry.two_view import Pair
from mv_slapse.motion import baseline
from mv_slapse.motion.estimate import MotionFit
from mv_slapse.motion.observations import observe
import numpy as np
import pytest

RELIEF = 0.03


def depths_seen(scene, t, rng, noise):
    """Return inverse depths with noise [px] along the epipolar lines, and its share of the noise.

    A match that is off by e moves the inverse depth by e (1 - rho t_z)^2 / reach.
    """
    unit = noise / reach(scene.pair.rays_cur, scene.pair.focal, t)
    error = unit * np.square(1 - scene.rho * t[2]) * rng.normal(size=len(unit))
    return scene.rho + error, np.maximum(unit, 1e-9)


def moving(R, t):
    return MotionFit(R, t, np.zeros((6, 6)), 0.0)


def seen(pair, rho, unit):
    """Return observations that hold these depths of all blocks."""
    ahead = moving(np.eye(3), np.array([0, 0, -1.0]))
    return replace(observe(pair, ahead, 3.0, 1.0, 0.0), rho=rho, far_sigma=unit,
                   has_depth=np.ones(len(pair), bool))


def drive(factor, rng, noise=0.0, outliers=0.0, expected=0.0):
    """Return the ratio found where the second baseline is ``factor`` times the first."""
    R, t = motion('ahead')
    first = views(R, t)
    planes = np.array([plane_geometry.transform(p * factor, R, t) for p in CANYON])
    second = views(R, t, planes=planes)
    rho, unit = depths_seen(first, t, rng, noise)
    before = baseline.depth_map((WIDTH, HEIGHT), (first.x_cur, rho, unit), t[2], RELIEF,
                                first.surface >= 0)
    rho, unit = depths_seen(second, t, rng, noise)
    wrong = rng.uniform(size=len(rho)) < outliers
    rho[wrong] *= rng.uniform(0.2, 5, wrong.sum())
    now = baseline.from_previous((WIDTH, HEIGHT), seen(second.pair, rho, unit),
                                 second.surface >= 0, moving(R, t), RELIEF)
    return baseline.baseline_ratio(before, now, expected)


@pytest.mark.parametrize('factor', [0.5, 1.0, 1.3])
def test_the_ratio_is_that_of_the_baselines(rng, factor):
    assert drive(factor, rng).log == pytest.approx(np.log(factor), abs=0.002)


@pytest.mark.parametrize('factor', [0.7, 1.0, 1.4])
def test_noise_and_outliers_cost_a_few_per_cent(rng, factor):
    ratio = drive(factor, rng, noise=0.5, outliers=0.4)
    assert ratio.log == pytest.approx(np.log(factor), abs=0.04)
    assert 0.001 < ratio.sigma < 0.02


def test_nothing_in_common_is_an_unknown_ratio():
    R, t = motion('ahead')
    scene = views(R, t)
    unit = np.full(len(scene.rho), 0.01)
    nothing = np.zeros(len(unit), bool)
    empty, full = (baseline.depth_map((WIDTH, HEIGHT), (scene.x_cur, scene.rho, unit), t[2],
                                      RELIEF, usable)
                   for usable in (nothing, ~nothing))
    for before, now in ((empty, full), (full, empty), (empty, empty)):
        assert baseline.baseline_ratio(before, now).sigma == np.inf


def test_a_depth_map_is_exact_between_the_blocks_of_a_plane(rng):
    x = np.stack(np.meshgrid(np.arange(7.5, 160, 16), np.arange(7.5, 96, 16)), -1).reshape(-1, 2)
    slope = np.array([2e-3, -1e-3])
    rho = 0.8 + x @ slope
    found = baseline.depth_map((160, 96), (x, rho, np.full(len(x), 0.01)), -1.0, RELIEF,
                               np.ones(len(x), bool))
    places = rng.uniform([16, 16], [143, 79], (50, 2))  # a corner has four
    value, sigma = found.at(places)
    np.testing.assert_allclose(value, 0.8 + places @ slope, atol=1e-12)
    assert np.all((sigma > 0.01) & (sigma < 0.06))


def test_a_depth_map_knows_nothing_where_too_few_blocks_are_of_one_surface():
    x = np.array([[7.5, 7.5], [23.5, 7.5], [7.5, 23.5], [23.5, 23.5], [39.5, 23.5]])
    rho = np.array([0.5, 0.5, 0.5, 1.5, 1.5])
    found = baseline.depth_map((48, 32), (x, rho, np.full(5, 0.01)), 0.0, RELIEF,
                               np.ones(5, bool))
    assert np.isnan(found.at(x)[0]).all()


def test_points_behind_the_previous_camera_do_not_count():
    R, t = np.eye(3), np.array([0, 0, 10.0])  # backing off by ten: near points were behind
    x = np.stack(np.meshgrid(np.arange(7.5, 160, 16), np.arange(7.5, 80, 16)), -1).reshape(-1, 2)
    n = len(x)
    rays = np.c_[np.zeros((n, 2)), np.ones(n)]
    rho = np.where(np.arange(n) % 2, 0.5, 1 / 12)  # 2 - 10 < 0, and 12 - 10 = 2
    pair = Pair(rays, rays, x, np.ones(n), K)
    now = baseline.from_previous((160, 80), seen(pair, rho, np.full(n, 1e-4)), True,
                                 moving(R, t), RELIEF)
    index = now.grid[now.grid >= 0]
    assert set(index) == set(range(0, n, 2))
    np.testing.assert_allclose(now.rho[index], 0.5)


@pytest.mark.parametrize('noise', [0.5, 1.0])
def test_errors_of_the_depths_do_not_make_the_scale_drift(noise):
    """What a noisy single depth does to the mean cancels between the two directions."""
    logs = [drive(1.0, np.random.default_rng(seed), noise).log for seed in range(40)]
    assert abs(np.mean(logs)) < 0.002


def test_the_mode_near_an_unchanged_speed_wins_unless_it_is_much_smaller(rng):
    value = np.r_[0.02 * rng.normal(size=60), 0.7 + 0.02 * rng.normal(size=30)]
    sigma = np.full(90, 0.05)
    assert formulas.robust_mean(value, sigma, 0.0).log == pytest.approx(0.0, abs=0.02)
    assert formulas.robust_mean(value, sigma, 0.7).log == pytest.approx(0.7, abs=0.02)
    assert formulas.robust_mean(value[:65], sigma[:65], 0.7).log == pytest.approx(0.0, abs=0.02)


def test_directions_that_disagree_leave_the_ratio_uncertain(monkeypatch):
    found = iter([baseline.BaselineRatio(0.8, 0.01), baseline.BaselineRatio(-0.1, 0.01)])
    monkeypatch.setattr(baseline, '_excess', lambda *_: next(found))
    ratio = baseline.baseline_ratio(None, None)
    assert ratio.log == pytest.approx(0.45)
    assert ratio.sigma == pytest.approx(0.35, abs=0.001)


def test_robust_mean_finds_the_mode_among_outliers(rng):
    value = np.r_[0.3 + 0.05 * rng.normal(size=60), rng.uniform(-3, 3, 60)]
    found = formulas.robust_mean(value, np.full(120, 0.05))
    assert found.log == pytest.approx(0.3, abs=0.03)
    assert found.sigma < 0.02


def test_robust_mean_weighs_by_accuracy(rng):
    value = np.r_[0.1 + 0.001 * rng.normal(size=50), 0.2 + 0.2 * rng.normal(size=50)]
    sigma = np.r_[np.full(50, 0.001), np.full(50, 0.2)]
    assert formulas.robust_mean(value, sigma).log == pytest.approx(0.1, abs=0.01)


def test_too_few_values_have_no_mean():
    few = baseline.MIN_BLOCKS - 1
    assert formulas.robust_mean(np.zeros(few), np.ones(few)) == baseline.BaselineRatio()
    assert formulas.robust_mean(np.zeros(few + 1), np.ones(few + 1)).log == 0
