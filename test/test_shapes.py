from mv_slapse import shapes
import numpy as np
import pytest

SQUARE = np.array([[0.0, 0, 0], [2, 0, 0], [2, 0, 1], [0, 0, 1]])  # a wall, seen edge-on


def area(triangles):
    sides = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    return np.linalg.norm(sides, axis=1).sum() / 2


def test_a_fan_covers_the_outline_once():
    assert area(shapes.fan(SQUARE)) == pytest.approx(2.0)
    assert shapes.fan(SQUARE[:2]).shape == (0, 3, 3)


def test_points_lie_on_the_surface_and_leave_no_hole():
    points = shapes.sample(SQUARE, 0.25)
    assert np.all(points[:, 1] == 0)
    assert points.min() >= 0
    assert np.all(points.max(0) <= (2, 0, 1))
    probe = np.random.default_rng(0).uniform((0, 0, 0), (2, 0, 1), (200, 3))
    assert np.linalg.norm(probe[:, None] - points, axis=2).min(1).max() < 0.25


def test_a_huge_surface_gives_a_bounded_number_of_points():
    assert len(shapes.sample(SQUARE * 1000, 0.1, most=400)) <= 400


def test_too_small_an_outline_gives_its_own_points():
    np.testing.assert_array_equal(shapes.sample(SQUARE[:1], 0.1), SQUARE[:1])


def test_a_wall_seen_edge_on_gets_a_footprint_of_the_depth_asked_for():
    corners = shapes.footprint(SQUARE, 0.5)
    assert np.ptp(corners[:, 0]) == pytest.approx(2.0, abs=1e-5)
    assert np.ptp(corners[:, 1]) == pytest.approx(0.5, abs=1e-5)
    assert corners.mean(0) == pytest.approx([1.0, 0.0], abs=1e-5)


def test_a_slanted_wall_keeps_its_direction():
    corners = shapes.footprint(SQUARE @ np.array([[0.6, 0.8, 0], [-0.8, 0.6, 0], [0, 0, 1]]), 0.5)
    sides = np.linalg.norm(corners - np.roll(corners, 1, axis=0), axis=1)
    np.testing.assert_allclose(np.sort(sides), [0.5, 0.5, 2, 2], atol=1e-5)


def test_a_wide_footprint_is_the_convex_hull():
    flat = np.array([[0.0, 0, 5], [2, 0, 1], [1, 1, 2], [0, 2, 0]])
    assert len(shapes.footprint(flat, 0.5)) == 3
