"""Strips on their way from a pair to the movers: without the lens' distortion, and not coarse."""

from dataclasses import replace

from canyon import K, motion, views
import cv2
from mv_slapse.config import ExtractionSettings
from mv_slapse.extraction import coarse
from mv_slapse.extraction.extractor import PlaneExtractor
from mv_slapse.geometry.camera import Camera, to_pixels, to_rays
from mv_slapse.movers import regions
from mv_slapse.records import Correspondences, MotionStatus, SegmentKind
from mv_slapse.strip_matches import StripMatches
import numpy as np
import pytest

WIDTH, HEIGHT = 640, 480
BENT = Camera(WIDTH, HEIGHT, K, distortion=np.array([-0.2, 0.05, 0, 0]))


def bent(x):
    """Return pixels (N, 2) as the lens shows them."""
    return cv2.projectPoints(to_rays(K, x), np.zeros(3), np.zeros(3), K, BENT.distortion)[0][:, 0]


@pytest.fixture
def pair(rng):
    scene = views(*motion('ahead'), rng, 0.2)
    n = len(scene.pair)
    strips = StripMatches(0, *rng.uniform(250, 400, (2, 12, 2)).astype(np.float32),
                          np.full(12, 0.6, np.float32))
    return Correspondences(
        100_000_000, 0, WIDTH, HEIGHT, SegmentKind.PP, 0, '',
        bent(to_pixels(K, scene.pair.rays_cur)).astype(np.float32),
        bent(scene.pair.x_prev).astype(np.float32), np.full(n, 0.2, np.float32),
        np.ones(n, np.float32), np.full((n, 2), 16, np.uint8), strips)


def test_movers_are_told_strips_without_distortion(pair, monkeypatch):
    told, found = [], regions.with_moving_planes
    monkeypatch.setattr(regions, 'with_moving_planes',
                        lambda *given: (told.append(given[-1]), found(*given))[1])
    ideal = pair.strips
    pair = replace(pair, strips=replace(ideal, x_cur=bent(ideal.x_cur).astype(np.float32),
                                        x_earlier=bent(ideal.x_earlier).astype(np.float32)))
    shown = PlaneExtractor(BENT, ExtractionSettings()).extract(pair)
    assert shown.motion.status is MotionStatus.MOVING
    assert np.abs(pair.strips.x_cur - ideal.x_cur).max() > 0.5
    np.testing.assert_allclose(told[0].x_cur, ideal.x_cur, atol=1e-3)
    np.testing.assert_allclose(told[0].x_earlier, ideal.x_earlier, atol=1e-3)
    np.testing.assert_array_equal(told[0].sigma, ideal.sigma)
    assert told[0].stamp == ideal.stamp


def test_a_picture_that_is_taken_coarser_has_none(pair):
    assert len(coarse.correspondences_of(pair, 1.5).strips) == 0
