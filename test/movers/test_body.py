"""Bodies below the ground: drawn blocks, each of which by itself may be ground."""

from typing import NamedTuple

from mv_slapse.movers.body import RULES, with_bodies
import numpy as np
import pytest

WIDTH, HEIGHT = 640, 1.65  # px, m
HORIZON, SLOPE = 240.0, 8e-4  # row; inverse depth of the ground for each row below it [1/baseline]
NOISE = 0.14  # of a block's inverse depth, as a share of the ground's there
CAR, FOOT = (380.0, 448.0), 296.0  # columns and lowest row of a car [px]
X = np.stack(np.meshgrid(np.arange(7.5, 640, 16), np.arange(7.5, 480, 16)), -1).reshape(-1, 2)
X = X[X[:, 1] > HORIZON + 4]
UNDER = SLOPE * (X[:, 1] - HORIZON)
ON_CAR = (X[:, 0] > CAR[0]) & (X[:, 0] < CAR[1]) & (X[:, 1] < FOOT)
NEARNESS = 0.4  # of the car, as a share of the ground's at its foot
# Where the ground is nearer than the car by more than two standard deviations of a block.
HIDING = ON_CAR & (X[:, 1] > HORIZON + 1.4 * NEARNESS * (FOOT - HORIZON))


class Field(NamedTuple):
    """What with_bodies reads of regions."""

    x: np.ndarray
    rho: np.ndarray
    noise: np.ndarray
    foreseen: np.ndarray
    under: np.ndarray
    below: np.ndarray
    fits: np.ndarray
    members: np.ndarray = np.zeros(0, int)
    first: np.ndarray = np.zeros(0, int)


def blocks(seed=0, car=NEARNESS, ground=1.0, noise=NOISE):
    """Return blocks of a ground, and of a car with a share of its inverse depth at the foot."""
    rng = np.random.default_rng(seed)
    rho = ground * UNDER
    if car is not None:
        rho = np.where(ON_CAR, car * SLOPE * (FOOT - HORIZON), rho)
    sigma = noise * UNDER
    none = np.zeros(len(X), bool)
    unknown = np.tile((0.0, np.inf), (len(X), 1))
    return Field(X, rho + sigma * rng.standard_normal(len(X)), sigma, unknown, UNDER, none, ~none)


def bodies(field):
    """Return the blocks of each body."""
    return with_regions([], field)


def with_regions(regions, field):
    """Return the blocks of each region and body, given those of regions."""
    first = np.cumsum([0, *map(len, regions)])[:-1] if regions else np.zeros(0, int)
    members, first = with_bodies(field._replace(
        members=np.concatenate([np.zeros(0, int), *regions]), first=first), WIDTH, HEIGHT)
    return np.split(members, first[1:]) if len(first) else []


def is_alone(given):
    """Return which blocks would look farther than the ground by themselves."""
    return given.rho + 3 * given.noise < 0.8 * given.under


@pytest.mark.parametrize('seed', range(5))
def test_blocks_that_may_each_be_ground_make_a_body(seed):
    given = blocks(seed)
    assert np.mean(is_alone(given)[HIDING]) <= 0.5
    largest = max(bodies(given), key=len)
    assert np.mean(np.isin(np.flatnonzero(HIDING), largest)) >= 0.6
    assert np.mean(ON_CAR[largest]) >= 0.9


@pytest.mark.parametrize('seed', range(5))
def test_ground_alone_makes_no_body(seed):
    assert all(len(body) < 4 for body in bodies(blocks(seed, car=None)))


@pytest.mark.parametrize('seed', range(3))
def test_what_is_nearer_than_the_ground_makes_no_body(seed):
    assert all(len(body) < 4 for body in bodies(blocks(seed, car=1.6)))


@pytest.mark.parametrize('seed', range(3))
def test_a_ground_that_is_not_where_it_should_be_hides_nothing(seed):
    assert all(len(body) < 6 for body in bodies(blocks(seed, car=None, ground=0.7)))


def test_a_body_is_bounded_by_its_depth_not_by_what_is_wrong():
    given = blocks(0)
    wrong = ON_CAR & (X[:, 0] < CAR[0] + 16)
    given.rho[wrong] = -2 * UNDER[wrong]
    largest = max(bodies(given), key=len)
    assert not np.any(wrong[largest])


def test_one_vector_makes_no_body():
    one = np.flatnonzero(HIDING)[:1]
    given = Field(*(values[one] for values in blocks(0, noise=0.01)[:7]))
    assert is_alone(given).all()
    assert not bodies(given)


def test_no_blocks_make_no_body():
    assert bodies(Field(*(values[:0] for values in blocks()[:7]))) == []


def test_a_body_takes_the_blocks_of_regions_that_look_as_far():
    given = blocks(0)
    below = np.zeros(len(X), bool)
    fragment = np.flatnonzero(HIDING & (X[:, 1] > FOOT - 16))
    below[fragment] = True
    part = np.flatnonzero(HIDING & (X[:, 0] < CAR[0] + 16))
    apart = np.flatnonzero(X[:, 0] < 60)[:6]
    regions = with_regions([part, apart, fragment], given._replace(below=below))
    assert any(np.array_equal(region, apart) for region in regions)
    largest = max(regions, key=len)
    assert len(largest) > len(fragment)
    assert sum(np.isin(largest, region).any() for region in regions) == 1


def test_blocks_make_a_body_that_the_pairs_before_foresaw():
    given = blocks(0, noise=0.7)
    foreseen = np.where(ON_CAR, NEARNESS * SLOPE * (FOOT - HORIZON), UNDER)
    sure = given._replace(foreseen=np.c_[foreseen, 0.1 * UNDER])
    shares = [max((np.mean(np.isin(np.flatnonzero(HIDING), body)) for body in bodies(field)),
                  default=0.0) for field in (given, sure)]
    assert shares[0] < 0.2
    assert shares[1] > 0.6


def test_a_vector_that_contradicts_what_was_foreseen_makes_none():
    given = blocks(0)
    assert not bodies(given._replace(foreseen=np.c_[UNDER, 0.1 * UNDER]))


def test_no_body_is_wider_than_a_vehicle():
    given = blocks(0)
    rows = (X[:, 1] < FOOT) & (X[:, 1] > HORIZON + 1.4 * NEARNESS * (FOOT - HORIZON))
    given.rho[rows] = NEARNESS * SLOPE * (FOOT - HORIZON)
    for body in bodies(given):
        assert np.ptp(X[body, 0]) < RULES.widest / HEIGHT * (FOOT - HORIZON)


def test_what_surrounds_a_larger_region_is_none_by_itself():
    given = blocks(0)
    ring = (X[:, 0] > CAR[0] - 40) & (X[:, 0] < CAR[1] + 40) & (X[:, 1] < FOOT + 20)
    inside = np.flatnonzero(ring & ~HIDING)
    below = np.isin(np.arange(len(X)), inside)
    assert len(inside) > HIDING.sum()
    regions = with_regions([inside], given._replace(below=below, fits=~below))
    assert len(regions) == 1
    assert np.array_equal(regions[0], inside)


def test_only_blocks_that_follow_their_epipolar_lines_count():
    given = blocks(0)
    assert bodies(given)
    assert not bodies(given._replace(fits=~ON_CAR))
