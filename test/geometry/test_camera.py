"""Lenses there and back, and cameras that are refused."""

import cv2
from formulas import distort
from mv_slapse.errors import UnusableInput
from mv_slapse.geometry.camera import Camera, to_pixels, to_rays, undistort
import numpy as np
import pytest

K = np.array([[500.0, 0, 320], [0, 510, 240], [0, 0, 1]])
LENSES = {
    'plumb_bob': [-0.25, 0.08, 1e-3, -5e-4, 0.0],
    'rational_polynomial': [-0.3, 0.1, 1e-3, -5e-4, -0.01, 0.02, 0.01, 0.001],
    'equidistant': [0.02, -0.01, 0.003, -0.001],
}


@pytest.fixture
def pixels(rng):
    return rng.uniform((60, 60), (580, 420), (50, 2))


@pytest.mark.parametrize('lens', LENSES)
def test_distortion_undoes_undistortion(pixels, lens):
    camera = Camera(640, 480, K, lens, np.array(LENSES[lens]))
    ideal = undistort(camera, pixels)
    assert np.abs(ideal - pixels).max() > 1
    np.testing.assert_allclose(distort(camera, ideal), pixels, atol=1e-3)


def test_radial_distortion_is_the_polynomial():
    camera = Camera(640, 480, K, 'plumb_bob', np.array([-0.2, 0.05, 0, 0, 0]))
    ray = np.array([[0.3, 0.4, 1]])  # r^2 = 0.25: x (1 - 0.2 * 0.25 + 0.05 * 0.0625)
    expected = np.array([[0.3, 0.4]]) * 0.953125 * (500, 510) + (320, 240)
    np.testing.assert_allclose(distort(camera, to_pixels(K, ray)), expected)


def test_fisheye_distortion_is_the_angle_polynomial():
    camera = Camera(640, 480, K, 'equidistant', np.array([0.1, 0, 0, 0]))
    theta = 0.5  # a ray this far off the axis lands at theta (1 + k1 theta^2)
    seen = distort(camera, to_pixels(K, np.array([[np.tan(theta), 0, 1]])))
    np.testing.assert_allclose(seen, [[320 + 500 * theta * (1 + 0.1 * theta**2), 240]])


def test_a_fisheye_without_coefficients_is_no_pinhole():
    camera = Camera(640, 480, K, 'equidistant', np.zeros(4))
    theta = 0.7
    ideal = undistort(camera, np.array([[320 + 500 * theta, 240.0]]))
    np.testing.assert_allclose(ideal, [[320 + 500 * np.tan(theta), 240]], atol=1e-6)


def test_without_distortion_pixels_stay_bit_for_bit(pixels):
    camera = Camera(640, 480, K)
    for function in (distort, undistort):
        result = function(camera, pixels)
        np.testing.assert_array_equal(result, pixels)
        assert result is not pixels


@pytest.mark.parametrize('lens', LENSES)
def test_no_pixels_are_no_error(lens):
    camera = Camera(640, 480, K, lens, np.array(LENSES[lens]))
    assert undistort(camera, np.zeros((0, 2))).shape == (0, 2)
    assert distort(camera, np.zeros((0, 2))).shape == (0, 2)


def test_rays_are_the_inverse_of_the_intrinsics(pixels):
    for skewed in (0.0, 3.0):
        intrinsics = K + [[0, skewed, 0], [0, 0, 0], [0, 0, 0]]
        rays = to_rays(intrinsics, pixels)
        np.testing.assert_allclose(rays, np.c_[pixels, np.ones(50)] @ np.linalg.inv(intrinsics).T)
        np.testing.assert_allclose(to_pixels(intrinsics, 3 * rays), pixels)


def test_points_project_as_opencv_says(rng):
    X = rng.uniform((-2, -2, 3), (2, 2, 9), (20, 3))
    expected = cv2.projectPoints(X, np.zeros(3), np.zeros(3), K, None)[0][:, 0]
    np.testing.assert_allclose(to_pixels(K, X), expected)


@pytest.mark.parametrize('intrinsics', [np.zeros((3, 3)), np.diag([500.0, -1, 1]),
                                        np.full((3, 3), np.nan)])
def test_an_uncalibrated_camera_is_refused(intrinsics):
    with pytest.raises(UnusableInput, match='not calibrated'):
        Camera(640, 480, intrinsics)


def test_an_unknown_lens_is_refused_by_name():
    with pytest.raises(UnusableInput, match=r"'barrel'.*plumb_bob"):
        Camera(640, 480, K, 'barrel')
