"""The map's planes in {W}: parameters, covariance, outline and history."""

from dataclasses import replace

import formulas
from mv_slapse.geometry import plane as plane_geometry
from mv_slapse.geometry import rotation
from mv_slapse.geometry.camera import to_rays
from mv_slapse.records import Label
from mv_slapse.scene import plane_map as scene_map
from mv_slapse.scene import state as scene_state
from mv_slapse.scene.plane_map import SceneMap
from mv_slapse.scene.state import AnchoredPlane, Pose
from numeric import jacobian
import numpy as np
import pytest
from scene_drive import Canyon, GROUND, stamp

WALL = 1


def state_at(canyon, k):
    """Return a state with the true pose of a key frame and its planes, anchored there."""
    state = scene_state.start(np.array([0, -1.0, 0]), 1.0, 0.1, 0.05)
    R, t = canyon.pose(k)
    state.current = Pose(R, t)
    for i, plane in enumerate(canyon.planes(k)):
        state.add_plane(i, AnchoredPlane(R @ plane, t.copy()), 1e-4 * np.diag([1.0, 2, 3]))
    return state


@pytest.fixture
def canyon():
    return Canyon(yaw_rate=0.3)


@pytest.fixture
def observed(canyon):
    state, known = state_at(canyon, 3), SceneMap()
    known.observe(state, canyon.extraction(3), list(state.planes))
    return state, known


def world_plane(canyon, id_):
    """Return n / d in {W}, which is the camera of key frame 0."""
    return canyon.planes(0)[id_]


def test_planes_are_those_of_the_world(canyon, observed):
    state, known = observed
    for plane in known.planes(state):
        normal, depth = formulas.to_normal_depth(world_plane(canyon, plane.id))
        np.testing.assert_allclose(plane.normal, normal, atol=1e-9)
        assert plane.depth == pytest.approx(depth)
        np.testing.assert_allclose(plane.outline @ plane.normal + plane.depth, 0, atol=1e-5)


def test_covariance_is_that_of_the_numerical_derivative(observed):
    state, known = observed
    anchored = state.planes[WALL]

    def normal_and_depth(e):
        normal, depth = formulas.to_normal_depth(anchored.plane + e)
        return np.r_[normal, depth - normal @ anchored.anchor]

    J = jacobian(normal_and_depth, np.zeros(3))
    np.testing.assert_allclose(known.planes(state)[WALL].covariance,
                               J @ state.error.covariance(WALL) @ J.T, rtol=1e-5, atol=1e-9)


def test_a_handover_is_the_plane_about_the_worlds_origin(canyon, observed):
    state, known = observed
    handover = known.handover(state, WALL, stamp(3))
    np.testing.assert_allclose(handover.plane, world_plane(canyon, WALL), atol=1e-12)
    assert (handover.id, handover.stamp, handover.to_label) == (WALL, stamp(3), Label.MOVING)
    np.testing.assert_array_equal(handover.velocity, 0)
    anchored = state.planes[WALL]
    J = jacobian(lambda p: plane_geometry.transform(p, np.eye(3), anchored.anchor), anchored.plane)
    np.testing.assert_allclose(handover.covariance[:3, :3],
                               J @ state.error.covariance(WALL) @ J.T, rtol=1e-5, atol=1e-12)
    assert np.linalg.eigvalsh(handover.covariance).min() > 0


def test_the_outline_holds_all_blocks_of_the_plane_in_reach(canyon, observed):
    state, known = observed
    extraction, outline = canyon.extraction(3), known.planes(state)[WALL].outline
    rays = to_rays(extraction.K, extraction.x_cur[extraction.plane_id == WALL].astype(float))
    X = rays / -(rays @ canyon.planes(3)[WALL])[:, None] @ state.current.R.T + state.current.t
    for axis in (1, 2):
        assert outline[:, axis].min() == pytest.approx(X[:, axis].min(), abs=1e-3)
        assert outline[:, axis].max() == pytest.approx(X[:, axis].max(), abs=1e-3)


def test_an_outline_grows_and_ends_where_a_grazing_ray_means_nothing(canyon):
    state, known = state_at(canyon, 3), SceneMap()
    extraction, depth = canyon.extraction(3), []
    row = extraction.x_cur[:, 1]
    for rows in (row > 400, (row > 245) & (row < 400)):  # near blocks, then to the horizon
        on_road = np.where(rows, GROUND, -1).astype(np.int32)
        known.observe(state, replace(extraction, plane_id=on_road), list(state.planes))
        outline = (known.planes(state)[GROUND].outline - state.current.t) @ state.current.R
        depth.append((outline[:, 2].min(), outline[:, 2].max()))
    assert depth[0][1] < 6
    assert depth[1][0] == pytest.approx(depth[0][0], abs=1e-3)
    # The lowest row under the horizon is at 1.6 m / (8 px / 510 px) = 102 m.
    assert 20 < depth[1][1] < 1.6 * scene_map.FARTHEST


def test_history_counts_key_frames_in_which_a_plane_was_seen(canyon, observed):
    state, known = observed
    later = canyon.extraction(4)
    without = replace(later, planes=tuple(p for p in later.planes if p.id != WALL))
    known.observe(state, without, list(state.planes))
    wall, other = known.planes(state)[WALL], known.planes(state)[2]
    assert (wall.first_stamp, wall.last_stamp, wall.n_observations) == (stamp(3), stamp(3), 1)
    assert wall.n_macroblocks == 0
    assert (other.first_stamp, other.last_stamp, other.n_observations) == (stamp(3), stamp(4), 2)
    assert other.n_macroblocks == next(p for p in later.planes if p.id == 2).n_macroblocks
    unseen = stamp(5) - stamp(3)
    assert WALL in known.overdue(state, stamp(5), unseen - 1)
    assert WALL not in known.overdue(state, stamp(5), unseen)
    known.wait(stamp(1))
    assert WALL in known.overdue(state, stamp(5), unseen - stamp(1) - 1)
    assert WALL not in known.overdue(state, stamp(5), unseen - stamp(1))


def test_the_ground_is_the_one_seen_last(canyon, observed):
    state, known = observed
    assert known.ground == GROUND
    later = canyon.extraction(4)
    other = replace(later, planes=(replace(later.planes[2], is_ground=True),))
    known.observe(state, other, [2])
    assert known.ground == 2
    assert SceneMap().ground is None


def test_an_adopted_plane_has_a_history_and_no_outline_yet(observed):
    state, known = observed
    state.add_plane(50, AnchoredPlane(np.array([0, 0, -0.1]), np.zeros(3)), np.eye(3))
    known.adopt(50, stamp(3))
    adopted = known.planes(state)[-1]
    assert (adopted.id, adopted.n_observations, adopted.last_stamp) == (50, 0, stamp(3))
    assert adopted.outline.shape == (0, 3)
    state.remove_plane(50)
    known.remove(50)
    assert 50 not in [plane.id for plane in known.planes(state)]


def test_scaling_scales_the_outlines(observed):
    state, known = observed
    before = known.planes(state)[WALL].outline
    known.adopt(50, stamp(3))
    known.scale(2.0, np.zeros(3))
    np.testing.assert_allclose(known.planes(state)[WALL].outline, 2 * before)


def seen_often(canyon, n=scene_map.WELL_SEEN):
    state, known = state_at(canyon, 3), SceneMap()
    for _ in range(n):
        known.observe(state, canyon.extraction(3), list(state.planes))
    return state, known


def test_a_well_seen_wall_stays_in_the_map_when_the_filter_gives_it_up(canyon):
    state, known = seen_often(canyon)
    before = {plane.id: plane for plane in known.planes(state)}
    for id_ in (WALL, GROUND):
        known.leave(state, id_)
    planes = {plane.id: plane for plane in known.planes(state)}
    assert GROUND not in planes  # elsewhere the road is another
    assert planes[WALL].n_macroblocks == 0
    np.testing.assert_array_equal(planes[WALL].outline, before[WALL].outline)
    known.scale(2.0, np.zeros(3))
    scaled = {plane.id: plane for plane in known.planes(state)}[WALL]
    assert scaled.depth == 2 * planes[WALL].depth
    known.scale(1.5, np.array([3.0, -1, 2]))
    apart = {plane.id: plane for plane in known.planes(state)}[WALL]
    np.testing.assert_allclose(apart.outline @ apart.normal + apart.depth,
                               1.5 * (scaled.outline @ scaled.normal + scaled.depth), atol=1e-9)
    np.testing.assert_array_equal(scaled.outline, 2 * planes[WALL].outline)
    D = np.diag([1.0, 1, 1, 2])
    np.testing.assert_allclose(scaled.covariance, D @ planes[WALL].covariance @ D)
    state.add_plane(WALL, state_at(canyon, 3).planes[WALL], np.eye(3))
    known.observe(state, canyon.extraction(3), [WALL])
    again = [plane for plane in known.planes(state) if plane.id == WALL]
    assert [plane.n_observations for plane in again] == [scene_map.WELL_SEEN + 1]


def test_a_plane_seen_by_chance_does_not_stay(canyon):
    state, known = seen_often(canyon, scene_map.WELL_SEEN - 1)
    known.leave(state, WALL)
    assert WALL not in state.planes
    assert WALL not in [plane.id for plane in known.planes(state)]


def test_walls_out_of_view_are_held_up_to_a_number_and_others_for_a_time(canyon, monkeypatch):
    state, known = seen_often(canyon)
    known.adopt(50, stamp(3))  # seen once, by another filter
    state.add_plane(50, AnchoredPlane(np.array([0, 0, -0.1]), np.zeros(3)), np.eye(3))
    late = stamp(3) + int(3e9)
    assert known.overdue(state, stamp(4), int(2e9)) == []
    assert sorted(known.overdue(state, late, int(2e9))) == [GROUND, 50]
    monkeypatch.setattr(scene_map, 'MOST_KEPT', 1)
    walls = set(state.planes) - {GROUND, 50}
    overdue = known.overdue(state, late, int(2e9))
    assert len(walls - set(overdue)) == 1


def test_the_map_keeps_the_planes_seen_last_if_there_are_too_many(canyon, monkeypatch):
    monkeypatch.setattr(scene_map, 'MOST_LEFT', 1)
    state, known = seen_often(canyon)
    known.observe(state, canyon.extraction(4), [2])
    for id_ in (2, WALL):
        known.leave(state, id_)
    ids = [plane.id for plane in known.planes(state)]
    assert 2 in ids
    assert WALL not in ids


def test_a_turned_camera_sees_the_same_outline(observed):
    state, known = observed
    np.testing.assert_allclose(state.current.R, rotation.exp([0, 0.3 * 0.3, 0]), atol=1e-9)
    hull = known.planes(state)[WALL].outline
    assert np.all((hull - state.current.t) @ state.current.R[:, 2] > 0)
