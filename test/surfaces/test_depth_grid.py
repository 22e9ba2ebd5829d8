"""Inverse depths carried from pair to pair, on the canyon and on made-up grids."""

from dataclasses import replace

from canyon import CANYON, HEIGHT, motion, MOTIONS, views, WIDTH
from mv_slapse.geometry import plane as plane_geometry
from mv_slapse.geometry import two_view
from mv_slapse.motion.observations import Depths
from mv_slapse.surfaces import depth_grid
from mv_slapse.surfaces.depth_grid import DepthGrid
import numpy as np
import pytest

FACTOR = 1.2  # a baseline over the one before


def depths_of(scene, sigma=0.04, rng=None):
    """Return the Depths of what is not sky, and which blocks these are."""
    solid = scene.surface >= 0
    rho = scene.rho[solid]
    noise = 0.0 if rng is None else rng.normal(size=len(rho))
    return Depths(scene.pair.rays_cur[solid], rho * (1 + sigma * noise), sigma * rho,
                  scene.x_cur[solid]), solid


def drive(name, pairs, rng=None):
    """Return true inverse depths, depths of the last of some pairs, and what joined them."""
    R, t = motion(name)
    planes, grid = CANYON, None
    for _ in range(pairs):
        scene = views(R, t, planes=planes)
        depths, solid = depths_of(scene, rng=rng)
        seen = depths if grid is None else depth_grid.joined(
            depths, *grid.predicted(scene.pair[solid], R, t, FACTOR))
        grid = depth_grid.noted(WIDTH, HEIGHT, seen)
        planes = np.array([plane_geometry.transform(p * FACTOR, R, t) for p in planes])
    return scene.rho[solid], depths, seen


@pytest.mark.parametrize('name', MOTIONS)
def test_depths_are_carried_along_by_the_motion(name):
    true, depths, seen = drive(name, 2)
    carried = seen.sigma < depths.sigma
    assert carried.mean() > 0.45  # not toward the horizon, where all next door differs
    # An edge of surfaces that differ by less than an edge must mixes some.
    assert np.quantile(np.abs(seen.rho / true - 1), 0.9) < 1e-6


def test_several_pairs_know_depths_better_than_one(rng):
    true, depths, seen = drive('ahead', 6, rng)
    carried = seen.sigma < 0.6 * depths.sigma
    assert carried.mean() > 0.25
    one, several = (np.median(np.abs(d.rho / true - 1)[carried]) for d in (depths, seen))
    assert several < 0.65 * one
    assert np.median(np.abs((seen.rho - true) / seen.sigma)[carried]) < 0.9


@pytest.mark.parametrize('name', MOTIONS)
def test_the_information_is_that_of_the_derivative(name, monkeypatch):
    monkeypatch.setitem(depth_grid.POLICY, 'drift', 0.0)
    monkeypatch.setitem(depth_grid.POLICY, 'forgetting', 1.0)
    R, t = motion(name)
    scene = views(R, t)
    pair, step = scene.pair[scene.surface >= 0], 1e-5
    flat = [DepthGrid(np.full((30, 40), 0.2 + e), np.full((30, 40), 1e4)) for e in (0, step)]
    (low, information), (high, _) = (grid.predicted(pair, R, t, FACTOR) for grid in flat)
    inside = np.all((pair.x_prev > 8) & (pair.x_prev < (WIDTH - 9, HEIGHT - 9)), axis=1)
    place = (pair.x_prev + 0.5) / 16 - 0.5
    share = np.prod(np.square(place % 1) + np.square(1 - place % 1), axis=1)
    slope = (high - low) / step
    np.testing.assert_allclose(1 / np.sqrt(information[inside]),
                               0.01 * (np.abs(slope) * np.sqrt(share))[inside], rtol=1e-3)


def test_nothing_is_known_across_an_edge_nor_outside():
    rho = np.array([[1.0, 1.0, 1.5, 1.5]] * 2)
    grid = DepthGrid(rho, np.full(rho.shape, 100.0))
    x = np.array([[15.5, 15.5], [31.5, 15.5], [47.5, 15.5], [70.0, 15.5], [-40.0, 15.5]])
    rays = np.c_[x / 500, np.ones(5)]
    pair = two_view.Pair(rays, rays, x, np.ones(5), np.eye(3))
    value, information = grid.predicted(pair, np.eye(3), np.zeros(3), 1.0)
    np.testing.assert_array_equal(information > 0, [True, False, True, False, False])
    np.testing.assert_allclose(value[[0, 2]], [1.0, 1.5])


def test_nothing_is_known_of_what_was_behind_the_camera():
    R, t = np.eye(3), np.array([0.0, 0.0, -1.0])
    pair = views(*motion('ahead')).pair
    passed = DepthGrid(np.full((30, 40), 2.0), np.full((30, 40), 100.0))
    assert not passed.predicted(pair, R, t, 1.0)[1].any()


def test_what_agrees_is_joined_by_its_accuracy_and_what_does_not_is_not():
    depths = Depths(np.ones((3, 3)), np.ones(3), np.full(3, 0.1), np.zeros((3, 2)))
    both = depth_grid.joined(depths, np.array([1.1, 1.1, 2.0]), np.array([100.0, 0.0, 100.0]))
    np.testing.assert_allclose(both.rho, [1.05, 1.0, 1.0])
    np.testing.assert_allclose(both.sigma, [0.1 / np.sqrt(2), 0.1, 0.1])


def test_partitions_of_a_macroblock_are_averaged_and_those_outside_left_out():
    x = np.array([[3.5, 3.5], [11.5, 3.5], [40.0, 5.0], [-5.0, 5.0]])
    depths = Depths(np.ones((4, 3)), np.array([1.0, 2.0, 9.0, 9.0]), np.full(4, 0.1), x)
    grid = depth_grid.noted(32, 16, depths)
    np.testing.assert_allclose(grid.rho, [[1.5, 0]])
    np.testing.assert_allclose(grid.information, [[100, 0]])
    sharper = replace(depths, sigma=np.array([0.1, 0.2, 0.1, 0.1]))
    np.testing.assert_allclose(depth_grid.noted(32, 16, sharper).rho, [[1.2, 0]])
