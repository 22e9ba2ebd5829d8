"""Depths carried from pair to pair against numpy."""

from canyon import motion, MOTIONS, views
from mv_slapse.motion.observations import Depths
from mv_slapse.surfaces import depth_grid
from mv_slapse.surfaces.depth_grid import DepthGrid, POLICY
import numpy as np
import pytest


def interpolated(grid, x):
    """Return rho and information (N,) at pixels, bilinearly, 0 across edges."""
    place = (x + 0.5) / 16 - 0.5
    corner = np.floor(place).astype(int)
    step = np.array([[0, 0], [1, 0], [0, 1], [1, 1]])
    near = corner[:, None] + step
    weight = np.prod(np.abs(1 - step - (place - corner)[:, None]), axis=2)
    inside = np.all((near >= 0) & (near < grid.rho.shape[::-1]), axis=2)
    column, row = np.moveaxis(np.where(inside[..., None], near, 0), 2, 0)
    rho, known = grid.rho[row, column], grid.information[row, column]
    weight[~inside | (known == 0)] = 0
    total = weight.sum(axis=1)
    low = np.min(np.where(weight > 0, rho, np.inf), axis=1)
    high = np.max(np.where(weight > 0, rho, 0), axis=1)
    good = (total > POLICY['least_weight']) & (high < POLICY['same_surface'] * low)
    weight /= np.maximum(total, 1e-9)[:, None]
    variance = np.sum(np.square(weight) / np.maximum(known, 1e-18), axis=1)
    return np.sum(weight * rho, axis=1), np.where(good, 1 / np.maximum(variance, 1e-18), 0)


def predicted(grid, pair, R, t, ratio):
    """Return rho and information (N,) after a motion."""
    rho, information = interpolated(grid, pair.x_prev)
    rho, information = ratio * rho, information / ratio**2
    ahead = pair.rays_prev @ R[2]
    nearer = ahead + rho * t[2]
    good = (nearer > 0) & (information > 0)
    rho = np.where(good, rho / np.where(good, nearer, 1), 0)
    variance = (ahead / nearer**2)**2 / np.where(good, POLICY['forgetting'] * information, 1)
    return rho, np.where(good, 1 / (variance + (POLICY['drift'] * rho)**2 + 1e-18), 0)


@pytest.mark.parametrize('name', MOTIONS)
def test_depths_are_carried_as_by_numpy(rng, name):
    R, t = motion(name)
    pair = views(R, t).pair
    rho = 0.2 + 0.02 * rng.random((30, 40)) + (rng.random((30, 40)) < 0.1)
    grid = DepthGrid(rho, rng.uniform(1, 1e4, rho.shape) * (rng.random(rho.shape) < 0.9))
    got, expected = (f(pair, R, t, 1.3) for f in (
        grid.predicted, lambda *a: predicted(grid, *a)))
    assert 0.2 < np.mean(expected[1] > 0) < 0.9
    np.testing.assert_allclose(got[0], expected[0], rtol=1e-12)
    np.testing.assert_allclose(got[1], expected[1], rtol=1e-10)


def test_depths_are_joined_and_noted_as_by_numpy(rng):
    n = 500
    depths = Depths(rng.normal(size=(n, 3)), rng.uniform(0.1, 0.3, n), rng.uniform(0.01, 0.1, n),
                    rng.uniform(-40, [660, 500], (n, 2)))
    before, information = rng.uniform(0.1, 0.3, n), rng.uniform(0, 1e4, n)
    own = depths.sigma**2
    near = (before - depths.rho)**2 * information < depth_grid.GATE * (1 + own * information)
    gain = np.where(near, own * information / (1 + own * information), 0)
    both = depth_grid.joined(depths, before, information)
    assert 0 < near.mean() < 1
    np.testing.assert_allclose(both.rho, depths.rho + gain * (before - depths.rho))
    np.testing.assert_allclose(both.sigma, depths.sigma * np.sqrt(1 - gain))
    chosen = rng.random(n) < 0.7
    grid = depth_grid.noted(640, 480, depths, chosen)
    cell = np.floor((depths.x + 0.5) / 16).astype(int)
    for row in range(30):
        for column in range(40):
            its = chosen & np.all(cell == (column, row), axis=1)
            weight = 1 / own[its]
            assert grid.information[row, column] == pytest.approx(
                weight.mean() if its.any() else 0)
            assert grid.rho[row, column] == pytest.approx(
                np.average(depths.rho[its], weights=weight) if its.any() else 0)
