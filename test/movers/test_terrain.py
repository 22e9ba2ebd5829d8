"""Land at another height than the road against bodies, drawn as inverse depths with noise."""

from types import SimpleNamespace

from mv_slapse.movers.outlines import outlines
import numpy as np
import pytest

ROWS = np.repeat(np.arange(20.0, 120.0, 16.0), 4) / 700.0  # of blocks, below the horizon
UNDER = ROWS / 1.65  # inverse depth of the road there [1/m]
SIGMA = 0.001
K = np.diag([700.0, 700.0, 1.0])


def land_rather(rho, sigma, under, first):
    """Return how much rather regions show land than a body, by blocks in rows of the road."""
    x = np.c_[16.0 * np.arange(len(rho)), 700 * 1.65 * under]
    nothing = np.zeros_like(x)
    blocks = SimpleNamespace(x=x, x_prev=x, block=np.full(x.shape, 16.0), parallax=nothing,
                             rho=rho, noise=sigma, members=np.arange(len(x)), first=first)
    return outlines(blocks, K, np.array([0, -1 / 1.65, 0]), None, 1.65).land


def rather(rho, under=UNDER, rng=None):
    noise = 0.0 if rng is None else SIGMA * rng.standard_normal(len(rho))
    return land_rather(rho + noise, np.full(len(rho), SIGMA), under, np.zeros(1, int))[0]


@pytest.mark.parametrize('share', [0.3, 0.6, 0.9])
def test_what_lies_in_one_proportion_to_the_road_is_land(rng, share):
    assert rather(share * UNDER, rng=rng) > 20


@pytest.mark.parametrize('rho', [0.005, 0.03, 0.06])
def test_what_shows_one_depth_is_none(rng, rho):
    assert rather(np.full(len(ROWS), rho), rng=rng) == 0


def test_nothing_still_looks_farther_than_infinity(rng):
    assert rather(-0.5 * UNDER, rng=rng) == 0


def test_a_single_row_does_not_tell(rng):
    row = slice(8, 12)
    assert rather(0.6 * UNDER[row], UNDER[row], rng) < 0.5


def test_wrong_vectors_change_little(rng):
    rho = 0.6 * UNDER
    right = rather(rho, rng=rng)
    rho[[2, 13]] = 0.5
    assert rather(rho, rng=rng) > 0.7 * right


def test_land_is_no_plane_however_sharp_its_vectors(rng):
    rho = 0.6 * UNDER * (1 + 0.05 * rng.standard_normal(len(UNDER)))
    sharp = land_rather(rho, np.full(len(rho), 1e-5), UNDER, np.zeros(1, int))[0]
    assert sharp > 20


def test_blocks_above_the_horizon_tell_nothing(rng):
    rho, above = 0.6 * UNDER, np.full(5, -0.01)
    assert rather(np.r_[rho, np.full(5, 0.2)], np.r_[UNDER, above]) == rather(rho)
    assert rather(np.full(5, 0.2), above) == 0


def test_regions_are_judged_each_by_itself(rng):
    parts = [0.6 * UNDER, np.full(len(ROWS), 0.03), 0.4 * UNDER[4:]]
    under, first = np.r_[UNDER, UNDER, UNDER[4:]], np.array([0, len(ROWS), 2 * len(ROWS)])
    together = land_rather(np.concatenate(parts), np.full(len(under), SIGMA), under, first)
    alone = [rather(part, UNDER[-len(part):]) for part in parts]
    np.testing.assert_allclose(together, alone, rtol=1e-12)
