"""Bodies below the ground: drawn blocks, each of which by itself may be ground."""

from typing import NamedTuple

from mv_slapse.movers.body import Bodies, RULES, with_bodies
from mv_slapse.movers.moving_plane import View
import numpy as np
import pytest

SIZE, HEIGHT = (640, 480), 1.65  # px, m
HORIZON, SLOPE = 240.0, 8e-4  # row; inverse depth of the ground for each row below it [1/baseline]
NOISE = 0.14  # of a block's inverse depth, as a share of the ground's there
FOCAL = 500.0
GROUND = np.array([0.0, -SLOPE * FOCAL, 0.0])  # n / d [1/baseline]
CAR, FOOT = (380.0, 448.0), 296.0  # columns and lowest row of a car [px]
K = np.array([[FOCAL, 0, 320], [0, FOCAL, HORIZON], [0, 0, 1]])
BESIDE = View(K, np.eye(3), np.array([0.4, 0.0, -1.0]))  # of the car
AHEAD = View(K, np.eye(3), np.array([(320 - sum(CAR) / 2) / FOCAL, 0.0, -1.0]))  # towards it
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
    under: np.ndarray
    below: np.ndarray
    fits: np.ndarray
    members: np.ndarray = np.zeros(0, int)
    first: np.ndarray = np.zeros(0, int)
    own: int = len(X)


def blocks(seed=0, car=NEARNESS, ground=1.0, noise=NOISE):
    """Return blocks of a ground, and of a car with a share of its inverse depth at the foot."""
    rng = np.random.default_rng(seed)
    rho = ground * UNDER
    if car is not None:
        rho = np.where(ON_CAR, car * SLOPE * (FOOT - HORIZON), rho)
    sigma = noise * UNDER
    none = np.zeros(len(X), bool)
    return Field(X, rho + sigma * rng.standard_normal(len(X)), sigma, UNDER, none, ~none)


def bodies(field):
    """Return the blocks of each body."""
    return with_regions([], field)


def with_regions(regions, field):
    """Return the blocks of each region and body, given those of regions."""
    first = np.cumsum([0, *map(len, regions)])[:-1] if regions else np.zeros(0, int)
    members, first, *_ = told(field._replace(
        members=np.concatenate([np.zeros(0, int), *regions]), first=first))
    return np.split(members, first[1:]) if len(first) else []


def told(field, before=None, view=BESIDE):
    """Return all that with_bodies does."""
    return with_bodies(field, view, GROUND, HEIGHT, SIZE, before or Bodies())


def evidence_of(fields, view):
    """Return the evidence of the surest body after some pairs, 0 without any."""
    before = Bodies()
    for field in fields:
        *_, evidence, before = told(field, before, view)
    return max(evidence, default=0.0)


def is_alone(given):
    """Return which blocks would look farther than the ground by themselves."""
    return given.rho + 3 * given.noise < 0.8 * given.under


@pytest.mark.parametrize('seed', range(5))
def test_blocks_that_may_each_be_ground_make_a_body(seed):
    given = blocks(seed)
    assert np.mean(is_alone(given)[HIDING]) <= 0.5
    *_, before = told(blocks(seed + 50), view=AHEAD)
    members, first, *_ = told(given, before, AHEAD)
    largest = max(np.split(members, first[1:]), key=len)
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
    given = Field(*(values[one] for values in blocks(0, noise=0.01)[:6]))
    assert is_alone(given).all()
    assert not bodies(given)


def test_no_blocks_make_no_body():
    assert bodies(Field(*(values[:0] for values in blocks()[:6]))) == []


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


def test_several_pairs_tell_what_none_of_them_does():
    pairs = [blocks(seed) for seed in range(6)]
    sums = [evidence_of(pairs[:n], AHEAD) for n in range(1, 7)]
    assert max(evidence_of([pair], AHEAD) for pair in pairs) < 8
    assert sums[-1] > 16
    assert sums == sorted(sums)


def test_what_lies_beside_the_way_ahead_is_not_summed():
    assert evidence_of([blocks(seed) for seed in range(6)], BESIDE) < 8


def test_ground_that_shows_takes_back_what_was_told():
    pairs = [blocks(seed) for seed in range(4)]
    ground = [blocks(seed, car=None) for seed in range(9)]
    assert evidence_of(pairs, AHEAD) > 16
    assert evidence_of(pairs + ground, AHEAD) == 0


@pytest.mark.parametrize('seed', range(5))
def test_ground_alone_never_sums_up(seed):
    assert evidence_of([blocks(100 * seed + i, car=None) for i in range(20)], AHEAD) < 8


def test_what_was_told_goes_on_as_what_stands_still_comes_nearer():
    *_, before = told(blocks(0, noise=0.02), view=AHEAD)
    own = int((CAR[0] + 24) // 16)
    turned = View(K, np.array([[np.cos(0.1), 0, np.sin(0.1)], [0, 1, 0],
                               [-np.sin(0.1), 0, np.cos(0.1)]]), AHEAD.t)
    nothing = Field(*(values[:0] for values in blocks()[:6]))
    for view, shift in ((AHEAD, 0), (turned, 3)):  # 0.1 rad are three columns
        *_, after = told(nothing, before, view)
        share = after.told[:, own + shift].max() / before.told[:, own].max()
        assert 0.7 < share <= 0.95
    *_, after = told(nothing, before, AHEAD)
    heaviest = [np.average(1 / bodies.depths, weights=bodies.told[:, own])
                for bodies in (before, after)]
    assert heaviest[0] - heaviest[1] == pytest.approx(np.linalg.norm(GROUND), rel=0.2)


def test_pictures_of_another_size_begin_anew():
    *_, before = told(blocks(0), view=AHEAD)
    *_, after = with_bodies(blocks(0, car=None), AHEAD, GROUND, HEIGHT, (320, 480), before)
    assert after.told.shape == (32, 20)


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


def test_strips_alone_are_no_body():
    given = blocks()
    found = bodies(given)
    assert found
    last = min(body[0] for body in found)
    assert not bodies(given._replace(own=int(last)))
    assert [list(body) for body in bodies(given._replace(own=int(last) + 1))] == [
        list(body) for body in found if body[0] == last]
