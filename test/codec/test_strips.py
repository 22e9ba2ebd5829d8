"""Which pairs are cut into strips, by which pictures; the strips are tested in kernels/."""

from dataclasses import replace

import cv2
from mv_slapse.codec.decoder import CorrespondenceDecoder
from mv_slapse.codec.encoding.encoder import encode, Encoding, LOW_LATENCY
from mv_slapse.codec.strips import KEPT, LONGEST, StripCutter
from mv_slapse.config import DecoderSettings
from mv_slapse.geometry.blocks import grid_centres
from mv_slapse.geometry.camera import Camera
from mv_slapse.records import Correspondences, SegmentKind
from mv_slapse.strip_matches import SPAN
import numpy as np
import pictures
import pytest

WIDTH, HEIGHT = pictures.WIDTH, pictures.HEIGHT
SETTINGS = DecoderSettings()
AHEAD, GROWTH = np.array([128.0, 60.0]), 1.02  # px; of what is seen, in a picture


def camera(focal=500.0):
    return Camera(WIDTH, HEIGHT, np.array([[focal, 0, 128], [0, focal, 96], [0, 0, 1]]))


def seen(ground, scale):
    """A picture of what grows around AHEAD."""
    shift = AHEAD - 450 * scale
    return cv2.warpAffine(ground, np.array([[scale, 0, shift[0]], [0, scale, shift[1]]]),
                          (WIDTH, HEIGHT))


def pair(stamp=40, growth=GROWTH):
    """A pair whose vectors lead away from AHEAD."""
    x = grid_centres(WIDTH, HEIGHT).astype(np.float32)
    n, away = len(x), ((1 / growth - 1) * (x - AHEAD)).astype(np.float32)
    return Correspondences(
        stamp, stamp - 40, WIDTH, HEIGHT, SegmentKind.PP, x_cur=x, x_prev=x + away,
        sigma=np.full(n, 0.2, np.float32), probability=np.full(n, 0.9, np.float32),
        block=np.full((n, 2), 16, np.uint8))


def cutter(rng, stamps=(0, 40), focal=500.0):
    cut, ground = StripCutter(SETTINGS, camera(focal) if focal else None), pictures.texture(rng)
    for stamp in stamps:
        cut.keep(stamp, seen(ground, GROWTH**(stamp // 40 % 20)))
    return cut


def n_strips(pair):
    return np.count_nonzero(pair.block[:, 1] == 4)


def test_a_pair_whose_pictures_are_known_is_cut(rng):
    found = cutter(rng).cut(pair())
    assert n_strips(found) > 20
    assert len(found) > len(pair())
    assert (found.stamp, found.previous_stamp, found.kind) == (40, 0, SegmentKind.PP)
    assert {found.x_cur.dtype, found.x_prev.dtype, found.sigma.dtype} == {np.dtype(np.float32)}


@pytest.mark.parametrize('stamps', [(), (0,), (40,), (7, 40)])
def test_where_a_picture_is_not_known_the_pair_stays(rng, stamps):
    given = pair()
    assert cutter(rng, stamps).cut(given) is given


@pytest.mark.parametrize('focal', [None, LONGEST + 1])
def test_without_a_camera_or_with_a_long_lens_nothing_is_kept_or_cut(rng, focal):
    given, cut = pair(), cutter(rng, focal=focal)
    assert not cut.reach
    assert cut.cut(given) is given


def test_pictures_of_two_sizes_are_not_compared(rng):
    cut = cutter(rng, (0,))
    cut.keep(40, pictures.texture(rng)[:HEIGHT + 16, :WIDTH])
    given = pair()
    assert cut.cut(given) is given


def test_nothing_is_cut_until_the_camera_has_gone_somewhere(rng):
    cut = cutter(rng, (0, 40, 80, 120))
    assert n_strips(cut.cut(pair(40, growth=1.0))) == 0
    assert n_strips(cut.cut(pair(80))) > 20


def test_a_picture_serves_the_pair_after_it_and_no_more_than_some_are_kept(rng):
    cut = cutter(rng, range(0, 40 * 3 * KEPT, 40))
    last = 40 * (3 * KEPT - 1)
    assert n_strips(cut.cut(pair(40))) == 0
    assert n_strips(cut.cut(pair(last))) > 20
    assert cut.cut(pair(last + 40)).block.min() == 16  # its own picture has not come yet


STEP = 40_000_000  # [ns] between pictures


def matched(rng, steps, growth=1.005):
    """The strips of one pair after the other, each of so many pictures."""
    cut, ground, found = StripCutter(SETTINGS, camera()), pictures.texture(rng), []
    cut.keep(0, seen(ground, 1.0))
    last = 0
    for step in steps:
        for k in range(last + 1, last + abs(step) + 1):
            cut.keep(STEP * k, seen(ground, growth**k))
        last += abs(step)
        given = replace(pair(growth=growth**abs(step)), stamp=STEP * last,
                        previous_stamp=STEP * (last - abs(step)))
        if step > 0:
            found.append((last, cut.cut(given)))
    return found


def test_strips_are_looked_for_half_a_second_ago(rng):
    steps = [2, 1, 3, 2, 2, 3, 2, 1, 2]
    for last, cut in matched(rng, steps):
        strips = cut.strips
        first = min(k for k in np.cumsum([0, *steps]) if STEP * (last - k) <= SPAN)
        assert strips.stamp == STEP * first
        assert len(strips) > 40
        expected = AHEAD + (strips.x_cur - AHEAD) * 1.005**(first - last)
        assert np.median(np.abs(strips.x_earlier - expected)) < 0.1
        assert {strips.x_cur.dtype, strips.x_earlier.dtype, strips.sigma.dtype} == {
            np.dtype(np.float32)}


def test_strips_are_followed_as_far_as_pairs_follow_each_other(rng):
    steps = [2, 2, -2, 2, 2]  # the third pair has never come
    stamps = [cut.strips.stamp for _, cut in matched(rng, steps)]
    assert stamps == [0, 0, 6 * STEP, 6 * STEP]


def test_a_pair_that_is_not_cut_has_no_strips(rng):
    assert len(cutter(rng, (0,)).cut(pair()).strips) == 0
    assert len(cutter(rng, focal=LONGEST + 1).cut(pair()).strips) == 0


def test_broken_pairs_and_empty_ones_pass(rng):
    empty = Correspondences(40, 0, WIDTH, HEIGHT, SegmentKind.BROKEN, reason='lost')
    assert len(cutter(rng).cut(empty)) == 0


@pytest.mark.parametrize('encoding', [LOW_LATENCY, Encoding('mpeg2video', 3, 12),
                                      Encoding('h264', 2, 12)])
@pytest.mark.parametrize('split_flow', [0.0, 1e6])
def test_a_decoder_cuts_whole_segments_and_halves(rng, encoding, split_flow):
    """A camera that goes ahead into a picture: of halves the B picture's pixels are asked."""
    ground = pictures.texture(rng)
    images = [seen(ground, GROWTH**i) for i in range(13)]
    settings = replace(SETTINGS, max_chain=1, split_flow=split_flow, split_share=0.0,
                       min_parallax=0.0)
    decoder = CorrespondenceDecoder(settings, camera())
    pairs = [found for packet in encode(images, 25, encoding) for found in decoder.feed(packet)]
    pairs += decoder.flush()
    cut = [found for found in pairs if n_strips(found)]
    assert len(cut) >= 0.7 * len([found for found in pairs if len(found)])
    for found in cut:
        frames = (found.stamp - found.previous_stamp) / 40_000_000
        strip = found.block[:, 1] == 4
        expected = (found.x_cur - AHEAD) * (GROWTH**-frames - 1)
        error = np.abs(found.x_prev - found.x_cur - expected)[strip]
        assert np.median(error) < 0.15
