from mv_slapse.geometry.camera import to_pixels, to_rays
from mv_slapse.records import Label
from mv_slapse.simulation import drawn
from mv_slapse.simulation.street import Street, StreetSettings
import numpy as np
import pytest


@pytest.fixture(scope='module')
def street():
    return Street(StreetSettings(seed=3))


def homography(street, i, j, n, d):
    """Map rays of frame j to frame i by a plane n X + d = 0 of {W} (point by point)."""
    R_j, t_j = street.pose(j)
    R_i, t_i = street.pose(i)
    n_cam, d_cam = R_j.T @ n, d + n @ t_j
    R, t = R_i.T @ R_j, R_i.T @ (t_j - t_i)
    return R - np.outer(t, n_cam) / d_cam


def test_matches_on_a_plane_follow_the_homography_it_induces(street, rng):
    pair = drawn.draw(street, 20, 24, rng, sigma=0, outliers=0)
    for plane in street.planes:
        on = pair.surface == plane.id
        H = homography(street, 20, 24, plane.normal, plane.depth)
        rays = to_rays(street.camera.K, pair.correspondences.x_cur[on]) @ H.T
        np.testing.assert_allclose(to_pixels(street.camera.K, rays), pair.x_true[on], atol=1e-6)


def test_the_sky_moves_by_rotation_only(street, rng):
    pair = drawn.draw(street, 20, 24, rng, sigma=0, outliers=0)
    sky = pair.label == Label.INFINITY
    R = street.pose(20)[0].T @ street.pose(24)[0]
    rays = to_rays(street.camera.K, pair.correspondences.x_cur[sky]) @ R.T
    np.testing.assert_allclose(to_pixels(street.camera.K, rays), pair.x_true[sky], atol=0.05)
    assert sky.sum() > 50


def test_movers_break_the_epipolar_geometry_of_the_camera_and_the_rest_keeps_it(street, rng):
    pair = drawn.draw(street, 20, 28, rng, sigma=0, outliers=0)
    R_i, t_i = street.pose(20)
    R_j, t_j = street.pose(28)
    R, t = R_j.T @ R_i, R_j.T @ (t_i - t_j)
    a = to_rays(street.camera.K, pair.correspondences.x_cur)
    b = to_rays(street.camera.K, pair.x_true) @ R.T
    depth = -np.sum(np.cross(t, a) * np.cross(b, a), 1) / np.sum(np.cross(b, a) ** 2, 1)
    residual = np.abs(np.sum(a * np.cross(t, b), 1)) / np.linalg.norm(np.cross(t, b), axis=1)
    still = pair.label == Label.STATIONARY
    assert residual[still].max() < 1e-6
    wrong = (residual > 1e-4) | (depth < 0) | (depth > 1e3)
    assert wrong[pair.label == Label.MOVING].mean() > 0.9


def test_a_hidden_point_is_not_drawn(street):
    centres = drawn.block_centres(640, 480)
    x_i, surface, seen = drawn.match(street, 20, 40, centres)
    back, again, _ = drawn.match(street, 40, 20, x_i[seen])
    np.testing.assert_allclose(back, centres[seen], atol=1e-3)
    np.testing.assert_array_equal(again, surface[seen])
    assert 0.4 < seen.mean() < 0.97


def test_noise_and_outliers_have_the_stated_size(street, rng):
    pair = drawn.draw(street, 20, 24, rng, sigma=0.5, outliers=0.2)
    error = pair.correspondences.x_prev - pair.x_true
    assert pair.outlier.mean() == pytest.approx(0.2, abs=0.05)
    assert error[~pair.outlier].std() == pytest.approx(0.5, abs=0.05)
    assert np.linalg.norm(error[pair.outlier], axis=1).mean() > 8
    assert np.all(pair.correspondences.sigma == 0.5)


def test_a_generator_in_the_same_state_draws_the_same_pair(street):
    first, second = (drawn.draw_pair(street, 3, 7, np.random.default_rng(5)) for _ in range(2))
    np.testing.assert_array_equal(first.x_prev, second.x_prev)
    assert (first.previous_stamp, first.stamp) == (street.stamp(3), street.stamp(7))
