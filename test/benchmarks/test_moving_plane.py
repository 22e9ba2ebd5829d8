"""The rank-1 form of a moving plane: definition, round trip, Jacobians, ground contact."""

from mv_slapse.geometry.camera import to_pixels, to_rays
from mv_slapse.movers.moving_plane import homography
from numeric import jacobian
import numpy as np
import obstacles_reference as reference
import pytest
from scipy.spatial.transform import Rotation

from benchmarks.papers import moving_plane

K = np.array([[500.0, 0, 320], [0, 510, 240], [0, 0, 1]])


def random_theta(rng):
    return np.r_[rng.normal(0, 0.1, 3), rng.normal(0, 0.5, 2), rng.normal(2, 0.5)]


def scene(rng):
    theta, centre = random_theta(rng), rng.normal(0, 0.2, 2)
    R = Rotation.from_euler('YXZ', rng.normal(0, 0.05, 3)).as_matrix()
    rays = np.c_[centre + rng.uniform(-0.1, 0.1, (20, 2)), np.ones(20)]
    return theta, centre, R, rng.normal(0, 1, 3), rays


def test_transfer_moves_the_points_of_the_plane_by_their_displacement(rng):
    theta, centre, R, t, rays = scene(rng)
    state, _ = moving_plane.to_plane(theta, centre, t)
    X_cur = rays / -(rays @ state[:3])[:, None]
    X_prev = (X_cur + state[3:] - t) @ R
    x_prev, _ = reference.transfer(theta, rays, centre, K, R)
    np.testing.assert_allclose(x_prev, to_pixels(K, X_prev), atol=1e-9)


def test_transfer_is_the_homography_of_the_product(rng):
    theta, centre, R, _, rays = scene(rng)
    H = homography(moving_plane.product(theta, centre), K, R)
    x = np.c_[to_pixels(K, rays), np.ones(len(rays))] @ H.T
    x_prev, _ = reference.transfer(theta, rays, centre, K, R)
    np.testing.assert_allclose(x_prev, x[:, :2] / x[:, 2:], atol=1e-9)


def test_product_is_that_of_displacement_and_plane(rng):
    theta, centre, _, t, _ = scene(rng)
    state, _ = moving_plane.to_plane(theta, centre, t)
    np.testing.assert_allclose(moving_plane.product(theta, centre),
                               np.outer(t - state[3:], state[:3]), atol=1e-12)


def test_depth_is_that_of_the_centre(rng):
    theta, centre, _, t, _ = scene(rng)
    plane = moving_plane.to_plane(theta, centre, t)[0][:3]
    assert np.exp(theta[5]) * (np.r_[centre, 1] @ plane) == pytest.approx(-1)


def test_from_plane_undoes_to_plane(rng):
    theta, centre, _, t, _ = scene(rng)
    state, _ = moving_plane.to_plane(theta, centre, t)
    np.testing.assert_allclose(reference.from_plane(state[:3], state[3:], centre, t)[0], theta)


def test_jacobians_are_the_numerical_ones(rng):
    theta, centre, R, t, rays = scene(rng)
    state, by_theta = moving_plane.to_plane(theta, centre, t)
    np.testing.assert_allclose(
        by_theta, jacobian(lambda x: moving_plane.to_plane(x, centre, t)[0], theta), atol=1e-6)
    np.testing.assert_allclose(
        reference.from_plane(state[:3], state[3:], centre, t)[1],
        jacobian(lambda x: reference.from_plane(x[:3], x[3:], centre, t)[0], state, 1e-7),
        rtol=1e-5, atol=1e-4)
    np.testing.assert_allclose(
        reference.transfer(theta, rays, centre, K, R)[1],
        jacobian(lambda x: reference.transfer(x, rays, centre, K, R)[0], theta[:5]),
        rtol=1e-5, atol=1e-3)


def test_contact_lies_in_the_lowest_row_of_two_blocks_above_its_edge():
    x = np.array([[7.5, 7.5], [23.5, 7.5], [7.5, 23.5], [23.5, 23.5], [39.5, 39.5]])
    found = moving_plane.contact(x, np.full((5, 2), 16))
    # The row ends at 31.5, and is covered by a tenth to a whole and a tenth: 0.6.
    np.testing.assert_allclose(found.point, [np.mean(x[2:, 0]), 31.5 - 0.4 * 16])
    assert found.sigma == pytest.approx(16 / np.sqrt(12))


def test_contact_depth_is_where_the_ray_meets_the_ground(rng):
    pitch = Rotation.from_euler('x', rng.normal(0, 0.05)).as_matrix()
    ground = pitch @ [0, -1, 0] / 1.6
    centre, slope = np.array([0.1, 0.0]), rng.normal(0, 0.2, 2)
    contact = moving_plane.Contact(np.array([300.0, 330.0]), 4.0)
    found = moving_plane.contact_depth(ground, contact, K, slope, centre)
    state, _ = moving_plane.to_plane(np.r_[0, 0, 0, slope, found.value], centre, np.zeros(3))
    ray = to_rays(K, contact.point[None])[0]
    assert ray @ state[:3] == pytest.approx(ray @ ground)


def test_contact_depth_has_the_variance_of_its_row_and_the_numerical_derivative(rng):
    ground, centre, slope = np.array([0, -1 / 1.6, 0.02]), np.zeros(2), rng.normal(0, 0.2, 2)

    def depth(row, s=slope):
        return moving_plane.contact_depth(ground, moving_plane.Contact(np.array([300.0, row]),
                                                                       4.0), K, s, centre)
    by_slope = jacobian(lambda s: np.array([depth(330, s).value]), slope)[0]
    np.testing.assert_allclose(depth(330).by_slope, by_slope, atol=1e-6)
    flat = np.zeros(2)
    by_row = (depth(330.1, flat).value - depth(329.9, flat).value) / 0.2
    assert depth(330, flat).variance == pytest.approx((4 * by_row)**2, rel=1e-3)


@pytest.mark.parametrize('row', [200.0, 240.0, 244.0])
def test_contact_at_the_horizon_tells_nothing(row):
    contact = moving_plane.Contact(np.array([300.0, row]), 4.0)
    assert moving_plane.contact_depth(np.array([0, -0.6, 0]), contact, K, np.zeros(2),
                                      np.zeros(2)) is None
