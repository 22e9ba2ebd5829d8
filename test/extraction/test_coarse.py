"""Pictures of more macroblocks than are looked at, as pictures of fewer pixels."""

from dataclasses import replace
import math

from canyon import angle_between, motion, turn_between, views
from canyon import K as K_VGA
from mv_slapse.config import ExtractionSettings
from mv_slapse.evaluation.detection import grid_index
from mv_slapse.extraction import coarse
from mv_slapse.extraction.extractor import PlaneExtractor
from mv_slapse.geometry.blocks import grid_centres
from mv_slapse.geometry.camera import Camera, to_pixels
from mv_slapse.records import Correspondences, Label, MotionStatus, SegmentKind
import numpy as np
import pytest

WIDTH, HEIGHT = 640, 480
CAMERA = Camera(WIDTH, HEIGHT, K_VGA)


def drawn(n, rng):
    """Correspondences anywhere in the picture, of any worth."""
    x = rng.uniform(0, (WIDTH - 1, HEIGHT - 1), (n, 2)).astype(np.float32)
    return Correspondences(100, 0, WIDTH, HEIGHT, SegmentKind.PP, 0, '', x, x + np.float32(2),
                           rng.uniform(0.2, 1, n).astype(np.float32),
                           rng.choice([0.5, 0.9], n).astype(np.float32),
                           np.full((n, 2), 8, np.uint8))


def test_a_picture_of_few_macroblocks_is_taken_as_it_is():
    assert coarse.factor_of(640, 480, 2000) == 1
    assert coarse.factor_of(640, 480, 1200) == 1
    assert coarse.factor_of(1920, 1088, 2040) == 2


def test_a_macroblock_of_the_smaller_picture_holds_as_many_blocks_as_the_next_one():
    assert coarse.factor_of(1280, 720, 2000) == 1.5
    assert coarse.factor_of(1920, 1080, 2000) == 2.5
    assert coarse.factor_of(3840, 2160, 2000) == 4.5


def test_the_camera_sees_the_same_rays_in_fewer_pixels(rng):
    small = coarse.camera_of(CAMERA, 1.7)
    X = np.c_[rng.normal(0, 0.4, (20, 2)), np.ones(20)]
    np.testing.assert_allclose((to_pixels(small.K, X) + 0.5) * 1.7,
                               to_pixels(CAMERA.K, X) + 0.5, atol=1e-9)
    assert (small.width, small.height) == (377, 283)


def test_of_the_blocks_in_a_macroblock_the_most_telling_one_is_left(rng):
    given, factor = drawn(3000, rng), 2.5
    few = coarse.correspondences_of(given, factor)
    cell = np.floor((given.x_cur + 0.5) / (16 * factor)).astype(int)
    for x, sigma, probability in zip(few.x_cur, few.sigma, few.probability, strict=True):
        inside = np.all(cell == np.floor((x + 0.5) / 16).astype(int), axis=1)
        assert probability == given.probability[inside].max()
        best = inside & (given.probability == probability)
        assert sigma * factor == pytest.approx(given.sigma[best].min(), rel=1e-6)
    assert len(few) == len(np.unique(cell, axis=0))
    np.testing.assert_allclose(few.x_prev - few.x_cur, 2 / factor, atol=1e-4)


@pytest.mark.parametrize('size', [(1920, 1080), (2048, 1080), (1280, 720)])
def test_each_macroblock_lies_in_one_of_the_smaller_picture(size):
    factor = coarse.factor_of(*size, 2000)
    small = (math.ceil(size[0] / factor), math.ceil(size[1] / factor))
    at = grid_centres(*small)[coarse._cells(*size, factor)]
    off = np.abs(at - ((grid_centres(*size) + 0.5) / factor - 0.5))
    assert off.max() <= 8.0


def test_a_block_at_the_lower_edge_is_kept(rng):
    given = replace(drawn(1, rng), width=1920, height=1080,
                    x_cur=np.array([[100.0, 1079.5]], np.float32))
    assert len(coarse.correspondences_of(given, 2.5)) == 1


def test_the_extraction_is_told_in_the_pixels_of_the_picture(rng):
    scene = views(*motion('ahead'), rng, 0.2)
    n = len(scene.pair)
    x_cur = to_pixels(K_VGA, scene.pair.rays_cur).astype(np.float32)
    given = Correspondences(100_000_000, 0, WIDTH, HEIGHT, SegmentKind.PP, 0, '', x_cur,
                            scene.pair.x_prev.astype(np.float32), np.full(n, 0.2, np.float32),
                            np.ones(n, np.float32), np.full((n, 2), 16, np.uint8))
    settings = ExtractionSettings(max_blocks=500)
    found = PlaneExtractor(CAMERA, settings).extract(given)
    assert found.motion.status is MotionStatus.MOVING
    assert np.degrees(turn_between(found.motion.R_cur_from_prev, scene.R)) < 0.1
    assert np.degrees(angle_between(found.motion.t_cur_from_prev, scene.t)) < 0.5
    np.testing.assert_array_equal(found.K, K_VGA)
    assert len(found.x_cur) <= 600
    index = [np.argmin(np.sum((x_cur - x)**2, axis=1)) for x in found.x_cur]
    np.testing.assert_allclose(found.x_cur, x_cur[index], atol=1e-3)
    np.testing.assert_allclose(found.x_prev, given.x_prev[index], atol=1e-3)
    np.testing.assert_allclose(found.sigma, 0.2, rtol=0.6)
    # Each macroblock has the label of the block that stands for it.
    cell = grid_index(found.x_cur, WIDTH, HEIGHT)
    known = found.label != Label.UNKNOWN
    assert found.macroblock_label.shape == (len(grid_centres(WIDTH, HEIGHT)),)
    assert np.mean(found.macroblock_label[cell[known]] == found.label[known]) > 0.98


def test_a_picture_that_fits_is_not_changed(rng):
    given = drawn(800, rng)
    one, two = (PlaneExtractor(CAMERA, ExtractionSettings(max_blocks=most)).extract(given)
                for most in (1200, 100000))
    np.testing.assert_array_equal(one.x_cur, two.x_cur)
    assert len(one.x_cur) == len(given)
    assert replace(given, x_cur=one.x_cur).width == one.width
