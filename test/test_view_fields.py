from dataclasses import replace

import made_up
from mv_slapse import fields, view_fields
from mv_slapse.records import ObstacleState
from mv_slapse.ros_frames import points_to_odom, RosFrames
from mv_slapse.view_fields import ARROW, DELETE, MarkerBoard, TEXT, TRIANGLES
import numpy as np
from numpy.testing import assert_allclose
import pytest

STAMP = 5_000_000_001


@pytest.fixture
def frames(rng) -> RosFrames:
    return RosFrames('map', R_base_from_cam=made_up.rotation(rng),
                     t_base_from_cam=rng.normal(size=3))


def corners(marker):
    return np.array([[point[name] for name in 'xyz'] for point in marker['points']])


def test_a_plane_is_a_fan_over_its_outline(rng, frames):
    scene = made_up.scene(rng)
    (marker,) = view_fields.plane_markers(scene, frames)
    outline = points_to_odom(scene.planes[0].outline, frames)
    assert (marker['ns'], marker['id'], marker['type']) == ('planes', 7, TRIANGLES)
    assert_allclose(corners(marker), outline[[0, 1, 2, 0, 2, 3]])
    assert marker['pose']['orientation']['w'] == 1


def test_ground_and_walls_have_their_colours(rng, frames):
    scene = made_up.scene(rng)
    wall = replace(scene.planes[0], is_ground=False)
    shown = view_fields.plane_markers(replace(scene, planes=(*scene.planes, wall)), frames)
    assert shown[0]['color'] != shown[1]['color']


def test_a_plane_without_outline_is_not_drawn(rng, frames):
    scene = made_up.scene(rng)
    thin = replace(scene.planes[0], outline=np.zeros((2, 3)))
    assert view_fields.plane_markers(replace(scene, planes=(thin,)), frames) == []


def test_an_obstacle_is_a_surface_an_arrow_and_a_text(rng, frames):
    obstacle = replace(made_up.obstacle(rng), time_to_contact=2.34)
    surface, arrow, text = view_fields.obstacle_markers([obstacle], frames)
    assert (surface['type'], arrow['type'], text['type']) == (TRIANGLES, ARROW, TEXT)
    start, end = corners(arrow)
    assert_allclose(start, points_to_odom(obstacle.position, frames))
    assert_allclose(end, points_to_odom(obstacle.position + obstacle.velocity, frames))
    assert text['text'] == '9: 2.3 s'


def test_states_have_their_colours(rng, frames):
    obstacle = made_up.obstacle(rng)
    colours = [tuple(view_fields.obstacle_markers([replace(obstacle, state=state)], frames)[0][
        'color'].values()) for state in ObstacleState]
    assert len(set(colours)) == len(ObstacleState)


def test_what_vanishes_is_deleted_once(rng, frames):
    board = MarkerBoard('map', lifetime=0.5)
    planes = view_fields.plane_markers(made_up.scene(rng), frames)
    first = board.show(STAMP, planes)['markers']
    assert [(m['action'], m['header'], m['lifetime']) for m in first] == [
        (0, fields.header(STAMP, 'map'), {'sec': 0, 'nanosec': 500_000_000})]
    (gone,) = board.show(STAMP, [])['markers']
    assert (gone['action'], gone['ns'], gone['id']) == (DELETE, 'planes', 7)
    assert board.show(STAMP, [])['markers'] == []


def test_a_path_is_in_odom(rng, frames):
    pose = fields.pose_stamped_to_fields(made_up.scene(rng), frames)
    path = view_fields.path_to_fields(STAMP, [pose, pose], frames)
    assert path['header'] == fields.header(STAMP, 'map')
    assert path['poses'] == [pose, pose]
