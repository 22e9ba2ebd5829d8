from dataclasses import replace

from mv_slapse.codec.bridging import can_bridge, search
from mv_slapse.codec.motion_vectors import FrameVectors
from mv_slapse.codec.prior import MotionPrior
from mv_slapse.codec.segments import Segment
from mv_slapse.config import DecoderSettings
from mv_slapse.records import Correspondences, FrameType, SegmentKind
import numpy as np
import pictures
import pytest

SETTINGS = DecoderSettings()


def segment(images):
    previous, current = (
        FrameVectors(40_000_000 * i, kind, pictures.WIDTH, pictures.HEIGHT, luma=image)
        for i, (kind, image) in enumerate(zip((FrameType.P, FrameType.I), images, strict=True)))
    return Segment(previous, current, (), SegmentKind.BROKEN, 'dead')


def test_macroblocks_are_found_where_they_were(rng):
    found = search(segment(pictures.sliding(rng, 2, (5, -3))), MotionPrior(), SETTINGS)
    assert len(found) > 120
    assert np.median(np.abs(found.vector - (5, -3))) < 0.05
    np.testing.assert_array_equal(found.x_cur % 16, np.full((len(found), 2), 7.5))


def test_a_long_motion_is_found_from_what_is_expected(rng):
    step = np.array([70, 20])
    grid = 16 * np.mgrid[0:12, 0:16][::-1].reshape(2, -1).T.astype(np.float32) + 7.5
    prior = MotionPrior()
    prior.add(Correspondences(0, -40_000_000, pictures.WIDTH, pictures.HEIGHT, SegmentKind.PP,
                              x_cur=grid.astype(np.float32),
                              x_prev=(grid + step - 2).astype(np.float32),
                              probability=np.ones(len(grid), np.float32)))
    found = search(segment(pictures.sliding(rng, 2, step)), prior, SETTINGS)
    assert len(found) > 60
    assert np.median(np.abs(found.vector - step)) < 0.1


def test_flat_macroblocks_are_left_out(rng):
    images = pictures.sliding(rng, 2, (2, 0))
    for image in images:
        image[:, :128] = 90
    found = search(segment(images), MotionPrior(), SETTINGS)
    assert len(found) > 50
    assert found.x_cur[:, 0].min() > 110


def test_what_left_the_picture_is_not_found(rng):
    found = search(segment(pictures.sliding(rng, 2, (12, 0))), MotionPrior(), SETTINGS)
    assert (found.x_cur + found.vector)[:, 0].max() < pictures.WIDTH


@pytest.mark.parametrize('change', [
    {'luma': None}, {'damage': 'lost'}, {'frame_type': FrameType.P},
    {'luma': np.zeros((8, 8), np.uint8)}, {'stamp': 0}, {'stamp': -10**10}])
def test_only_a_whole_and_later_i_frame_of_the_same_size_is_bridged(rng, change):
    whole = segment(pictures.sliding(rng, 2, (1, 0)))
    assert can_bridge(whole)
    assert not can_bridge(replace(whole, current=replace(whole.current, **change)))


def test_a_match_that_does_not_lead_back_is_dropped(rng):
    images = pictures.sliding(rng, 2, (3, 0))
    images[1][:, :96] = pictures.texture(rng)[:pictures.HEIGHT, :96]  # something new came in
    found = search(segment(images), MotionPrior(), SETTINGS)
    new = found.x_cur[:, 0] < 80
    assert np.count_nonzero(new) < 12
    assert np.count_nonzero(~new) > 70
