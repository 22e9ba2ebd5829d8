from dataclasses import replace

import made_up
from mv_slapse import drawing
from mv_slapse.records import Label, ObstacleState
import numpy as np

CENTRES = np.c_[[v.ravel() for v in np.meshgrid([8.0, 24, 40, 56], [8.0, 24])]].T
BOX = drawing.Box(3, (36.0, 18.0, 10.0, 8.0), 5.0, 1.5)


def test_blocks_and_boxes_lie_where_they_belong():
    label = np.full(8, Label.UNKNOWN, int)
    label[1], label[6] = Label.MOVING, Label.STATIONARY
    plane = np.array([-1, 7, -1, -1, -1, -1, 2, -1])
    image = np.full((32, 64, 3), 100, np.uint8)
    drawn = drawing.draw(image, CENTRES, label, plane, [BOX])
    np.testing.assert_allclose(drawn[8, 18], 0.6 * 100 + 0.4 * np.array(drawing.RED), atol=1)
    np.testing.assert_allclose(drawn[29, 35], 0.6 * 100 + 0.4 * np.array(drawing.PLANES[2]),
                               atol=1)
    np.testing.assert_array_equal(drawn[26, 40], drawing.RED)
    assert (drawn[30, 50:] == 100).all()
    assert (image == 100).all()


def test_each_plane_is_outlined_around_its_blocks_without_their_holes():
    columns, rows = np.meshgrid(np.arange(5), np.arange(5))
    centres = 16.0 * np.c_[columns.ravel(), rows.ravel()] + 7.5
    plane = np.full((5, 5), -1)
    plane[1:4, 1:4], plane[4, 0] = 3, 4
    plane[2, 2] = -1  # a hole in the plane
    label = np.where(plane >= 0, Label.STATIONARY, Label.UNKNOWN)
    drawn = drawing.draw(np.zeros((80, 80), np.uint8), centres, label.ravel(), plane.ravel())
    full = (drawn == drawing.PLANES[3]).all(axis=2)
    assert full[[16, 63], 16:64].all()
    assert full[16:64, [16, 63]].all()
    assert not full[18:62, 18:62].any()
    assert not full[66:].any()
    assert (drawn[64, :16] == drawing.PLANES[4]).all()


def test_a_grey_picture_becomes_a_coloured_one():
    image = np.arange(32 * 64, dtype=np.uint8).reshape(32, 64)
    none = np.full(8, Label.UNKNOWN)
    drawn = drawing.draw(image, CENTRES, none, none)
    np.testing.assert_array_equal(drawn, np.repeat(image[..., None], 3, axis=2))


def test_only_confirmed_obstacles_are_shown_with_their_speed():
    obstacle = made_up.obstacle(np.random.default_rng(0))
    shown = replace(obstacle, state=ObstacleState.CONFIRMED, velocity=np.array([3.0, 0, 4.0]))
    assert drawing.is_shown(shown)
    assert not drawing.is_shown(replace(obstacle, state=ObstacleState.TENTATIVE))
    assert drawing.box_of(shown).speed == 5.0
