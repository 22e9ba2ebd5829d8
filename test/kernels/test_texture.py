"""What the pictures say of matches, against its formula, and where it can be told beforehand."""

import cv2
from kernels import texture_reference
from mv_slapse.kernels.binding import compiled
import numpy as np
import pytest

WIDTH, HEIGHT = 150, 90  # px, cut macroblocks at the right and at the bottom
CENTRES = (16 * np.mgrid[1:4, 1:8][::-1].reshape(2, -1).T + 7.5).astype(np.float32)
SIGMA = np.full(len(CENTRES), 0.2, np.float32)
WITHOUT_TEXTURE = np.hypot(0.2, 0.7)  # px


def picture(rng, smooth=1.5):
    """Grey levels with structure of some pixels, in rows that are longer than the picture."""
    grey = cv2.GaussianBlur(rng.normal(0, 1, (HEIGHT, WIDTH + 10)), (0, 0), smooth)
    return np.clip(128 + 40 * grey / grey.std(), 0, 255).astype(np.uint8)[:, :WIDTH]


@pytest.mark.parametrize('known', [(True, True), (True, False), (False, True)])
def test_the_formula(rng, known):
    pictures = [picture(rng) if one else None for one in known]
    x_cur = rng.uniform(-5, 1, (60, 2)).astype(np.float32) + rng.integers(
        0, (WIDTH, HEIGHT), (60, 2)).astype(np.float32)
    x_prev = x_cur + rng.normal(0, 4, x_cur.shape).astype(np.float32)
    sigma = rng.uniform(0.05, 0.5, 60).astype(np.float32)
    np.testing.assert_allclose(
        compiled.match_sigma(*pictures, x_cur, x_prev, sigma),
        texture_reference.match_sigma(*pictures, x_cur, x_prev, sigma), rtol=1e-4)


def test_a_match_is_as_good_as_the_texture_allows(rng):
    now, flat = picture(rng), np.full((HEIGHT, WIDTH), 90, np.uint8)
    stripes = np.repeat(now[:1], HEIGHT, axis=0)
    for seen, least, most in ((now, 0.2, 0.23), (stripes, 0.72, WITHOUT_TEXTURE),
                              (flat, WITHOUT_TEXTURE - 1e-6, WITHOUT_TEXTURE)):
        found = compiled.match_sigma(seen, seen, CENTRES, CENTRES, SIGMA)
        assert np.all((least <= found) & (found < most + 1e-6))


def test_a_wrong_vector_shows_in_what_is_left(rng):
    now = picture(rng, 3)
    before = np.roll(now, (1, 2), axis=(0, 1))
    right, wrong = (compiled.match_sigma(now, before, CENTRES, CENTRES + vector, SIGMA)
                    for vector in np.array([[2, 1], [-2, 3]], np.float32))
    assert np.all(wrong > 1.5 * right)
    assert np.all(wrong < WITHOUT_TEXTURE)


def test_light_that_changes_is_not_what_is_left(rng):
    now = np.clip(picture(rng), 30, 220)
    same, darker = (compiled.match_sigma(now, before, CENTRES, CENTRES, SIGMA)
                    for before in (now, now - 20))
    np.testing.assert_array_equal(same, darker)


def test_without_pictures_nothing_changes():
    assert compiled.match_sigma(None, None, CENTRES, CENTRES, SIGMA) is SIGMA


def test_pictures_may_differ_in_size(rng):
    found = compiled.match_sigma(picture(rng), picture(rng)[:40, :40].copy(), CENTRES, CENTRES,
                                 SIGMA)
    assert np.all(np.isfinite(found))


@pytest.mark.parametrize('picture', [
    np.zeros((9, 9)), np.zeros((0, 9), np.uint8), np.zeros(9, np.uint8), 3])
def test_what_is_no_picture_is_refused(picture):
    for pictures in ((picture, None), (None, picture)):
        with pytest.raises(ValueError, match=r'^match_sigma: (luma|before) must be'):
            compiled.match_sigma(*pictures, CENTRES, CENTRES, SIGMA)
