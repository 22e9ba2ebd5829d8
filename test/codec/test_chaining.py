from dataclasses import replace

from mv_slapse.codec.chaining import chain, Chainer, parallax
from mv_slapse.config import DecoderSettings
from mv_slapse.geometry.camera import Camera
from mv_slapse.records import Correspondences, SegmentKind
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

GRID = 16 * np.mgrid[0:15, 0:20][::-1].reshape(2, -1).T.astype(np.float32) + np.float32(7.5)
K = np.array([[300.0, 0, 160], [0, 300, 120], [0, 0, 1]])
CAMERA = Camera(320, 240, K)
SETTINGS = DecoderSettings()
STEP = 40_000_000  # ns


def pair(k, vector, kind=SegmentKind.PP, sigma=0.25):
    n = len(GRID)
    return Correspondences(
        k * STEP, (k - 1) * STEP, 320, 240, kind, x_cur=GRID,
        x_prev=(GRID + vector).astype(np.float32), sigma=np.full(n, sigma, np.float32),
        probability=np.full(n, 0.6, np.float32), block=np.full((n, 2), 16, np.uint8))


def zoom(x, factor=0.99, centre=(160, 120)):
    """Motion of a camera that drives ahead."""
    return (x - centre) * (factor - 1)


def broken(k):
    return Correspondences(k * STEP, (k - 1) * STEP, 320, 240, SegmentKind.BROKEN, reason='lost')


def test_a_chain_of_linear_motions_is_their_product():
    joined = chain(pair(2, zoom(GRID)), pair(1, zoom(GRID, 0.97)), SETTINGS)
    expected = (joined.x_cur - (160, 120)) * 0.99 * 0.97 + (160, 120)
    inside = (np.abs(joined.x_cur - (160, 120)) < (140, 100)).all(axis=1)
    assert len(joined) > 290
    np.testing.assert_allclose(joined.x_prev[inside], expected[inside], atol=0.02)


def test_a_chain_spans_both_times_and_adds_the_variances():
    joined = chain(pair(2, 3, sigma=0.3), pair(1, 2, sigma=0.4), SETTINGS)
    assert (joined.previous_stamp, joined.stamp) == (0, 2 * STEP)
    assert joined.kind is SegmentKind.CHAINED
    np.testing.assert_allclose(joined.sigma, 0.5, rtol=1e-5)
    np.testing.assert_allclose(joined.probability, 0.36, rtol=1e-5)


def test_a_chain_goes_on_along_a_road_though_its_rows_differ_by_more_than_vectors_may():
    def road(x):
        return np.c_[np.zeros(len(x)), -x[:, 1] ** 2 / 1500]

    joined = chain(pair(2, road(GRID)), pair(1, road(GRID)), SETTINGS)
    between = joined.x_cur + road(joined.x_cur)
    near = joined.x_cur[:, 1] > 150
    rows = np.diff(np.unique(road(GRID)[:, 1])).max()
    assert rows > SETTINGS.agreement_slack + SETTINGS.agreement_tolerance * 36
    np.testing.assert_allclose(joined.x_prev[near], (between + road(between))[near], atol=0.06)


def test_a_chain_follows_the_block_it_leads_to():
    older = np.where(GRID[:, :1] < 160, (-2.0, 0.0), (5.0, 0.0))
    joined = chain(pair(2, (32, 0)), pair(1, older), SETTINGS)
    moved = joined.x_prev[:, 0] - joined.x_cur[:, 0]
    left = joined.x_cur[:, 0] + 32 < 150
    right = joined.x_cur[:, 0] + 32 > 170
    np.testing.assert_allclose(moved[left], 30)
    np.testing.assert_allclose(moved[right], 37)


def test_a_chain_that_leads_nowhere_is_dropped():
    older = pair(1, 1)
    there = GRID[:, 0] < 100
    part = Correspondences(STEP, 0, 320, 240, SegmentKind.PP, x_cur=GRID[there],
                           x_prev=older.x_prev[there], sigma=older.sigma[there],
                           probability=older.probability[there], block=older.block[there])
    joined = chain(pair(2, 0), part, SETTINGS)
    assert len(joined) > 0
    assert joined.x_cur[:, 0].max() < 116


def test_a_chain_through_an_empty_pair_is_empty():
    empty = Correspondences(STEP, 0, 320, 240, SegmentKind.PP)
    assert len(chain(pair(2, 1), empty, SETTINGS)) == 0


def with_lone(whole, rows, vector):
    """Return a pair in which some rows have vectors of their own that nothing supports."""
    x_prev, probability = whole.x_prev.copy(), whole.probability.copy()
    x_prev[rows] = whole.x_cur[rows] + vector
    probability[rows] *= 0.2
    return replace(whole, x_prev=x_prev, probability=probability)


@pytest.mark.parametrize(('before', 'stays'), [((15, 3), True), ((-6, 12), False)])
def test_a_lone_vector_is_chained_to_a_lone_one_that_goes_on_as_it_did(before, stays):
    row = [150]
    newer = with_lone(pair(2, (1, 0)), row, (16, 2))
    older = with_lone(pair(1, (1, 0)), [151], before)
    joined = chain(newer, older, SETTINGS)
    at = np.flatnonzero(np.all(joined.x_cur == GRID[row], axis=1))
    assert len(at) == stays
    assert joined.lone.sum() == stays
    if stays:
        np.testing.assert_allclose((joined.x_prev - joined.x_cur)[at], [[31, 5]], atol=0.5)


def test_lone_vectors_do_not_bend_a_chain():
    older = with_lone(pair(1, (2, 0)), [150, 171], (9, 9))
    joined = chain(pair(2, (1, 0)), older, SETTINGS)
    assert not joined.lone.any()
    np.testing.assert_allclose(joined.x_prev - joined.x_cur, np.broadcast_to((3, 0), (
        len(joined), 2)), atol=1e-5)


@pytest.mark.parametrize('camera', [CAMERA, None])
def test_parallax_is_what_a_rotation_leaves(rng, camera):
    rays = np.c_[(GRID - (160, 120)) / 300, np.ones(len(GRID))]
    turned = rays @ Rotation.from_rotvec(rng.normal(0, 0.02, 3)).as_matrix().T
    turn = turned[:, :2] / turned[:, 2:] * 300 + (160, 120) - GRID
    assert parallax(pair(1, turn), camera) < (0.02 if camera else 2.0)
    assert parallax(pair(1, turn + zoom(GRID, 0.9)), camera) == pytest.approx(
        np.quantile(np.hypot(*zoom(GRID, 0.9).T), 0.7), rel=0.2)


def test_traffic_that_keeps_its_distance_does_not_hide_the_parallax():
    ahead = np.abs(GRID - (160, 120)) < (125, 85)
    flow = np.where(ahead.all(axis=1)[:, None], 0, zoom(GRID, 0.8))
    assert np.median(np.hypot(*flow.T)) == 0
    assert parallax(pair(1, flow), CAMERA) > 0.8 * parallax(pair(1, zoom(GRID, 0.8)), CAMERA)


def test_parallax_of_next_to_nothing_is_nothing():
    assert parallax(Correspondences(1, 0, 320, 240, SegmentKind.PP), CAMERA) == 0


def published(pairs, **changes):
    chainer = Chainer(DecoderSettings(**changes), CAMERA)
    return [out for item in pairs for out in chainer.add(item)] + chainer.flush()


def test_a_pair_of_enough_parallax_is_published_as_it_is():
    one = pair(1, zoom(GRID, 0.9))
    assert published([one]) == [one]


def test_slow_motion_is_chained_until_the_parallax_is_enough():
    out = published([pair(k, zoom(GRID, 0.99)) for k in range(1, 31)], max_chain_time=9.0,
                    max_chain=100)
    spans = [item.stamp - item.previous_stamp for item in out]
    assert all(parallax(item, CAMERA) >= SETTINGS.min_parallax for item in out[:-1])
    assert min(spans[:-1]) > STEP
    assert max(spans) < 10 * STEP


@pytest.mark.parametrize(('flow', 'links'), [(0.9, 2), (0.5, 1)])
def test_what_moves_fast_is_chained_too_unless_it_moves_too_far(flow, links):
    pairs = [pair(k, zoom(GRID, flow)) for k in range(1, 5)]
    out = published(pairs, min_chain_time=1.5 * STEP / 1e9)
    assert out[0].stamp == links * STEP


def test_a_camera_that_stands_still_is_heard_of_in_time():
    out = published([pair(k, 0) for k in range(1, 31)])
    spans = [item.stamp - item.previous_stamp for item in out]
    assert max(spans) <= SETTINGS.max_chain_time * 1e9


def test_published_pairs_are_contiguous_and_broken_ones_stay_alone():
    pairs = [pair(k, 0) for k in range(1, 9)] + [broken(9)] + [pair(k, 0) for k in range(10, 20)]
    out = published(pairs)
    assert out[0].previous_stamp == 0
    assert out[-1].stamp == 19 * STEP
    assert all(a.stamp == b.previous_stamp for a, b in zip(out, out[1:], strict=False))
    assert [item.stamp for item in out if item.kind is SegmentKind.BROKEN] == [9 * STEP]
