from dataclasses import replace

import known_walls as walls
from mv_slapse.geometry import rotation
from mv_slapse.known_map import about, KnownMap, place
from mv_slapse.records import ScaleStatus
from mv_slapse.ros_frames import Pose
import numpy as np
import pytest


def placed(what, true, start=None, seed=1, known=walls.CORNER):
    made = KnownMap(walls.seen(known, walls.ORIGIN, 1000 + seed, 50), True)
    return place(made, walls.scene(walls.seen(what, true, seed)), start or about())


def error(found, true):
    pose = found.known_from_world
    return np.r_[pose.t - true.t, rotation.log(pose.R @ true.R.T)]


def test_the_start_is_found_as_surely_as_it_says():
    rng, nees = np.random.default_rng(0), []
    for seed in range(40):
        true = walls.pose(rng)
        found = placed(walls.CORNER, true, seed=seed)
        assert dict(found.matches) == {0: 50, 1: 51, 2: 52, 3: 53}
        e = error(found, true)
        assert np.linalg.norm(e[[0, 2]]) < 1.5
        nees.append(e @ np.linalg.solve(found.known_from_world.covariance, e))
    assert 2 < np.mean(nees) < 8  # 6, and the ground's bends are allowed for, which are not there


def test_planes_that_are_parallel_do_not_tell_the_place_along_them():
    found = placed(walls.STREET, walls.ORIGIN)
    assert found.known_from_world is None
    assert len(found.matches) == 3
    assert 'do not tell the place in every direction' in found.reason


def test_where_no_plane_is_seen_again_it_says_so():
    elsewhere = ((np.array([0.7, 0, -0.7]), np.array([40.0, -2, 90])),)
    found = placed(elsewhere, walls.ORIGIN)
    assert found.known_from_world is None
    assert 'no plane of the map is found again' in found.reason


def test_a_plane_that_may_be_one_of_two_is_not_taken_for_either():
    other = (walls.LEFT[0], (-12, -2, 25))
    found = placed((walls.LEFT,), walls.ORIGIN, known=(*walls.CORNER, other))
    assert found.matches == ()


def test_a_surface_that_the_map_holds_twice_is_still_one():
    twice = (*walls.CORNER, (walls.LEFT[0], (-8.1, -2, 30)))
    found = placed(walls.CORNER, walls.ORIGIN, known=twice)
    assert found.known_from_world is not None


def test_another_corner_is_not_taken_for_the_known_one():
    rng, accepted, found = np.random.default_rng(0), 0, 0
    for seed in range(60):
        here, there = walls.corner(rng), walls.corner(rng)
        accepted += placed(there, walls.ORIGIN, seed=seed, known=here).known_from_world is not None
        found += placed(here, walls.pose(rng), seed=seed, known=here).known_from_world is not None
    assert accepted <= 1  # 15 without asking for a wall more than the place needs
    assert found >= 59


def test_a_wall_that_was_moved_contradicts_the_others():
    known = (*walls.CORNER, ((0, 0, 1), (0, -2, -20)))
    seen = (*walls.CORNER, ((0, 0, 1), (0, -2, -24)))
    start = replace(about(), covariance=about().covariance * 0.3)
    found = placed(seen, walls.ORIGIN, start, known=known)
    told = dict(found.matches)
    assert 4 not in told or found.known_from_world is None


def test_a_start_that_is_known_well_is_only_believed_as_far_as_it_says():
    true = Pose(np.eye(3), np.array([0.0, 0, 60]))
    assert placed(walls.CORNER, true).known_from_world is None
    told = about(Pose(np.eye(3), np.array([2.0, 0, 58])))
    assert np.linalg.norm(error(placed(walls.CORNER, true, told), true)[[0, 2]]) < 1.5
    exact = Pose(true.R, true.t, np.zeros((6, 6)))
    assert placed(walls.CORNER, true, exact).known_from_world is None  # nothing is left to tell


@pytest.mark.parametrize('whose', ['this run', 'the map'])
def test_without_a_scale_lengths_are_not_compared(whose):
    scale = ScaleStatus.UNKNOWN if whose == 'this run' else ScaleStatus.METRIC
    known = KnownMap(walls.seen(walls.CORNER, walls.ORIGIN), whose == 'this run')
    found = place(known, walls.scene(walls.seen(walls.CORNER, walls.ORIGIN), scale=scale), about())
    assert found.known_from_world is None
    assert f'the scale of {whose} is not known' in found.reason
