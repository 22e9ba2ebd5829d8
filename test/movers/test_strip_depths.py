"""Depths of strips by where they were a while ago: drawn blocks of a known road and a car."""

from mv_slapse.movers.moving_plane import View
from mv_slapse.movers.regions import _Alike
from mv_slapse.movers.strip_depths import RULES, Way, with_strips
from mv_slapse.strip_matches import SIZE, SPAN, StripMatches
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

FOCAL, HEIGHT = 500.0, 1.65  # px, m
K = np.array([[FOCAL, 0, 320], [0, FOCAL, 240], [0, 0, 1.0]])
STEP = 0.8  # [m] that the camera goes in a pair
PAIRS = 4
TURN = Rotation.from_rotvec([0.002, -0.004, 0.001]).as_matrix()
UNIT = np.array([0.05, 0.02, -1.0]) / np.linalg.norm([0.05, 0.02, -1.0])
VIEW = View(K, TURN, UNIT)
GROUND = np.array([0.0, -1.0, 0.0]) * STEP / HEIGHT  # n / d in the later camera [1/baseline]
SIGMA = 0.6  # px
DT = 100_000_000  # [ns]


def way(pairs=PAIRS):
    """The way over some pairs, the last of which ends at pairs * DT."""
    made = Way()
    for k in range(pairs):
        made = made.gone_on((k * DT, (k + 1) * DT), VIEW, STEP / HEIGHT)
    return made


def poses(pairs):
    """R, t of X_now = R X_then + t [baseline] over some equal pairs."""
    R, t = np.eye(3), np.zeros(3)
    for _ in range(pairs):
        R, t = TURN @ R, TURN @ t + UNIT
    return R, t


def seen_then(x, Z, pairs, gone=0.0):
    """Pixels (N, 2) where points were, Z [baseline] away now, which went a share of the way."""
    rays = np.c_[x, np.ones(len(x))] @ np.linalg.inv(K).T
    R, t = poses(pairs)
    then = (rays * Z[:, None] - (1 - gone) * t) @ R @ K.T
    return then[:, :2] / then[:, 2:]


def blocks(x=(), height=16, rho=0.1, noise=0.02):
    """A pair's own blocks."""
    x = np.reshape(x, (-1, 2)).astype(float)
    n = len(x)
    none = np.zeros(n, bool)
    return _Alike(x, x + 1, np.tile([16.0, height], (n, 1)), np.full(n, 0.4), np.full(n, 0.5),
                  np.full(n, 3, np.int32), none, np.ones((n, 2)), np.full(n, rho),
                  np.full(n, noise), np.full(n, 0.08), ~none, none, none, none, none,
                  np.zeros(0, np.int64), np.zeros(0, np.int64), n)


STRIPS = np.array([[100.0, 300], [250, 330], [400, 310], [520, 290], [330, 400]])


def strips(Z, pairs=PAIRS, x=STRIPS, gone=0.0):
    there = seen_then(x, np.full(len(x), Z) if np.isscalar(Z) else Z, pairs, gone)
    return StripMatches((PAIRS - pairs) * DT, x.astype(np.float32), there.astype(np.float32),
                        np.full(len(x), SIGMA, np.float32))


def told(given, own=None):
    return with_strips(blocks() if own is None else own, given, way(), VIEW, GROUND)


@pytest.mark.parametrize('pairs', [1, 2, PAIRS])
def test_the_depth_of_what_stands_still_is_found(pairs):
    Z = np.array([12.0, 9.0, 30.0, 60.0, 6.0])
    seen = told(strips(Z, pairs))
    np.testing.assert_allclose(seen.rho, 1 / Z, rtol=1e-3, atol=1e-5)
    np.testing.assert_allclose(seen.under, STEP / HEIGHT * (STRIPS[:, 1] - 240) / FOCAL, rtol=1e-4)
    # As the pair would have shown it.
    np.testing.assert_allclose(seen.x_prev, seen_then(STRIPS, Z, 1), atol=2e-3)
    np.testing.assert_allclose(seen.x, STRIPS, atol=1e-9)
    assert seen.fits.all()
    assert not (seen.ground_like | seen.far | seen.copied | seen.below | seen.wrong).any()
    np.testing.assert_array_equal(seen.block, np.tile(SIZE, (5, 1)))
    np.testing.assert_array_equal(seen.plane_id, -1)
    np.testing.assert_array_equal(seen.departure, 0)


def test_what_drives_ahead_at_a_part_of_the_speed_looks_farther():
    seen = told(strips(20.0, gone=0.3))
    np.testing.assert_allclose(seen.rho, 0.7 / 20.0, rtol=1e-3)


def test_noise_is_the_numerical_derivative():
    Z, step = np.array([12.0, 9.0, 30.0, 60.0, 6.0]), 1e-2
    seen = told(strips(Z))
    R, t = poses(PAIRS)
    rays = np.c_[seen_then(STRIPS, Z, PAIRS), np.ones(5)] @ np.linalg.inv(K).T @ R.T
    line = t[:2] - rays[:, :2] / rays[:, 2:] * t[2]
    line /= np.hypot(*line.T)[:, None]
    # Along the epipolar line, as rotated into the later camera.
    moved = rays / rays[:, 2:]
    moved[:, :2] += step / FOCAL * line
    there = moved @ R @ K.T
    there = there[:, :2] / there[:, 2:]
    given = strips(Z)
    more = told(StripMatches(given.stamp, given.x_cur, there.astype(np.float32), given.sigma))
    np.testing.assert_allclose(np.abs(more.rho - seen.rho) / step * SIGMA, seen.noise, rtol=0.05)
    pair = told(strips(Z, 1))
    assert np.all(seen.noise < (1 / PAIRS + 0.27) * pair.noise)


def test_what_leaves_its_epipolar_line_tells_nothing():
    given = strips(15.0)
    across = given.x_earlier + np.float32(1.5 * RULES.passes) * np.array(
        [[0, 1], [0, 1], [0, 1], [1, 0], [1, 0]], np.float32)
    seen = told(StripMatches(given.stamp, given.x_cur, across, given.sigma))
    assert 0 < len(seen.x) < 5
    assert len(told(StripMatches(given.stamp, given.x_cur, given.x_earlier + np.float32(30),
                                 given.sigma)).x) == 0


def test_a_strip_that_is_a_block_tells_it_better():
    own = blocks(STRIPS[:2], 4, rho=1 / 14, noise=0.02)
    seen = told(strips(15.0), own)
    assert len(seen.x) == 5  # in place of its own, then the others
    np.testing.assert_allclose(seen.rho, 1 / 15, rtol=1e-3)
    np.testing.assert_array_equal(seen.plane_id, [3, 3, -1, -1, -1])
    np.testing.assert_array_equal(seen.ground_like, [1, 1, 0, 0, 0])
    np.testing.assert_array_equal(own.rho, 1 / 14)  # given ones stay,
    np.testing.assert_array_equal(seen.x_prev[:2], own.x_prev)  # and what they show of this pair
    np.testing.assert_array_equal(seen.parallax[:2], own.parallax)


@pytest.mark.parametrize(('rho', 'noise'), [(0.5, 0.02), (1 / 14, 1e-4)])
def test_a_block_keeps_a_depth_that_is_better_or_another(rho, noise):
    own = blocks(STRIPS[:2], 4, rho, noise)
    seen = told(strips(15.0), own)
    assert len(seen.x) == 5
    np.testing.assert_array_equal(seen.rho[:2], rho)
    np.testing.assert_array_equal(seen.x_prev[:2], own.x_prev)


def test_a_macroblock_at_the_same_place_stays_beside_its_strip():
    seen = told(strips(15.0), blocks(STRIPS[:2], 16))
    assert len(seen.x) == 7
    np.testing.assert_array_equal(seen.rho[:2], 0.1)


def test_where_the_way_is_not_known_nothing_is_told():
    own, given = blocks(STRIPS), strips(15.0)
    assert with_strips(own, given, Way(), VIEW, GROUND) is own
    late = StripMatches(17, given.x_cur, given.x_earlier, given.sigma)
    assert with_strips(own, late, way(), VIEW, GROUND) is own
    back = View(K, TURN, -UNIT)
    made = Way().gone_on((0, DT), back, STEP / HEIGHT)
    assert with_strips(own, given, made, back, GROUND) is own


def test_the_way_is_as_long_as_strips_reach_back():
    made = way(20)
    assert made.stamp == tuple(k * DT for k in range(15, 20))
    assert 20 * DT - made.stamp[0] == SPAN
    R, t = made.since(16 * DT, STEP / HEIGHT)
    np.testing.assert_allclose(R, poses(4)[0], atol=1e-12)
    np.testing.assert_allclose(t, poses(4)[1], atol=1e-12)
    assert made.since(10 * DT, 1.0) is None


def test_its_lengths_are_heights_of_the_camera():
    made = Way().gone_on((0, DT), VIEW, 0.5).gone_on((DT, 3 * DT), VIEW, 1.0)
    _, t = made.since(0, 1.0)
    np.testing.assert_allclose(t, TURN @ UNIT / 2 + UNIT)
