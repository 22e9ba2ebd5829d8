"""Scores of regions: what is still scores nothing, what cannot be still scores much."""

from typing import NamedTuple

from mv_slapse.config import ExtractionSettings
from mv_slapse.geometry.camera import to_pixels, to_rays
from mv_slapse.movers import score as region_scores
from mv_slapse.movers.moving_plane import fit_surfaces, Regions, View
from mv_slapse.movers.outlines import outlines
from mv_slapse.movers.score import RULES, scores
import numpy as np
import pytest

K = np.array([[700.0, 0, 600], [0, 700, 180], [0, 0, 1]])
T = np.array([0.0, 0.0, -1.0])
HEIGHT = 1.65  # [baseline]
GROUND = np.array([0.0, -1.0, 0.0]) / HEIGHT
GRID = np.stack(np.meshgrid(np.arange(7.5, 1200, 16), np.arange(7.5, 370, 16)), -1).reshape(-1, 2)
FIRST_ROW = 180.0
STEP, BACK = RULES.step, RULES.back
AHEAD = View(K, np.eye(3), T)
NOTHING_TOLD = (np.zeros(1), np.zeros(1))


class Seen(NamedTuple):
    """What scores read of all blocks."""

    x: np.ndarray
    rho: np.ndarray
    noise: np.ndarray
    under: np.ndarray
    copied: np.ndarray


class Blocks(NamedTuple):
    """What outlines read of a region."""

    x: np.ndarray
    vector: np.ndarray
    turned: np.ndarray
    rho: np.ndarray
    noise: np.ndarray

    @property
    def x_prev(self):
        return self.x + self.vector

    @property
    def block(self):
        return np.full(self.x.shape, 16.0)

    @property
    def parallax(self):
        return self.turned - (self.x_prev - self.x)

    @property
    def members(self):
        return np.arange(len(self.x))

    @property
    def first(self):
        return np.zeros(1, int)


def score(depth, motion=(0.0, 0.0, 0.0), low=(-1.0, 0.0), high=(1.0, HEIGHT), ground=GROUND,
          keep=1.0, t=T, below='ground', above=None, copied=0.0, kinds=None, turned=(0.0, 0.0),
          nearer=1.0, camera_height=HEIGHT, land=None):
    """Return the score of an upright face at a depth that moves by ``motion`` in the pair.

    Blocks below it show the ``ground``, the ``face``'s own depth, what is ``nearer``, ``half`` of
    it (the face in the first row), ``terrain`` that goes on as the face's foot lies, ``sunk`` land
    that lies lower than the ground by a third, or ``nothing``; those ``above`` it the 'ground' or
    the 'face'. Of all vectors a share is ``copied``; those of the face are of some ``kinds``, or
    all differ; the camera ``turned`` them [px]. What is ``land`` lies at that share of the
    ground's inverse depth.
    """
    corner = [to_pixels(K, np.array([[*c, depth]]))[0] for c in (low, high)]
    # A block is the face's from a tenth of its height on.
    x = GRID[np.all((corner[0] < GRID) & (corner[1] + (0.0, 6.4) > GRID), axis=1)]
    x = x[np.random.default_rng(0).uniform(size=len(x)) < keep] if keep < 1 else x
    far = np.full(len(x), depth) if land is None else -1 / (land * (to_rays(K, x) @ ground))
    X = to_rays(K, x) * far[:, None]
    x_prev = to_pixels(K, X - np.array(motion) - t)
    regions = Regions(x, x_prev, np.full(len(x), 0.3), np.zeros(1, int))
    apparent = (to_rays(K, x_prev)[:, :2] - to_rays(K, x)[:, :2])
    rho = np.sum(apparent * to_rays(K, x_prev)[:, :2] * t[2], axis=1) / np.maximum(
        np.sum(to_rays(K, x_prev)[:, :2]**2, axis=1), 1e-9)
    vector = x if kinds is None else np.c_[np.arange(len(x)) % kinds, np.zeros(len(x))]
    blocks = Blocks(x, vector, np.tile(turned, (len(x), 1)), rho, np.full(len(x), 0.002))
    outline = outlines(blocks, K, ground, np.array([0.0, -1.0, 0.0]), camera_height)
    fit = fit_surfaces(regions, View(K, np.eye(3), t), GROUND)
    own = seen_as(x, rho, np.zeros(len(x)))
    parts = [own, seen_below(outline, rho.mean(), below, ground)]
    if above is not None:
        parts.append(seen_above(outline, rho.mean(), above, ground))
    seen = Seen(*map(np.concatenate, zip(*parts, strict=True)))
    copies = np.random.default_rng(1).uniform(size=len(seen.x)) < copied
    seen = seen._replace(copied=copies)
    return scores(fit, outline, View(K, np.eye(3), t), seen, nearer, NOTHING_TOLD)[0][0]


def seen_as(x, rho, under):
    """Return blocks with exact inverse depths, none of them copied."""
    n = len(x)
    return Seen(x, rho, np.full(n, 0.002), under, np.zeros(n, bool))


def seen_below(outline, rho, below, ground):
    """Return the blocks of the picture below a face with an apparent inverse depth."""
    x = GRID[GRID[:, 1] > max(outline.foot[0, 1], FIRST_ROW)]
    under = np.zeros(len(x)) if ground is None else -to_rays(K, x) @ ground
    half = np.where(x[:, 1] < outline.foot[0, 1] + 16, rho, under)
    shown = {'ground': under, 'face': np.full(len(x), rho), 'nothing': under,
             'nearer': np.full(len(x), 1.5 * rho), 'half': half,
             'terrain': under * rho / max(outline.under[0], 1e-9), 'sunk': under / 1.33}[below]
    kept = slice(None, 0 if below == 'nothing' else None)
    return seen_as(x[kept], shown[kept], under[kept])


def seen_above(outline, rho, above, ground):
    """Return the blocks between the horizon and the top of a face with an inverse depth."""
    x = GRID[(GRID[:, 1] > FIRST_ROW) & (GRID[:, 1] < outline.low[0, 1])]
    under = -to_rays(K, x) @ ground
    shown = under if above == 'ground' else np.full(len(x), rho)
    return seen_as(x, shown, under)


@pytest.mark.parametrize('depth', [8.0, 14.0, 20.0])
def test_what_stands_on_the_ground_scores_nothing(depth):
    assert score(depth) < 2


@pytest.mark.parametrize('motion', [(0, 0, 1.0), (0, 0, 1.4), (0.5, 0, 0), (0, 0, -1.5)],
                         ids=['same speed', 'faster', 'crossing', 'oncoming'])
def test_what_moves_on_the_ground_scores(motion):
    assert score(12.0, motion) > 9


def test_what_goes_on_below_its_outline_stands_there():
    assert score(12.0, high=(1.0, 1.0), below='face') < 0
    assert score(12.0, (0, 0, -1.5), below='face') < 0


def test_what_is_nearer_than_both_below_an_outline_is_no_ground_either():
    assert score(12.0, (0, 0, -1.5), below='nearer') == score(12.0, (0, 0, -1.5), below='face')


def test_a_body_in_the_air_may_cover_half_of_the_blocks_below_it(monkeypatch):
    covered = score(20.0, (0, 0, -1.0), below='half')
    assert covered > score(20.0, (0, 0, -1.0), below='face') + 5
    monkeypatch.setattr(region_scores, 'RULES', RULES._replace(half_covered=1e-3))
    assert covered > score(20.0, (0, 0, -1.0), below='half') + 0.5


def test_what_seems_to_hover_needs_ground_below_that_is_seen():
    assert score(12.0, (0, 0, -1.5)) > score(12.0, (0, 0, -1.5), below='nothing') + 7
    assert score(12.0, (0, 0, -1.5), below='nothing') < 2


def test_nothing_hovers_over_a_ground_that_may_lie_nearer():
    assert score(12.0, (0, 0, -1.5), nearer=2.0) < 2 < 9 < score(12.0, (0, 0, 1.0), nearer=2.0)


def test_a_body_ends_above_the_ground_that_it_stands_on():
    assert score(12.0, high=(1.0, HEIGHT - 0.25)) < 3
    assert score(12.0, high=(1.0, HEIGHT - 0.5)) < 6


def test_a_high_body_may_end_higher_above_the_ground_than_a_low_one():
    end = {'depth': 8.0, 'high': (1.0, HEIGHT - 0.6)}
    assert score(**end, low=(-1.0, -1.0)) < 0 < 9 < score(**end, low=(-1.0, 0.0))


def test_what_drives_ahead_scores_less_where_no_road_is_seen():
    seen, unseen = (score(12.0, (0, 0, 1.0), below=below) for below in ('ground', 'nothing'))
    assert 2 < unseen < 9 < seen


def test_land_below_the_plane_of_the_road_does_not_move():
    lower = {'high': (-8.0, 1.5 * HEIGHT), 'below': 'terrain'}
    assert score(18.0, low=(-12.0, 0.5 * HEIGHT), **lower) < 2
    assert score(18.0, low=(-12.0, 0.5 * HEIGHT), **lower | {'below': 'ground'}) < 0


def test_what_drives_ahead_on_lower_land_may_stand_there():
    hidden = {'depth': 12.0, 'motion': (0, 0, 1.0)}
    assert score(**hidden, below='sunk') <= 0 < 2 < score(**hidden, below='nothing')
    assert score(**hidden) > 9


def test_land_that_the_road_would_hide_does_not_move_though_road_is_seen_before_it():
    place = {'depth': 12.0, 'low': (-2.0, 0.5 * HEIGHT), 'high': (2.0, HEIGHT)}
    assert score(**place, motion=(0, 0, 0.5)) > 5 > 0 > score(**place, land=0.5)


def test_no_pair_alone_calls_a_region_moving():
    assert score(8.0, (2.0, 0, 0)) < ExtractionSettings().moving_score


def test_what_ends_above_the_horizon_stands_still_however_it_moves():
    assert score(12.0, (0.5, 0, 0), (-1.0, -2.0), (1.0, -0.3)) == BACK


def test_what_is_flat_on_the_road_scores_nothing():
    assert score(8.0, (0, 0, 1.0), (-3.0, 1.1), (3.0, HEIGHT)) <= 0


def test_the_low_part_of_a_car_ahead_scores_where_the_car_goes_on_above_it():
    part = {'depth': 8.0, 'motion': (0, 0, 1.0), 'low': (-1.0, 1.1)}
    assert score(**part, above='face') > 9
    assert score(**part, above='ground') <= 0


@pytest.mark.parametrize(('camera_height', 'is_car'), [(0.5, False), (HEIGHT, True)])
def test_what_is_lower_than_any_car_is_none_unless_it_goes_on_above(camera_height, is_car):
    face = {'depth': 8.0, 'motion': (0, 0, 1.0), 'low': (-1.0, 0.6),
            'camera_height': camera_height}
    assert (score(**face, above='ground') > 0) == is_car
    assert score(**face, above='face') > 0


def test_a_low_bank_that_the_border_cuts_is_no_car():
    bank = {'depth': 8.0, 'motion': (0, 0, 1.0), 'low': (4.0, 1.1), 'high': (9.0, HEIGHT)}
    assert score(**bank, above='face') <= 0


def test_scattered_blocks_are_no_vehicle():
    assert score(8.0, (0.5, 0, 0), keep=0.25) <= 0


def test_a_building_does_not_move_whatever_the_ground_says():
    near = GROUND * 3  # a ground that is wrong by far
    assert score(20.0, low=(-15.0, -6.0), high=(15.0, HEIGHT), ground=near) < 2


def test_without_ground_what_leaves_the_flow_still_scores():
    assert score(12.0, (0.5, 0, 0), ground=None) > 9
    assert score(12.0, (0, 0, -1.5), ground=None) < 2


def test_a_standing_camera_sees_any_motion():
    assert score(12.0, (0.5, 0, 0), ground=None, t=np.zeros(3)) > 9
    assert score(12.0, ground=None, t=np.zeros(3)) < 0


def test_while_the_camera_turns_a_small_share_of_the_turn_is_no_motion():
    moving = {'depth': 12.0, 'motion': (0.04, 0, 0), 'ground': None, 't': np.zeros(3)}
    assert score(**moving) > 9
    assert score(**moving, turned=(40.0, 0.0)) < 2
    assert score(**moving, turned=(0.0, 40.0)) == score(**moving)  # it errs along the turn
    assert score(**moving | {'motion': (0.3, 0, 0)}, turned=(40.0, 0.0)) > 9


@pytest.mark.parametrize('copied', [0.2, 0.4])
def test_among_copied_vectors_a_few_kinds_tell_little(copied):
    moving = {'depth': 8.0, 'motion': (0.5, 0, 0), 'copied': copied}
    assert score(**moving, kinds=3) < 3
    assert score(**moving, kinds=3) < score(**moving, kinds=6) <= score(**moving)


def test_where_no_vector_is_copied_a_few_kinds_tell_all():
    assert score(8.0, (0.5, 0, 0), kinds=3) == score(8.0, (0.5, 0, 0)) == STEP


@pytest.mark.parametrize(('high', 'likelihood', 'expected', 'camera_height'), [
    (1.0, 12.0, 6.0, HEIGHT), (1.0, 100.0, STEP, HEIGHT), (1.0, -3.0, -1.5, HEIGHT),
    (1.0, -100.0, BACK, HEIGHT), (4.0, 100.0, BACK, HEIGHT), (4.0, 12.0, 6.0, HEIGHT / 2),
    (1.0, 12.0, BACK, 6.0)], ids=['a car', 'surely', 'stands', 'surely stands', 'a building',
                                  'a car from below', 'a building from above'])
def test_what_has_left_scores_by_its_blocks_and_is_no_building(high, likelihood, expected,
                                                               camera_height):
    x = GRID[np.all(np.abs(to_rays(K, GRID)[:, :2] * 12 - (0, HEIGHT - high)) < (1, high), axis=1)]
    blocks = Blocks(x, x, np.zeros(x.shape), np.full(len(x), 1 / 12), np.full(len(x), 1 / 120))
    outline = outlines(blocks, K, GROUND, np.array([0.0, -1.0, 0.0]), camera_height)
    seen = seen_as(x, blocks.rho, np.zeros(len(x)))._replace(noise=0.1 * blocks.rho)
    fit = fit_surfaces(Regions(x, x, np.full(len(x), 0.3), np.zeros(1, int)), AHEAD, GROUND)
    _, left, _ = scores(fit, outline, AHEAD, seen, 1.0, (np.array([likelihood]), np.zeros(1)))
    assert left[0] == pytest.approx(expected)


@pytest.mark.parametrize(('evidence', 'motion', 'expected'), [
    (10.0, (0.5, 0, 0), 10 * RULES.bodies), (10.0, (0, 0, 0), 0.0),
    (-1.0, (0.5, 0, 0), 0.0), (1e6, (0.5, 0, 0), None)],
    ids=['seen', 'this pair says no', 'nothing told', 'more than vectors deserve'])
def test_what_several_pairs_tell_counts_where_this_pair_agrees(evidence, motion, expected):
    x = GRID[np.all(np.abs(to_rays(K, GRID)[:, :2] * 12 - (0, HEIGHT - 1)) < 1, axis=1)]
    X = to_rays(K, x) * 12
    x_prev = to_pixels(K, X - np.array(motion) - T)
    blocks = Blocks(x, x, np.zeros(x.shape), np.full(len(x), 1 / 12), np.full(len(x), 1 / 120))
    outline = outlines(blocks, K, GROUND, np.array([0.0, -1.0, 0.0]), HEIGHT)
    fit = fit_surfaces(Regions(x, x_prev, np.full(len(x), 0.3), np.zeros(1, int)), AHEAD, GROUND)
    seen = seen_as(x, blocks.rho, np.zeros(len(x)))
    now, _, lasts = scores(fit, outline, AHEAD, seen, 1.0, (np.zeros(1), np.array([evidence])))
    if expected is None:
        assert STEP < lasts[0] < evidence * RULES.bodies
    else:
        assert lasts[0] == pytest.approx(expected)
        assert (now[0] > 0) == any(motion)
