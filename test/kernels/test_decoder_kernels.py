"""Kernels of the decoder against their formulas in numpy, on drawn pictures and segments."""

from dataclasses import replace

from formulas import leaning
from kernels import chaining_reference, evidence_reference, merging_reference
from mv_slapse.codec import evidence, merging
from mv_slapse.codec.chaining import chain, parallax
from mv_slapse.codec.evidence import Evidence
from mv_slapse.codec.motion_vectors import FrameVectors
from mv_slapse.codec.segments import Segment
from mv_slapse.config import DecoderSettings
from mv_slapse.geometry.camera import Camera
from mv_slapse.kernels.binding import compiled
from mv_slapse.records import Correspondences, FrameType, SegmentKind
import numpy as np
import pytest

WIDTH, HEIGHT = 200, 150  # px, cut macroblocks at the right and at the bottom
SETTINGS = DecoderSettings()
CAMERA = Camera(WIDTH, HEIGHT, np.array([[180.0, 0.5, 99], [0, 170, 76], [0, 0, 1]]))
ULP = 3e-7  # of float32, a few of them


def picture(rng, kind, **changes):
    """Blocks of all sizes with vectors of quarter pixels, some of them wrong."""
    rows = []
    for y, x in np.ndindex(-(-HEIGHT // 16), -(-WIDTH // 16)):
        w, h = [(16, 16), (16, 8), (8, 16), (8, 8)][rng.choice(4, p=[0.7, 0.1, 0.1, 0.1])]
        for dy, dx in np.ndindex(16 // h, 16 // w):
            for direction in ((-1, 1) if kind is FrameType.B else (-1,)):
                if rng.random() < 0.9:
                    rows.append((16 * x + w * dx + w / 2 - 0.5, 16 * y + h * dy + h / 2 - 0.5,
                                 direction, w, h))
    x, y, direction, w, h = np.array(rows).T
    motion = -direction[:, None] * np.stack([x - 90, y + 20], 1) * 0.05
    wrong = rng.random(len(x)) < 0.15
    motion[wrong] += rng.normal(0, 12, (np.count_nonzero(wrong), 2))
    motion[rng.random(len(x)) < 0.1] = 0
    columns = {'x': np.stack([x, y], 1).astype(np.float32),
               'displacement': (np.round(4 * motion) / 4).astype(np.float32),
               'direction': direction.astype(np.int8),
               'block': np.stack([w, h], 1).astype(np.uint8)}
    return FrameVectors(0, kind, WIDTH, HEIGHT, is_predicted=True, **columns | changes)


def segment(rng, n_b=1, **changes):
    between = tuple(replace(picture(rng, FrameType.B, **changes), stamp=10 ** 8 * (i + 1))
                    for i in range(n_b))
    current = replace(picture(rng, FrameType.P, **changes), stamp=10 ** 8 * (n_b + 1))
    return Segment(FrameVectors(0, FrameType.I, WIDTH, HEIGHT), current, between, SegmentKind.PP)


def assert_same_evidence(found, expected):
    for a, b in zip(found.columns, expected.columns, strict=True):
        np.testing.assert_allclose(a, b, rtol=ULP, atol=1e-5)
        assert a.dtype == b.dtype


def pair(rng, k, share=0.15):
    """A merged pair with holes, wrong vectors and lone ones."""
    grid = 16 * np.mgrid[0:9, 0:12][::-1].reshape(2, -1).T + 7.5
    x = (grid[rng.random(len(grid)) < 0.9] + rng.uniform(-3, 3, 2)).astype(np.float32)
    vector = (x - (90, 40)) * 0.06 + rng.normal(0, 0.2, x.shape)
    wrong = rng.random(len(x)) < share
    vector[wrong] += rng.normal(0, 9, (np.count_nonzero(wrong), 2))
    return Correspondences(
        10 ** 8 * k, 10 ** 8 * (k - 1), WIDTH, HEIGHT, SegmentKind.PP, x_cur=x,
        x_prev=(x + vector).astype(np.float32),
        sigma=rng.uniform(0.1, 0.6, len(x)).astype(np.float32),
        probability=np.where(rng.random(len(x)) < 0.2, 0.1, 0.7).astype(np.float32),
        block=np.full((len(x), 2), 16, np.uint8))


@pytest.mark.parametrize('kind', [FrameType.P, FrameType.B])
def test_where_a_predicted_vector_tells_of(rng, kind):
    frame = picture(rng, kind)
    expected = evidence_reference.leaning(frame)
    assert np.count_nonzero(expected[:, 1] < -1) > 3
    np.testing.assert_allclose(leaning(frame), expected[:, 1], rtol=ULP)


@pytest.mark.parametrize('n_b', [0, 1, 3])
def test_evidence_of_a_segment(rng, n_b):
    some = segment(rng, n_b)
    found, expected = (way.collect(some, SETTINGS) for way in (evidence, evidence_reference))
    assert_same_evidence(found, expected)
    assert len(found) > 100
    if n_b:
        halves = [evidence.collect(half, SETTINGS) for half in evidence.halves(some, SETTINGS)]
        for half, formula in zip(halves, evidence_reference.halves(some, SETTINGS), strict=True):
            assert_same_evidence(half, formula)


@pytest.mark.parametrize('settings', [SETTINGS, DecoderSettings(
    paper_weights=True, agreement_tolerance=0.3, min_support=1.3, prior_votes=0.8)])
@pytest.mark.parametrize('n_b', [0, 2])
def test_merging(rng, settings, n_b):
    given = evidence_reference.collect(segment(rng, n_b), settings)
    given.x_cur[::9] += 500  # outside the picture
    field = rng.normal(0, 4, (-(-HEIGHT // 16), -(-WIDTH // 16), 2)).astype(np.float32)
    for expected in (None, field):
        found = merging.agreed(given, (WIDTH, HEIGHT), settings, expected)
        formula = merging_reference.merge(given, WIDTH, HEIGHT, settings, expected)
        np.testing.assert_array_equal(found[3], formula[3])
        for a, b in zip(found[:3], formula[:3], strict=True):
            np.testing.assert_allclose(a, b, rtol=2e-6, atol=1e-5)
        assert 20 < np.count_nonzero(~found[3]) < len(found[3])


@pytest.mark.parametrize('n_b', [0, 2])
def test_the_share_of_right_vectors(rng, n_b):
    given = evidence.collect(segment(rng, n_b), SETTINGS)
    if n_b:
        given = Evidence(*(column[given.variance == 2] for column in given.columns))
    x, vector, variance, _ = merging.agreed(given, (WIDTH, HEIGHT), SETTINGS)
    merged = Correspondences(1, 0, WIDTH, HEIGHT, SegmentKind.PP, x_cur=x, x_prev=x + vector,
                             sigma=variance, probability=np.ones(len(x), np.float32),
                             block=np.full((len(x), 2), 16, np.uint8))
    found = merging.match_probability(given, merged, SETTINGS)
    assert found == pytest.approx(merging_reference.match_probability(given, merged, SETTINGS),
                                  rel=ULP)
    assert 0 < found < 1


def test_what_the_pairs_before_let_expect(rng):
    velocity = formula = None
    for k in range(1, 4):
        latest = pair(rng, k)
        velocity = compiled.prior_update((latest.x_cur, latest.x_prev, latest.probability),
                                         velocity, WIDTH, HEIGHT, 0.1)
        formula = merging_reference.prior_update(latest.supported(), formula)
        np.testing.assert_allclose(velocity, formula, rtol=1e-5, atol=1e-4)
    given = evidence.collect(segment(rng), SETTINGS)
    for rows in (slice(None), slice(15)):
        x, vector = given.x_cur[rows], given.vector[rows]
        np.testing.assert_allclose(
            compiled.prior_field(velocity, 0.2, x, vector),
            merging_reference.prior_field(velocity, 0.2, x, vector), rtol=ULP, atol=1e-6)


def test_chaining(rng):
    newer, older = pair(rng, 2), pair(rng, 1)
    for before in (older, replace(older, probability=np.full(len(older), 0.7, np.float32))):
        found, formula = (way(newer, before, SETTINGS)
                          for way in (chain, chaining_reference.chain))
        assert len(found) > 10
        assert found.lone.any()
        for name in ('x_cur', 'x_prev', 'sigma', 'probability', 'block'):
            np.testing.assert_allclose(getattr(found, name), getattr(formula, name), rtol=1e-6)


@pytest.mark.parametrize('camera', [CAMERA, None])
def test_parallax(rng, camera):
    some = pair(rng, 1)
    assert parallax(some, camera) == pytest.approx(
        chaining_reference.parallax(some.supported(), camera), rel=1e-9)


def test_columns_that_contradict_each_other_are_refused(rng):
    given = evidence.collect(segment(rng), SETTINGS)
    with pytest.raises(ValueError, match='merge: vector has shape'):
        merging.agreed(replace(given, vector=given.vector[1:]), (WIDTH, HEIGHT), SETTINGS)
    with pytest.raises(ValueError, match='merge: x is not finite'):
        merging.agreed(replace(given, x_cur=given.x_cur * np.float32(np.nan)), (WIDTH, HEIGHT),
                       SETTINGS)
    with pytest.raises(ValueError, match='motion_vectors: a row has 40 bytes'):
        compiled.motion_vectors(np.zeros(41, np.uint8))
