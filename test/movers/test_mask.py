"""A picture of 8x6 macroblocks, and a mover 7 on some of them."""

from mv_slapse.movers.mask import Silhouettes
from mv_slapse.records import (
    CameraMotion,
    Correspondences,
    Extraction,
    Label,
    MotionStatus,
    PlaneObservation,
    SegmentKind,
)
import numpy as np
import pytest

SIZE = (128, 96)
PAIR = 100_000_000
RING = [(2, 1), (3, 1), (4, 1), (2, 2), (4, 2), (2, 3), (3, 3), (4, 3)]


def centres(cells):
    return 16 * np.array(cells, float).reshape(-1, 2) + 7.5


class Film:
    """Key frames, one after the other, and their labels (6, 8)."""

    def __init__(self):
        self.silhouettes, self.stamp = Silhouettes(), 0

    def show(self, cells=(), shift=(0.0, 0.0), still=(), growth=0.0):
        """Show a mover on some macroblocks, that came from ``shift`` px off, and still ones."""
        self.stamp += PAIR
        x = centres([*cells, *still])
        n, mover = len(x), np.arange(len(x)) < len(cells)
        off = x - x[mover].mean(axis=0) if n and len(cells) else x
        x_prev = x + np.where(mover[:, None], np.array(shift) + growth * off, 0)
        columns = {'x_cur': x.astype(np.float32), 'x_prev': x_prev.astype(np.float32)}
        plane = PlaneObservation(7, Label.MOVING, np.ones(3), np.eye(6))
        extraction = Extraction(
            self.stamp, self.stamp - PAIR, *SIZE, SegmentKind.PP, np.eye(3),
            CameraMotion(MotionStatus.MOVING), (plane,) if len(cells) else (),
            block=np.full((n, 2), 16, np.uint8), label=mover.astype(np.int8),
            plane_id=np.where(mover, 7, -1).astype(np.int32), **columns)
        correspondences = Correspondences(self.stamp, self.stamp - PAIR, *SIZE, SegmentKind.PP,
                                          **columns)
        self.shown = self.silhouettes.fill(extraction, correspondences)
        return self.shown.macroblock_label.reshape(6, 8)


@pytest.fixture
def film():
    return Film()


def test_a_hole_inside_a_mover_is_part_of_it(film):
    label = film.show(RING)
    assert label[2, 3] == Label.MOVING
    assert film.shown.macroblock_plane.reshape(6, 8)[2, 3] == 7
    assert np.sum(label == Label.MOVING) == 9
    assert np.sum(label == Label.UNKNOWN) == 39


def test_a_stray_macroblock_does_not_stretch_the_outline(film):
    label = film.show([*RING, (7, 5)])
    assert label[5, 7] == Label.MOVING
    assert np.sum(label == Label.MOVING) == 10
    # where all are apart, as on a narrow mover without texture, all make it
    assert np.sum(Film().show([(1, 1), (3, 1), (5, 1), (3, 3)]) == Label.MOVING) == 9


def test_what_stands_still_inside_the_outline_stays_still(film):
    assert film.show(RING, still=[(3, 2)])[2, 3] == Label.STATIONARY


def test_a_mover_without_vectors_moves_on_as_it_did(film):
    film.show(RING, shift=(-16, 0))
    label = film.show()
    expected = np.zeros((6, 8), bool)
    expected[1:4, 3:6] = True
    np.testing.assert_array_equal(label == Label.MOVING, expected)
    np.testing.assert_array_equal(film.show() == Label.MOVING, np.roll(expected, 1, axis=1))


def test_the_part_that_lost_its_vectors_moves_with_the_rest(film):
    film.show(RING, shift=(0, -16))
    label = film.show([(2, 2), (3, 2), (4, 2)], shift=(0, -16))
    assert np.sum(label == Label.MOVING) == 9
    assert np.all(label[2:5, 2:5] == Label.MOVING)


def test_what_stands_out_of_the_outline_is_left_behind(film):
    film.show([(x, y) for x in (2, 3, 4) for y in (1, 2, 3)])
    label = film.show([(x, y) for x in (2, 3) for y in (1, 2, 3)])
    expected = np.zeros((6, 8), bool)
    expected[1:4, 2:4] = expected[2, 4] = True
    np.testing.assert_array_equal(label == Label.MOVING, expected)


def test_a_mover_that_comes_near_grows(film):
    film.show([(x, y) for x in (2, 3, 4) for y in (1, 2, 3)], growth=-0.4)
    assert np.sum(film.show() == Label.MOVING) == 25


def test_vectors_of_the_scene_end_a_silhouette(film):
    film.show(RING)
    label = film.show(still=[(2, 1), (3, 2)])
    assert label[1, 2] == label[2, 3] == Label.STATIONARY
    assert film.show()[2, 3] == Label.UNKNOWN
    assert film.show()[1, 3] == Label.MOVING


def test_a_silhouette_expires_a_third_of_a_second_after_its_last_evidence(film):
    film.show(RING)
    left = [np.sum(film.show() == Label.MOVING) for _ in range(6)]
    assert left == [9, 9, 9, 0, 0, 0]


def test_a_film_that_begins_again_knows_no_mover(film):
    film.show(RING)
    film.stamp = -PAIR
    assert not np.any(film.show() == Label.MOVING)
