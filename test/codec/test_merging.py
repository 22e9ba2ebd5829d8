from dataclasses import replace
from itertools import product

import cv2
import formulas
from mv_slapse.codec import merging
from mv_slapse.codec.evidence import Evidence
from mv_slapse.codec.motion_vectors import FrameVectors
from mv_slapse.codec.segments import Segment
from mv_slapse.config import DecoderSettings
from mv_slapse.kernels.binding import compiled
from mv_slapse.records import FrameType, SegmentKind
import numpy as np
import pictures
import pytest

IP, PP, PI = SegmentKind.IP, SegmentKind.PP, SegmentKind.PI
SETTINGS = DecoderSettings()
WIDTH, HEIGHT = 160, 128


def outcomes(kind, n_b, p):
    """Every combination of right and wrong vectors: chance, direct right, indirect right."""
    n_direct = 0 if kind is PI else 1
    for bits in product((0, 1), repeat=n_direct + 2 * n_b):
        chance = np.prod([p if bit else 1 - p for bit in bits])
        pairs = np.reshape(bits[n_direct:], (n_b, 2)).all(axis=1)
        yield chance, sum(bits[:n_direct]), int(pairs.sum())


@pytest.mark.parametrize('kind', [IP, PP, PI])
@pytest.mark.parametrize(('n_b', 'p'), [(0, 0.6), (1, 0.3), (3, 0.6), (4, 0.9)])
def test_lemma_1_is_the_sum_over_all_outcomes(kind, n_b, p):
    expected = sum(chance for chance, direct, indirect in outcomes(kind, n_b, p)
                   if direct + indirect)
    assert merging.existence(kind, n_b, p) == pytest.approx(expected, abs=1e-12)


@pytest.mark.parametrize('kind', [IP, PP, PI])
@pytest.mark.parametrize('weight', [2 ** 0.5, 2.0])
def test_lemma_2_is_the_scatter_of_merged_vectors(rng, kind, weight):
    n_b, p, n = 3, 0.6, 200_000
    direct = rng.normal(size=n)
    indirect = rng.normal(size=(n, n_b)) + rng.normal(size=(n, n_b))
    has_direct = (rng.random(n) < p) & (kind is not PI)
    is_right = (rng.random((n, n_b, 2)) < p).all(axis=2)
    whole = weight * has_direct + is_right.sum(axis=1)
    some = whole > 0
    merged = (weight * has_direct * direct + (is_right * indirect).sum(axis=1))[some] / whole[some]
    expected = formulas.expected_variance(kind, n_b, p, weight)
    assert merged.var() == pytest.approx(expected, rel=0.02)


def test_inverse_variance_weights_beat_the_papers():
    assert formulas.merged_variance(3, 1, 2.0) < formulas.merged_variance(3, 1, 2 ** 0.5)
    assert formulas.merged_variance(3, 1, 2.0) == pytest.approx(1 / (1 + 3 / 2))


def lattice(motion, variance=1.0, shift=(0.0, 0.0), size=16):
    """Evidence in each block, moved by a function of its place, off the centres by a shift."""
    grid = np.mgrid[0:HEIGHT // size, 0:WIDTH // size][::-1].reshape(2, -1).T
    x = (size * grid + (size - 1) / 2 + shift).astype(np.float32)
    return Evidence(x, motion(x).astype(np.float32), np.full(len(x), variance, np.float32),
                    np.full((len(x), 2), size, np.uint8))


def joined(*parts):
    return Evidence(*(np.concatenate([getattr(part, name) for part in parts])
                      for name in ('x_cur', 'vector', 'variance', 'block')))


def linear(x):
    return (x - 70) @ np.array([[0.02, 0.005], [-0.01, 0.03]]) + (3, -1)


def consensus(evidence, *given):
    """Return place, vector and variance of what is supported."""
    *columns, lone = merging.agreed(evidence, (WIDTH, HEIGHT), *given)
    return tuple(column[~lone] for column in columns)


def agreed(evidence, settings=SETTINGS):
    return consensus(evidence, settings)


def test_a_linear_motion_stays_exact_with_evidence_beside_the_centres():
    evidence = joined(lattice(linear), lattice(linear, 2.0, (4.0, -3.0)))
    x, vector, _ = agreed(evidence)
    assert len(x) == 80
    np.testing.assert_allclose(vector, linear(x), atol=1e-4)


def test_each_macroblock_gives_one_vector_however_it_is_split():
    x, vector, _ = agreed(lattice(linear, size=8))
    assert len(x) == 80
    np.testing.assert_allclose(x[0], (7.5, 7.5), atol=1e-4)
    np.testing.assert_allclose(vector, linear(x), atol=1e-4)


def test_wrong_vectors_are_rejected_and_the_others_stay(rng):
    evidence = lattice(linear)
    wrong = rng.random(len(evidence)) < 0.3
    evidence.vector[wrong] += rng.uniform(8, 30, (np.count_nonzero(wrong), 2))
    x, vector, _ = agreed(evidence)
    assert np.abs(vector - linear(x)).max() < 0.01
    assert len(x) > 0.8 * np.count_nonzero(~wrong)


def test_what_comes_near_keeps_its_vectors_though_they_grow_from_block_to_block():
    evidence = lattice(lambda x: 0.3 * (x - (80, 64)))  # 4.8 px more for each block
    x, vector, _ = agreed(evidence)
    np.testing.assert_allclose(vector, 0.3 * (x - (80, 64)), atol=1e-4)
    inner = np.all((x > 16) & (x < (WIDTH - 16, HEIGHT - 16)), axis=1)
    assert inner.sum() == 8 * 6


def test_vectors_that_grow_stay_beside_those_to_another_of_several_pictures(rng):
    evidence = lattice(lambda x: 0.3 * (x - (80, 64)))  # 4.8 px more for each block
    twice = rng.random(len(evidence)) < 0.2  # as long, as to the picture before the last
    twice &= np.abs(evidence.vector).max(axis=1) > 8
    evidence.vector[twice] *= 2
    pair = merging.average(segment_of(evidence, references=3), evidence, SETTINGS)
    error = np.abs(pair.x_prev - pair.x_cur - 0.3 * (pair.x_cur - (80, 64))).max(axis=1)
    assert np.count_nonzero(error < 0.01) > 0.7 * np.count_nonzero(~twice)
    assert np.count_nonzero(error > 4) < 0.3 * np.count_nonzero(twice)


def test_opposite_neighbours_do_not_speak_for_what_is_not_half_way_between_theirs():
    evidence = lattice(lambda x: 0.3 * (x - (80, 64)) + 20 * (x == (71.5, 71.5)).all(
        axis=1, keepdims=True))
    x, _, _ = agreed(evidence)
    assert not np.any((x == (71.5, 71.5)).all(axis=1))


def test_the_cluster_that_neighbours_support_beats_the_heavier_one():
    evidence = joined(lattice(linear, 2.0), lattice(linear))
    evidence.vector[80 + 34] += 25  # the direct vector of one macroblock
    _, vector, _ = agreed(evidence)
    np.testing.assert_allclose(vector[34], linear(evidence.x_cur[34:35])[0], atol=1e-4)


def test_more_evidence_and_more_support_mean_less_variance():
    _, _, alone = agreed(lattice(linear))
    _, _, twice = agreed(joined(lattice(linear), lattice(linear, 2.0)))
    assert (twice < alone).all()
    assert alone[34] < alone[0]  # inside against in the corner


def test_evidence_outside_the_picture_is_left_out():
    outside = lattice(linear, shift=(-400.0, 0.0))
    assert len(agreed(joined(lattice(linear), outside))[0]) == 80
    assert len(agreed(outside)[0]) == 0


def test_no_evidence_gives_no_vectors():
    empty = Evidence(np.zeros((0, 2), np.float32), np.zeros((0, 2), np.float32),
                     np.zeros(0, np.float32), np.zeros((0, 2), np.uint8))
    assert [len(part) for part in agreed(empty)] == [0, 0, 0]


@pytest.mark.parametrize(('paper', 'share'), [(True, 2 ** 0.5 / (2 ** 0.5 + 1)), (False, 2 / 3)])
def test_direct_evidence_weighs_as_the_setting_says(paper, share):
    direct, indirect = lattice(lambda x: 0 * x), lattice(lambda x: 0 * x + 0.3, 2.0)
    _, vector, _ = agreed(joined(direct, indirect), DecoderSettings(paper_weights=paper))
    np.testing.assert_allclose(vector, 0.3 * (1 - share), rtol=1e-4)


def test_a_lone_vector_needs_the_pairs_before_to_speak_for_it(rng):
    evidence = lattice(lambda x: rng.uniform(-60, 60, x.shape))
    settings = DecoderSettings(prior_votes=2.5)
    field = evidence.vector.reshape(8, 10, 2)
    x, vector, _ = consensus(evidence, settings, field)
    assert len(x) == 80
    np.testing.assert_allclose(vector, evidence.vector, atol=1e-4)
    assert len(agreed(evidence)[0]) < 8
    assert len(consensus(evidence, settings, field + 999)[0]) < 8


def skipped(vector):
    """A picture that moves, but for skipped macroblocks at its right."""
    return lattice(lambda x: np.where(x[:, :1] < 0.6 * WIDTH, vector, (0, 0)))


def test_skipped_macroblocks_do_not_support_each_other_where_the_picture_moves():
    x, vector, _ = consensus(skipped((6, 0)), SETTINGS)
    assert np.all(vector[:, 0] == 6)
    assert np.all(x[:, 0] < 0.6 * WIDTH)


@pytest.mark.parametrize('evidence', [skipped((1, 0)), lattice(lambda x: 0 * x)])
def test_zero_vectors_count_where_the_camera_stands_or_hardly_moves(evidence):
    x, vector, _ = consensus(evidence, SETTINGS)
    assert len(x) == len(evidence)
    assert np.any(np.all(vector == 0, axis=1))


def segment_of(evidence, n_b=0, references=1):
    """Return a P frame's segment; its vectors are handed to `average` beside it."""
    frames = [FrameVectors(stamp=i * 100_000_000, frame_type=kind, width=WIDTH, height=HEIGHT,
                           references=references)
              for i, kind in enumerate((FrameType.P, *[FrameType.B] * n_b, FrameType.P))]
    return Segment(frames[0], frames[-1], tuple(frames[1:-1]), PP)


def test_a_vector_that_nothing_supports_is_given_as_a_lone_one():
    evidence = lattice(linear)
    wrong = np.zeros(len(evidence), bool)
    wrong[[33, 55]] = True
    evidence.vector[wrong] += (25, 14)
    pair = merging.average(segment_of(evidence), evidence, SETTINGS)
    assert len(pair) == 80
    lone = pair.lone
    np.testing.assert_allclose(pair.x_cur[lone], evidence.x_cur[wrong])
    np.testing.assert_allclose((pair.x_prev - pair.x_cur)[lone], evidence.vector[wrong], rtol=1e-5)
    assert pair.sigma[lone].min() > 1.5 * pair.sigma[~lone].max()
    assert len(pair.supported()) == 78
    assert not pair.supported().lone.any()


@pytest.mark.parametrize(('n_b', 'references', 'share'), [(1, 1, 0.2), (0, 2, 0.2), (0, 1, 0.0)])
def test_a_lone_vector_over_several_pictures_says_nothing(n_b, references, share):
    evidence = lattice(linear)
    evidence.vector[33] += (25, 14)
    pair = merging.average(segment_of(evidence, n_b, references), evidence,
                           DecoderSettings(lone_probability=share))
    assert len(pair) == 79
    assert not pair.lone.any()


def slid(rng, references, shift=(0.75, -0.5)):
    """Return a segment whose picture has moved by a shift, and a pair that says half more.

    The left half of the pair's vectors are longer by 6 px.
    """
    ground = cv2.GaussianBlur(rng.normal(0, 40, (HEIGHT, WIDTH)), (0, 0), 2)
    shown = 128 + 40 * ground / ground.std()
    now, before = (np.clip(one, 0, 255).astype(np.uint8)
                   for one in (shown, pictures.moved(shown, shift)))
    evidence = lattice(lambda x: np.full_like(x, 0) + 1.5 * np.array(shift))
    segment = segment_of(evidence, references=references)
    segment = replace(segment, current=replace(segment.current, luma=now),
                      previous=replace(segment.previous, luma=before))
    x = evidence.x_cur
    there = x + evidence.vector + np.float32([6, 0]) * (x[:, :1] < WIDTH / 2)
    return segment, merging.average(segment, replace(
        evidence, vector=(there - x).astype(np.float32)), SETTINGS)


def test_short_vectors_of_several_references_are_those_of_the_pictures(rng):
    segment, pair = slid(rng, 3)
    found = merging.refined(pair, segment, SETTINGS)
    inner = np.all((pair.x_cur > 16) & (pair.x_cur < (WIDTH - 16, HEIGHT - 16)), axis=1)
    long = pair.x_cur[:, 0] < WIDTH / 2
    np.testing.assert_array_equal(found.x_prev[long], pair.x_prev[long])
    np.testing.assert_allclose((found.x_prev - found.x_cur)[inner & ~long],
                               np.broadcast_to([0.75, -0.5], (np.sum(inner & ~long), 2)),
                               atol=0.1)
    assert np.all(pair.x_prev[~long] - pair.x_cur[~long] == np.float32([1.125, -0.75]))


@pytest.mark.parametrize(('references', 'tolerance', 'moved'), [
    (1, 0.1, False), (2, 0.1, False), (6, 0.1, True), (3, 0.5, True)])
def test_the_more_references_the_longer_vectors_may_be_wrong(rng, references, tolerance, moved):
    segment, pair = slid(rng, references)
    found = merging.refined(pair, segment, replace(SETTINGS, agreement_tolerance=tolerance))
    long = pair.x_cur[:, 0] < WIDTH / 2  # 7.2 px
    assert np.any(found.x_prev[long] != pair.x_prev[long]) == moved


@pytest.mark.parametrize('unknown', [
    {'current': {'luma': None}}, {'previous': {'luma': None}},
    {'previous': {'luma': np.zeros((HEIGHT, WIDTH + 16), np.uint8)}}])
def test_without_both_pictures_vectors_of_several_references_stay(rng, unknown):
    segment, pair = slid(rng, 3)
    segment = replace(segment, **{which: replace(getattr(segment, which), **change)
                                  for which, change in unknown.items()})
    assert merging.refined(pair, segment, SETTINGS) is pair


def test_nothing_but_lone_vectors_is_nothing(rng):
    evidence = lattice(linear)
    evidence.vector[:] = rng.uniform(-40, 40, evidence.vector.shape)
    few = merging.agreed(evidence, (WIDTH, HEIGHT), SETTINGS)
    assert few[-1].all()
    assert len(few[-1]) > 60
    assert len(merging.average(segment_of(evidence), evidence, SETTINGS)) == 0


def test_a_lone_zero_vector_is_no_evidence():
    evidence = lattice(lambda x: linear(x) + 9)
    evidence.vector[33] = 0
    assert len(merging.average(segment_of(evidence), evidence, SETTINGS)) == 79


@pytest.mark.parametrize('share', [0.05, 0.15])
@pytest.mark.parametrize('kind', [PP, PI])
def test_the_share_of_right_vectors_is_measured(rng, share, kind):
    """Wrong ones stand alone; indirect evidence is right where both its vectors are, p^2."""
    evidence = lattice(linear, 1.0 if kind is PP else 2.0)
    wrong = rng.choice(len(evidence), round(share * len(evidence)), replace=False)
    evidence.vector[wrong] += rng.uniform(-20, 20, (len(wrong), 2)).astype(np.float32) + 30
    expected = 1 - share if kind is PP else (1 - share) ** 0.5
    merged = merging.average(segment_of(evidence), evidence, SETTINGS)
    assert merging.match_probability(evidence, merged, SETTINGS) == pytest.approx(
        expected, abs=0.06)


def test_a_pair_is_weighed_by_the_pictures_of_its_own_ends(rng):
    luma = [rng.integers(0, 256, (HEIGHT, WIDTH)).astype(np.uint8) for _ in range(2)]
    first, last = (FrameVectors(80_000_000 * i, FrameType.P, WIDTH, HEIGHT, luma=picture)
                   for i, picture in enumerate(luma))
    segment = Segment(first, last, (), PP)
    pair = merging.average(segment, lattice(lambda x: x * 0 + (2, 1)), SETTINGS)
    for ends, shown in (((0, 1), luma), ((0, 0.5), (luma[0], None)), ((0.5, 1), (None, luma[1])),
                        ((0.3, 0.6), (None, None))):
        previous, now = (int(80_000_000 * end) for end in ends)
        found = merging.seen(replace(pair, previous_stamp=previous, stamp=now), segment)
        expected = compiled.match_sigma(shown[1], shown[0], pair.x_cur, pair.x_prev, pair.sigma)
        np.testing.assert_array_equal(found.sigma, expected)
        assert np.any(found.sigma > pair.sigma) == (ends != (0.3, 0.6))


def test_what_has_no_texture_counts_for_less(rng):
    smooth = np.full((HEIGHT, WIDTH), 90, np.uint8)
    smooth[:, :64] = rng.integers(0, 256, (HEIGHT, 64))
    first, last = (FrameVectors(80_000_000 * i, FrameType.P, WIDTH, HEIGHT, luma=smooth)
                   for i in range(2))
    segment = Segment(first, last, (), PP)
    pair = merging.average(segment, lattice(np.zeros_like), SETTINGS)
    found, shows = merging.seen(pair, segment).sigma, pair.x_cur[:, 0] < 64
    np.testing.assert_allclose(found[shows], pair.sigma[shows], rtol=0.01)
    assert np.all(found[pair.x_cur[:, 0] > 80] > 0.69)
