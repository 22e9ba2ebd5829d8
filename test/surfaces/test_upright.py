"""Blocks of bodies against blocks of a road: a drawn car, a drawn road, wrong vectors."""

from mv_slapse.kernels.binding import compiled
from mv_slapse.motion.observations import Depths
from mv_slapse.surfaces.ground import POLICY
import numpy as np
import pytest

FOCAL, HEIGHT, NEAR = 400.0, 0.8, 0.06
X = np.stack(np.meshgrid(np.arange(7.5, 360, 16), np.arange(7.5, 160, 16)), -1).reshape(-1, 2)
DROP = (X[:, 1] + 4) / FOCAL  # the horizon lies just above the picture
ROAD = DROP / HEIGHT
CAR = (X[:, 0] > 200) & (X[:, 0] < 300) & (X[:, 1] > 20) & (X[:, 1] < 80)


def depths(rho, noise=0.05):
    return Depths(np.c_[X / FOCAL, np.ones(len(X))], rho, noise * np.abs(rho), X)


def on_bodies(depths, drop, known):
    return compiled.on_bodies(*depths.columns, drop, known, POLICY)


def found(rho, known=None, noise=0.05):
    return on_bodies(depths(rho, noise), DROP, np.ones(len(X), bool) if known is None else known)


@pytest.mark.parametrize('near', [NEAR, 0.2])
def test_a_car_rises_from_the_road_however_far_it_looks(rng, near):
    rho = np.where(CAR, near, ROAD) * (1 + 0.03 * rng.standard_normal(len(X)))
    rises = found(rho, noise=0.03)
    assert rises[CAR].mean() > 0.8
    beside = ~CAR & (np.min(np.linalg.norm(X[:, None] - X[CAR], axis=2), axis=1) > 24)
    assert rises[beside].mean() < 0.05


def test_a_road_does_not_whatever_its_height(rng):
    for height in (0.2, 1.0, 5.0):
        assert found(DROP / height * (1 + 0.03 * rng.standard_normal(len(X)))).mean() < 0.01


def test_blocks_too_noisy_to_tell_are_left_alone():
    assert not np.any(found(np.full(len(X), NEAR), noise=0.5))


def test_unknown_and_negative_depths_tell_nothing():
    flat = np.full(len(X), NEAR)
    assert np.any(found(flat))
    assert not np.any(found(flat, known=np.zeros(len(X), bool)))
    assert not np.any(found(-flat))


def test_only_the_block_above_or_below_counts_not_the_one_aside():
    high = X[:, 1] < 60
    row, column = high & (X[:, 1] == X[45, 1]), high & (X[:, 0] == X[45, 0])
    assert not np.any(found(np.full(len(X), NEAR), known=row))
    np.testing.assert_array_equal(found(np.full(len(X), NEAR), known=column), column)


def test_no_block_is_no_body():
    none = depths(np.full(len(X), NEAR))[np.zeros(len(X), bool)]
    assert on_bodies(none, np.zeros(0), np.zeros(0, bool)).shape == (0,)
