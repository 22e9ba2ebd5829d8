"""Homographies of planes against the points that made them."""

from canyon import CANYON, K, motion, MOTIONS, views
import formulas
from kernels.two_view_reference import plane_transfer, plane_transfer_jacobian
from mv_slapse.geometry import rotation
from mv_slapse.geometry.camera import to_pixels, to_rays
from numeric import jacobian
import numpy as np
import pytest


def through(H, x):
    return to_pixels(H, np.c_[x, np.ones(len(x))])


@pytest.fixture(params=MOTIONS)
def scene(request):
    return views(*motion(request.param))


def test_a_plane_carries_its_points_to_the_previous_picture(scene):
    for i, plane in enumerate(CANYON):
        on = scene.surface == i
        H = formulas.induced_by_plane(K, scene.R, scene.t, plane)
        np.testing.assert_allclose(through(H, scene.x_cur[on]), scene.x_true[on],
                                   atol=1e-9)


def test_a_moving_plane_is_one_seen_from_a_camera_that_moves_otherwise(rng):
    R, t = motion('ahead')
    t_d, plane = np.array([0.1, 0.0, 0.4]), np.array([0.02, -0.01, -0.1])
    rays = np.c_[rng.uniform(-0.4, 0.4, (30, 2)), np.ones(30)]
    X = rays / -(rays @ plane)[:, None]
    X_prev = (X + t_d - t) @ R  # t_d takes the surface from k to k-1
    H = formulas.induced_by_plane(K, R, t - t_d, plane)
    np.testing.assert_allclose(through(H, to_pixels(K, X)), to_pixels(K, X_prev))


def test_transfer_of_rays_is_the_homography(scene):
    plane = CANYON[1]
    H = formulas.induced_by_plane(K, scene.R, scene.t, plane)
    on = scene.surface == 1
    np.testing.assert_allclose(
        plane_transfer(to_rays(K, scene.x_cur[on]), K, scene.R, scene.t, plane),
        through(H, scene.x_cur[on]))


def test_transfer_jacobian_is_the_numerical_one(rng, scene):
    plane = np.array([0.05, -0.02, -0.1]) + rng.normal(0, 0.01, 3)
    rays = to_rays(K, scene.x_cur[::40])

    def transferred(p):
        return plane_transfer(rays, K, rotation.exp(p[:3]) @ scene.R, scene.t + p[3:6],
                                         plane + p[6:])

    pixels, J = plane_transfer_jacobian(rays, K, scene.R, scene.t, plane)
    np.testing.assert_array_equal(pixels, transferred(np.zeros(9)))
    np.testing.assert_allclose(J, jacobian(transferred, np.zeros(9)), rtol=1e-5, atol=1e-4)


def test_no_blocks_give_no_pixels():
    pixels, J = plane_transfer_jacobian(np.zeros((0, 3)), K, np.eye(3), np.ones(3),
                                                   CANYON[0])
    assert pixels.shape == (0, 2)
    assert J.shape == (0, 2, 9)
