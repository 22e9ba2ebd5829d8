"""Strips of macroblocks: against their formula, and where two motions meet in a macroblock."""

from kernels import strips_reference
from kernels.strips_reference import picture
from mv_slapse.geometry.blocks import grid_centres
from mv_slapse.kernels.binding import compiled
import numpy as np
import pictures
import pytest

WIDTH, HEIGHT = 176, 112
CENTRES = grid_centres(WIDTH, HEIGHT).astype(np.float32)
POINT = np.array([88.0, 20.0])  # px, above the middle
SIGMA = 0.2  # px, of vectors


def pair_of(vectors, probability=None):
    """Columns of a pair with a vector for each macroblock."""
    n = len(CENTRES)
    return (CENTRES, (CENTRES + vectors).astype(np.float32), np.full(n, SIGMA, np.float32),
            np.full(n, 0.9, np.float32) if probability is None else probability,
            np.full((n, 2), 16, np.uint8))


def two_motions(rng, foot=70):
    """Pictures of which what lies above a row has moved by (3, 0), below by (-2, 1) [px]."""
    ahead, road = (picture(rng, WIDTH + 40, HEIGHT + 40) for _ in range(2))

    def shown(shift_ahead, shift_road):
        above, below = (ground[20 + dy:20 + dy + HEIGHT, 20 + dx:20 + dx + WIDTH] for ground, (
            dx, dy) in ((ahead, shift_ahead), (road, shift_road)))
        return np.where(np.arange(HEIGHT)[:, None] < foot, above, below)

    return shown((0, 0), (0, 0)), shown((-3, 0), (2, -1))


def test_the_formula(rng):
    now, before = two_motions(rng)
    vectors = np.where(CENTRES[:, 1:] < 70, [3, 0], [-2, 1]) + rng.normal(0, 0.4, CENTRES.shape)
    probability = rng.choice([0.2, 0.9], len(CENTRES), p=[0.1, 0.9]).astype(np.float32)
    columns = pair_of(vectors, probability)
    found = compiled.strips(now, before, columns, POINT, 60.0, SIGMA)
    expected = strips_reference.strips(now, before, columns, POINT, 60.0, SIGMA)
    assert np.count_nonzero(found[4][:, 1] == 4) > 40
    for one, other in zip(found, expected, strict=True):
        np.testing.assert_allclose(one, other, atol=2e-3)


def test_a_strip_has_the_motion_on_its_side_of_an_edge(rng):
    now, before = two_motions(rng)
    # The macroblock that the edge goes through has the vector of what lies above.
    vectors = np.where(CENTRES[:, 1:] < 72, [3.0, 0.0], [-2.0, 1.0])
    x, there, sigma, _, block = compiled.strips(now, before, pair_of(vectors), POINT, 60.0, SIGMA)
    edge = (block[:, 1] == 4) & (x[:, 1] > 64) & (x[:, 1] < 80)
    above, below = edge & (x[:, 1] < 68), edge & (x[:, 1] > 72)
    assert np.count_nonzero(above) > 2
    assert np.count_nonzero(below) > 4
    assert np.median(np.abs((there - x)[above] - [3, 0])) < 0.1
    assert np.median(np.abs((there - x)[below] - [-2, 1])) < 0.1
    assert np.all(sigma[edge] >= 2 * SIGMA)


def test_only_what_lies_ahead_is_cut(rng):
    now = picture(rng, WIDTH, HEIGHT)
    x, there, _, _, block = compiled.strips(now, now, pair_of(np.zeros(2)), POINT, 40.0, SIGMA)
    cut, off = block[:, 1] == 4, x - POINT
    assert cut.any()
    assert np.all(np.abs(off[cut, 0]) < 40 + 8)
    assert np.all((off[cut, 1] > -24) & (off[cut, 1] < 48))
    assert np.abs(there - x).max() < 1e-3
    # What is not cut stays as it is.
    whole = [tuple(row) for row in x[~cut]]
    assert all(tuple(row) in whole for row in CENTRES[np.abs(CENTRES[:, 0] - POINT[0]) > 40])


def test_without_texture_macroblocks_stay_whole(rng):
    flat = np.full((HEIGHT, WIDTH), 90, np.uint8)
    columns = pair_of(np.array([1.0, 0.5]))
    for one, other in zip(compiled.strips(flat, flat, columns, POINT, 60.0, SIGMA), columns,
                          strict=True):
        np.testing.assert_array_equal(one, other)


def test_light_that_changes_moves_no_strip(rng):
    now = np.clip(picture(rng, WIDTH, HEIGHT), 40, 210)
    same, darker = (compiled.strips(now, before, pair_of(np.zeros(2)), POINT, 60.0, SIGMA)
                    for before in (now, now - 20))
    np.testing.assert_allclose(same[1], darker[1], atol=1e-3)


def test_vectors_that_lead_out_of_the_picture_are_no_error(rng):
    now = picture(rng, WIDTH, HEIGHT)
    for vector in ([500.0, 0.0], [0.0, -90.0], [-1e6, 1e6]):
        columns = pair_of(np.array(vector))
        found = compiled.strips(now, now, columns, POINT, 60.0, SIGMA)
        assert all(np.all(np.isfinite(column)) for column in found)


def moved(rng, shift):
    """Two pictures, of which what shows at x in the first lies at x + shift in the second [px]."""
    now = picture(rng, WIDTH, HEIGHT)
    return now, np.clip(np.round(pictures.moved(now, shift)), 0, 255).astype(np.uint8)


def test_matches_are_refined_by_the_formula(rng):
    now, before = moved(rng, (2.3, -1.1))
    x = (CENTRES + rng.uniform(-3, 3, CENTRES.shape)).astype(np.float32)
    there = (x + [2.3, -1.1] + rng.normal(0, 0.8, x.shape)).astype(np.float32)
    found = compiled.refine(now, before, x, there)
    assert found.dtype == np.float32
    np.testing.assert_allclose(found, strips_reference.refine(now, before, x, there), atol=2e-3)


def test_a_match_that_is_off_by_a_pixel_comes_where_the_pictures_are_alike(rng):
    now, before = moved(rng, (2.3, -1.1))
    inner = CENTRES[np.all((CENTRES > 24) & (CENTRES < (WIDTH - 24, HEIGHT - 24)), axis=1)]
    found = compiled.refine(now, before, inner, inner + np.float32([3.1, -1.7]))
    assert np.median(np.abs(found - inner - [2.3, -1.1]), axis=0).max() < 0.02
    assert np.abs(found - inner - [2.3, -1.1]).max() < 0.1


def test_a_match_stays_where_pictures_end_or_show_nothing(rng):
    now, x = picture(rng, WIDTH, HEIGHT), CENTRES
    for vector in ([500.0, 0.0], [0.0, -90.0], [-1e6, 1e6]):
        there = (x + vector).astype(np.float32)
        np.testing.assert_array_equal(compiled.refine(now, now, x, there), there)
    flat = np.full((HEIGHT, WIDTH), 90, np.uint8)
    np.testing.assert_array_equal(compiled.refine(flat, now // 255, x, x + np.float32(0.25)),
                                  x + np.float32(0.25))
    assert compiled.refine(now, now, x[:0], x[:0]).shape == (0, 2)


def test_pictures_may_differ_from_the_grid(rng):
    small = picture(rng, 40, 24)
    found = compiled.strips(small, small, pair_of(np.zeros(2)), POINT, 60.0, SIGMA)
    assert len(found[0]) >= len(CENTRES) - 1


@pytest.mark.parametrize('point', [(88.0, 20.0), (40.0, 60.0), (120.0, 90.0)])
def test_vectors_that_lead_away_from_a_point_meet_in_it(rng, point):
    vectors = -0.15 * (CENTRES - point) + rng.normal(0, 0.1, CENTRES.shape)
    vectors[::7] = rng.normal(0, 6, vectors[::7].shape)  # wrong ones, and movers
    x_cur, x_prev, _, probability, _ = pair_of(vectors)
    found = compiled.expansion(x_cur, x_prev, probability, WIDTH, HEIGHT)
    np.testing.assert_allclose(found, point, atol=3)


def test_unsupported_vectors_do_not_tell_the_point():
    vectors = np.where(CENTRES[:, :1] < 88, -0.15 * (CENTRES - POINT), [5.0, -9.0])
    probability = np.where(CENTRES[:, 0] < 88, 0.9, 0.1).astype(np.float32)
    x_cur, x_prev, _, _, _ = pair_of(vectors)
    np.testing.assert_allclose(compiled.expansion(x_cur, x_prev, probability, WIDTH, HEIGHT),
                               POINT, atol=1)


@pytest.mark.parametrize('vectors', [
    np.zeros(2), np.array([4.0, 0.0]), 0.1 * (CENTRES - [900, 20])],
    ids=['at rest', 'while it turns', 'outside'])
def test_where_vectors_do_not_meet_there_is_no_point(vectors):
    x_cur, x_prev, _, probability, _ = pair_of(vectors)
    assert compiled.expansion(x_cur, x_prev, probability, WIDTH, HEIGHT) is None


def test_no_vectors_no_point():
    none = np.zeros((0, 2), np.float32)
    assert compiled.expansion(none, none, none[:, 0], WIDTH, HEIGHT) is None


def test_wrong_arguments_are_named(rng):
    now, columns = picture(rng, WIDTH, HEIGHT), pair_of(np.zeros(2))
    for wrong, message in (((now, None, columns, POINT), 'both pictures must be there'),
                           ((now, now, columns[:4], POINT), 'a pair has five columns'),
                           ((now.astype(float), now, columns, POINT), 'now must be uint8'),
                           ((now, now, columns, POINT[:1]), 'point has shape')):
        with pytest.raises(ValueError, match=f'^strips: {message}'):
            compiled.strips(*wrong, 60.0, SIGMA)
    x = columns[0]
    for wrong, message in (((now, None, x, x), 'both pictures must be there'),
                           ((now, now, x, x[1:]), 'x_prev has shape'),
                           ((now, now, x, x * np.float32(np.nan)), 'x_prev')):
        with pytest.raises(ValueError, match=f'^refine: {message}'):
            compiled.refine(*wrong)
