"""Strips in a picture of a while ago: against their formula, and where two depths meet."""

import cv2
from kernels import strips_reference
from kernels.strips_reference import picture
from mv_slapse.geometry.blocks import grid_centres
from mv_slapse.kernels.binding import compiled
import numpy as np
import pytest

WIDTH, HEIGHT = 176, 112
CENTRES = grid_centres(WIDTH, HEIGHT).astype(np.float32)
POINT = np.array([88.0, 20.0])  # px, that all leads away from
FOOT = 52  # row from which on the road shows
AHEAD, ROAD = 0.85, 0.75  # size a while ago, as a share of now's
REACH = 60.0
PAIRS = 3


def grown(ground, size):
    """A picture of what was `size` times as large around POINT."""
    shift = (1 - size) * POINT
    return cv2.warpAffine(ground, np.array([[size, 0, shift[0]], [0, size, shift[1]]]),
                          (WIDTH, HEIGHT), borderMode=cv2.BORDER_REFLECT)


def now_and_then(rng):
    """Two pictures of a car ahead, down to FOOT, and the road below."""
    car, road = (picture(rng, WIDTH, HEIGHT) for _ in range(2))
    ahead = np.arange(HEIGHT)[:, None] < FOOT
    foot_then = POINT[1] + AHEAD * (FOOT - POINT[1])
    then = np.where(np.arange(HEIGHT)[:, None] < foot_then, grown(car, AHEAD), grown(road, ROAD))
    return np.where(ahead, car, road), then


def links(rng, noise=0.3):
    """Vectors of PAIRS pairs that lead there, the newest first."""
    found = []
    for _ in range(PAIRS):
        size = np.where(CENTRES[:, 1:] < FOOT, AHEAD, ROAD)**(1 / PAIRS)
        there = POINT + size * (CENTRES - POINT) + rng.normal(0, noise, CENTRES.shape)
        found.append((CENTRES, there.astype(np.float32)))
    return tuple(found)


def test_the_formula(rng):
    now, then = now_and_then(rng)
    given = links(rng)
    found = compiled.earlier(now, then, given, POINT, REACH)
    expected = strips_reference.earlier(now, then, given, POINT, REACH)
    assert len(found[0]) > 60
    assert {column.dtype for column in found} == {np.dtype(np.float32)}
    for one, other in zip(found, expected, strict=True):
        np.testing.assert_allclose(one, other, atol=1e-2)


def test_a_strip_was_where_its_depth_says(rng):
    now, then = now_and_then(rng)
    x, place, sigma = compiled.earlier(now, then, links(rng), POINT, REACH)
    off, way = x - POINT, place - POINT
    far = np.hypot(*off.T) > 20  # near the point all sizes are alike
    size = (off * way).sum(1) / (off * off).sum(1)
    for share, there in ((AHEAD, x[:, 1] < FOOT - 4), (ROAD, x[:, 1] > FOOT + 4)):
        assert np.count_nonzero(far & there) > 15
        assert np.median(np.abs(size - share)[far & there]) < 0.01
    assert np.all((sigma >= 0.5) & (sigma < 0.8))


def test_only_what_lies_ahead_is_looked_for(rng):
    now = picture(rng, WIDTH, HEIGHT)
    x, place, _ = compiled.earlier(now, now, ((CENTRES, CENTRES),), POINT, 40.0)
    off = x - POINT
    assert len(x) > 20
    assert np.all(np.abs(off[:, 0]) < 40)
    assert np.all((off[:, 1] > -24) & (off[:, 1] < 48))
    assert np.all(np.hypot(*off.T) >= 8)
    assert np.abs(place - x).max() < 1e-3


def test_light_that_changes_moves_no_strip(rng):
    now = np.clip(picture(rng, WIDTH, HEIGHT), 40, 210)
    same, darker = (compiled.earlier(now, then, ((CENTRES, CENTRES),), POINT, REACH)
                    for then in (now, now - 20))
    np.testing.assert_allclose(same[1], darker[1], atol=1e-3)


def test_without_texture_nothing_is_told(rng):
    flat, stripes = np.full((HEIGHT, WIDTH), 90, np.uint8), picture(rng, WIDTH, HEIGHT)
    stripes[:] = stripes[:1]  # along which nothing tells where a strip lay
    for now in (flat, stripes):
        for column in compiled.earlier(now, now, ((CENTRES, CENTRES),), POINT, REACH):
            assert len(column) == 0


def test_vectors_that_lead_out_of_the_picture_are_no_error(rng):
    now = picture(rng, WIDTH, HEIGHT)
    for vector in ([500.0, 0.0], [0.0, -90.0], [-1e6, 1e6]):
        given = ((CENTRES, (CENTRES + vector).astype(np.float32)),)
        assert all(np.all(np.isfinite(column))
                   for column in compiled.earlier(now, now, given, POINT, REACH))


def test_wrong_arguments_are_named(rng):
    now, link = picture(rng, WIDTH, HEIGHT), (CENTRES, CENTRES)
    none = CENTRES[:0]
    for wrong, message in (((now, None, (link,), POINT), 'both pictures must be there'),
                           ((now, now, (link[:1],), POINT), 'a link has two columns'),
                           ((now, now, ((none, none),), POINT), 'a link has vectors'),
                           ((now, now, ((CENTRES, link[0][1:]),), POINT), 'x_prev has shape'),
                           ((now, now, (link,), POINT[:1]), 'point has shape')):
        with pytest.raises(ValueError, match=f'^earlier: {message}'):
            compiled.earlier(*wrong, REACH)
