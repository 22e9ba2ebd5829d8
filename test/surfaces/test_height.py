"""The height over a bare road: belief over several pairs, right and wrong vectors."""

from dataclasses import replace

from mv_slapse.motion.observations import Depths
from mv_slapse.surfaces import height
from mv_slapse.surfaces.ground import GroundTrack, MISSED, Mount
from mv_slapse.surfaces.height import GRID, HeightBelief, RoadBlocks
import numpy as np
import pytest

FOCAL, PITCH = 700.0, 0.01
WIDE = 50.0  # [baseline]


def road(rng, h, right, wrong=0, at=None, sigma=0.5):
    """Return blocks of a road that ``h`` baselines above which a camera drives straight on.

    ``at`` (px) is the typical length of wrong vectors, which point anywhere.
    """
    n = right + wrong
    x = np.c_[rng.uniform(-0.2, 0.2, n), rng.uniform(0.06, 0.35, n)]
    reach = FOCAL * np.linalg.norm(x, axis=1)  # px of parallax at inverse depth 1, about
    rho = x[:, 1] / h + sigma / reach * rng.normal(size=n)
    error, parallax = rng.normal(size=n), np.abs(rho) * reach
    stray = at * np.exp(0.3 * rng.normal(size=(wrong, 1))) * np.moveaxis(
        np.array([np.cos(turn := rng.uniform(0, 2 * np.pi, wrong)), np.sin(turn)]), 0, 1)
    rho[right:], error[right:] = stray[:, 0] / reach[right:], stray[:, 1] / sigma
    parallax[right:] = np.linalg.norm(stray, axis=1)
    depths = Depths(np.c_[x, np.ones(n)], rho, sigma / reach, FOCAL * x)
    return RoadBlocks(depths, x[:, 1].copy(), error, np.full(n, sigma), parallax, np.ones(n, bool))


def seen(belief, blocks, parallax=4.0, ceiling=WIDE):
    return belief.seen(blocks, PITCH, parallax, ceiling)


def test_nothing_is_known_at_first():
    belief = HeightBelief.blank()
    assert belief.probability.sum() == pytest.approx(1)
    assert belief.spread > 1.5
    assert seen(belief, road(np.random.default_rng(0), 1.0, 0)) is belief


def test_a_dozen_right_vectors_among_as_many_wrong_ones_tell_the_height(rng):
    belief = HeightBelief.blank()
    for _ in range(3):
        belief = seen(belief, road(rng, 1.3, 12, 60, 12.0))
    assert belief.log == pytest.approx(np.log(1.3), abs=0.06)
    assert belief.spread < height.SURE


def test_a_road_seen_far_ahead_tells_its_height_though_the_pitch_is_vague(rng):
    """Near the horizon a pitch that is known to 1 degree makes a third of the depth."""
    belief = HeightBelief.blank()
    for _ in range(12):
        blocks = road(rng, 0.6, 12, 24, 12.0)
        far = replace(blocks, on_way=blocks.drop < 0.1)
        belief = belief.seen(far, 0.02, 4.0, WIDE)
    assert belief.log == pytest.approx(np.log(0.6), abs=0.25)
    assert belief.spread < 0.4


def test_wrong_vectors_of_one_length_are_no_road(rng):
    """Short vectors at random lie on epipolar lines by chance, at heights of their own."""
    belief = HeightBelief.blank()
    for _ in range(6):
        belief = seen(belief, road(rng, 1.0, 0, 200, 8.0))
    assert belief.spread > height.SURE


def test_vectors_shorter_than_the_scene_moves_tell_nothing(rng):
    belief = blind = HeightBelief.blank()
    for _ in range(3):
        blocks = road(rng, 3.0, 80)
        assert blocks.parallax.max() < 60
        belief, blind = seen(belief, blocks), seen(blind, blocks, parallax=60.0)
    assert belief.spread < height.SURE
    assert blind.spread > 1.5


def test_the_ground_is_not_farther_below_than_the_scene_is_away(rng):
    belief = seen(HeightBelief.blank(), road(rng, 8.0, 30), ceiling=4.0)
    assert belief.probability[np.exp(GRID) > 4.0].sum() == 0
    assert belief.probability.sum() == pytest.approx(1)


def test_blocks_that_lie_together_tell_as_much_as_one(rng):
    blocks = road(rng, 1.3, 6)
    patch = replace(blocks, depths=replace(blocks.depths, x=0.1 * blocks.depths.x))
    apart, together = (seen(HeightBelief.blank(), some).spread for some in (blocks, patch))
    assert together > 1.5 * apart


def test_a_ground_that_many_pairs_contradict_is_none():
    p = np.exp(-0.5 * np.square((GRID - np.log(1.3)) / 0.03))
    belief, up = HeightBelief(p / p.sum()), np.array([0.0, -1.0, 0.0])
    assert belief.allows(up / 1.3)
    assert belief.allows(up / 1.4)
    assert not belief.allows(up / 1.6)
    assert not belief.allows(up / 1.05)
    assert HeightBelief.blank().allows(up / 30)


def test_a_ground_that_is_not_seen_gives_way_to_the_height_that_many_pairs_show():
    """A wrong ground at the start of a drive was kept for 50 pairs, and no other was found."""
    p = np.exp(-0.5 * np.square(GRID / 0.03))
    belief, up = HeightBelief(p / p.sum()), np.array([0.0, -1.0, 0.0])
    R, t = np.eye(3), np.array([0.0, 0.0, -1.0])
    track = GroundTrack(Mount(), 0, 2.2 * up, 0.02, 0.01)
    for n in range(3):
        prior = track.prior(R, t, 0.0, 0.0, 0.01)
        assert prior.n_missed == track.n_missed == n
        expected = 2.2 if n < MISSED else 1.0
        assert prior.informed(belief).inverse_depth == pytest.approx(expected, rel=0.01)
        track = track.missed(prior)
    assert track.seen(0, up, 1e-4 * np.eye(3)).n_missed == 0


@pytest.mark.parametrize('log_ratio', [-0.7, 0.0, 0.3])
def test_a_longer_baseline_makes_the_height_smaller(rng, log_ratio):
    belief = seen(HeightBelief.blank(), road(rng, 1.3, 40))
    moved = belief.moved(log_ratio, 0.02)
    assert moved.probability.sum() == pytest.approx(1)
    assert np.all(moved.probability > 0)
    assert moved.log == pytest.approx(belief.log - log_ratio, abs=0.01)
    expected = np.sqrt(belief.spread**2 + 0.02**2 + height.DRIFT**2)
    # Between two cells of the grid it spreads a little.
    assert 0.9 * expected < moved.spread < np.hypot(expected, 0.6 * height.STEP)


def test_an_unknown_ratio_leaves_nothing_known(rng):
    belief = seen(HeightBelief.blank(), road(rng, 1.3, 40))
    assert belief.moved(0.0, 1.5).spread > 1.0
    assert np.isfinite(belief.moved(0.0, np.inf).log)


def test_a_road_of_another_height_is_believed_after_a_while(rng):
    belief = HeightBelief.blank()
    for h in [1.3] * 5 + [2.6] * 5:
        belief = seen(belief.moved(0.0, 0.01), road(rng, h, 20, 20, 12.0))
    assert belief.log == pytest.approx(np.log(2.6), abs=0.06)
