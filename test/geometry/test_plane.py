"""Planes by the points that lie on them."""

import formulas
from mv_slapse.geometry import plane, rotation
from numeric import jacobian
import numpy as np
import pytest


@pytest.fixture
def random_plane(rng):
    return rng.normal(0, 0.3, 3)


@pytest.fixture
def points(rng, random_plane):
    X = rng.normal(0, 5, (20, 3))
    return X - np.outer(X @ random_plane + 1, random_plane) / (random_plane @ random_plane)


def test_the_point_nearest_to_the_origin_lies_against_the_normal():
    normal, depth = formulas.to_normal_depth(np.array([0, -0.5, 0]))  # a road 2 m below the camera
    np.testing.assert_array_equal(normal, [0, -1, 0])
    assert depth == 2.0
    assert np.array([0, -0.5, 0]) @ [7.0, 2.0, 9.0] == -1


def test_transformed_points_lie_on_the_transformed_plane(rng, random_plane, points):
    R, t = rotation.exp(rng.normal(size=3)), rng.normal(size=3)
    np.testing.assert_allclose((points @ R.T + t) @ plane.transform(random_plane, R, t), -1)


def test_scaled_points_lie_on_the_scaled_plane(rng, random_plane, points):
    normal, depth = formulas.to_normal_depth(random_plane)
    place = rng.normal(0, 5, 3)
    scaled, _ = plane.scaled_about(place, 0.3, normal, depth, np.eye(4))
    np.testing.assert_allclose((place + 0.3 * (points - place)) @ normal + scaled, 0, atol=1e-9)


def test_the_covariance_of_a_scaled_plane_is_by_the_numerical_jacobian(rng, random_plane):
    known, place = np.r_[formulas.to_normal_depth(random_plane)], rng.normal(0, 5, 3)
    A = rng.normal(size=(4, 4))
    J = jacobian(lambda nd: np.r_[nd[:3], plane.scaled_about(
        place, 0.3, nd[:3], nd[3], np.eye(4))[0]], known)
    _, found = plane.scaled_about(place, 0.3, known[:3], known[3], A @ A.T)
    np.testing.assert_allclose(found, J @ A @ A.T @ J.T, rtol=1e-5, atol=1e-6)


def test_normal_depth_jacobian_is_the_numerical_one(random_plane):
    expected = jacobian(lambda p: np.r_[formulas.to_normal_depth(p)], random_plane)
    np.testing.assert_allclose(formulas.normal_depth_jacobian(random_plane), expected, rtol=1e-5,
                               atol=1e-6)
