from types import SimpleNamespace

import cv2
from mv_slapse.errors import UnusableInput
from mv_slapse.raw_images import ENCODINGS, picture_of, WIDE
import numpy as np
import pytest

HEIGHT, WIDTH = 32, 48


@pytest.fixture(scope='module')
def colour():
    """A smooth picture of all colours, (32, 48, 3) BGR."""
    image = np.random.default_rng(0).integers(0, 256, (8, 12, 3), np.uint8)
    return cv2.resize(image, (WIDTH, HEIGHT), interpolation=cv2.INTER_CUBIC)


def message(encoding, rows, is_bigendian=0, padding=0):
    rows = np.pad(np.ascontiguousarray(rows).view(np.uint8).reshape(len(rows), -1),
                  ((0, 0), (0, padding)))
    return SimpleNamespace(encoding=encoding, width=WIDTH, height=HEIGHT, step=rows.shape[1],
                           is_bigendian=is_bigendian, data=rows.tobytes())


def mosaic(image, pattern):
    """Return what a sensor with a colour on each pixel of two by two sees."""
    seen = np.zeros(image.shape[:2], np.uint8)
    for i, letter in enumerate(pattern):
        seen[i // 2::2, i % 2::2] = image[i // 2::2, i % 2::2, 'bgr'.index(letter)]
    return seen


def grey(image):
    return cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)


@pytest.mark.parametrize('pattern', ['rggb', 'bggr', 'gbrg', 'grbg'])
def test_a_mosaic_becomes_grey(colour, pattern):
    seen = picture_of(message(f'bayer_{pattern}8', mosaic(colour, pattern), padding=3))
    assert np.median(np.abs(seen.astype(int) - grey(colour))) <= 4
    wrong = picture_of(message('bayer_rggb8' if pattern == 'bggr' else 'bayer_bggr8',
                               mosaic(colour, pattern)))
    assert np.median(np.abs(wrong.astype(int) - grey(colour))) > 8 or pattern in ('gbrg', 'grbg')


@pytest.mark.parametrize(('encoding', 'place'), [('yuv422', 1), ('uyvy', 1), ('yuv422_yuy2', 0),
                                                 ('yuyv', 0)])
def test_luma_is_taken_out_of_packed_pixels(colour, encoding, place):
    pixels = np.full((HEIGHT, WIDTH, 2), 128, np.uint8)
    pixels[..., place] = grey(colour)
    np.testing.assert_array_equal(picture_of(message(encoding, pixels, padding=6)), grey(colour))


@pytest.mark.parametrize(('encoding', 'more'), [('nv12', 0.5), ('nv21', 0.5), ('nv24', 2)])
def test_luma_is_taken_out_of_planes(colour, encoding, more):
    rows = np.vstack([grey(colour), np.full((int(HEIGHT * more), WIDTH), 128, np.uint8)])
    np.testing.assert_array_equal(picture_of(message(encoding, rows, padding=2)), grey(colour))


@pytest.mark.parametrize('bits', [10, 12, 14, 16])
@pytest.mark.parametrize('order', ['<u2', '>u2'])
def test_sixteen_bits_become_eight_by_the_depth_of_the_camera(colour, bits, order):
    bright = grey(colour)
    bright[0, 0] = 255
    wide = (bright.astype(np.uint16) << bits - 8).astype(order)
    seen = picture_of(message('mono16', wide, int(order == '>u2'), padding=4))
    np.testing.assert_array_equal(seen, bright)


def test_every_encoding_gives_eight_bits_of_the_picture_s_size(colour):
    for encoding in (*ENCODINGS, *WIDE):
        n, share, _ = ENCODINGS[WIDE.get(encoding, encoding)]
        rows = np.zeros((int(HEIGHT * share), WIDTH * n * (1 + (encoding in WIDE))), np.uint8)
        seen = picture_of(message(encoding, rows))
        assert (seen.shape[:2], seen.dtype) == ((HEIGHT, WIDTH), np.uint8), encoding
        cut = message(encoding, rows)
        cut.data = cut.data[:-1]
        with pytest.raises(UnusableInput, match='too few'):
            picture_of(cut)
