"""Two views of a canyon: errors, depths and parallax by definition, Jacobians numerically."""

from canyon import GRID, K, motion, MOTIONS, views
import formulas
from kernels.two_view_reference import epipolar_jacobian
from mv_slapse.geometry import rotation, two_view
from mv_slapse.geometry.camera import to_rays
from numeric import jacobian
import numpy as np
import pytest

FOCAL = np.diag(K)[:2]


@pytest.fixture(params=MOTIONS)
def exact(request):
    return views(*motion(request.param))


def error_of(scene, x_prev, w=0.0, t=None):
    R = rotation.exp(w * np.ones(3)) @ scene.R if np.isscalar(w) else rotation.exp(w) @ scene.R
    return formulas.epipolar_error(to_rays(K, scene.x_cur), to_rays(K, x_prev), FOCAL, R,
                                   scene.t if t is None else t)


def test_fundamental_matrix_vanishes_on_matches(exact):
    F = formulas.fundamental(K, exact.R, exact.t)
    x, x_prev = (np.c_[x, np.ones(len(x))] for x in (exact.x_cur, exact.x_true))
    np.testing.assert_allclose(np.sum(x @ F * x_prev, axis=1), 0, atol=1e-12)


def test_error_is_the_distance_from_the_line_of_the_fundamental_matrix(rng, exact):
    x_prev = exact.x_true + rng.normal(0, 5, exact.x_true.shape)
    lines = np.c_[exact.x_cur, np.ones(len(x_prev))] @ formulas.fundamental(K, exact.R, exact.t)
    distance = np.sum(lines * np.c_[x_prev, np.ones(len(x_prev))], axis=1) / np.hypot(
        *lines[:, :2].T)
    np.testing.assert_allclose(error_of(exact, x_prev), distance, atol=1e-9)


def test_error_jacobian_is_the_numerical_one(rng, exact):
    x_prev = exact.x_true + rng.normal(0, 5, exact.x_true.shape)
    # At the epipole itself the line has no direction and the error no derivative.
    away = np.hypot(*(exact.x_true - exact.x_cur).T) > 0.3
    numerical = jacobian(
        lambda p: error_of(exact, x_prev, p[:3], exact.t + p[3:])[away], np.zeros(6))
    error, J = epipolar_jacobian(to_rays(K, exact.x_cur), to_rays(K, x_prev), FOCAL,
                                          exact.R, exact.t)
    np.testing.assert_allclose(J[away], numerical, rtol=1e-5, atol=1e-3)
    np.testing.assert_allclose(error, error_of(exact, x_prev), atol=1e-11)


def test_error_is_blind_to_the_length_of_the_baseline(rng, exact):
    x_prev = exact.x_true + rng.normal(size=exact.x_true.shape)
    np.testing.assert_allclose(error_of(exact, x_prev, t=7 * exact.t), error_of(exact, x_prev))
    _, J = epipolar_jacobian(to_rays(K, exact.x_cur), to_rays(K, x_prev), FOCAL,
                                      exact.R, exact.t)
    np.testing.assert_allclose(J[:, 3:] @ exact.t, 0, atol=1e-6)


def test_derotated_points_at_infinity_do_not_move():
    R, _ = motion('turning')
    sky = views(R, np.zeros(3), planes=[])
    np.testing.assert_allclose(formulas.derotate(to_rays(K, sky.x_prev), R), to_rays(K, sky.x_cur),
                               atol=1e-12)
    np.testing.assert_allclose(
        formulas.parallax(to_rays(K, sky.x_cur), to_rays(K, sky.x_prev), FOCAL, R), 0, atol=1e-9)


def test_inverse_depth_is_the_true_one(exact):
    rho, _ = two_view.inverse_depth(to_rays(K, exact.x_cur), to_rays(K, exact.x_true), FOCAL,
                                    exact.R, exact.t)
    np.testing.assert_allclose(rho, exact.rho, atol=1e-9)


def test_inverse_depth_is_in_units_of_the_baseline(exact):
    rays = to_rays(K, exact.x_cur), to_rays(K, exact.x_true)
    rho, per_pixel = two_view.inverse_depth(*rays, FOCAL, exact.R, exact.t)
    metric, metric_per_pixel = two_view.inverse_depth(*rays, FOCAL, exact.R, 2.5 * exact.t)
    np.testing.assert_allclose(2.5 * metric, rho, atol=1e-9)
    np.testing.assert_allclose(2.5 * metric_per_pixel, per_pixel)


def test_a_point_that_moves_against_the_flow_has_a_negative_depth():
    scene = views(*motion('sideways'))
    still = to_rays(K, scene.x_cur)
    behind = 2 * still - formulas.derotate(to_rays(K, scene.x_true), scene.R)
    rho, _ = two_view.inverse_depth(still, behind @ scene.R, FOCAL, scene.R, scene.t)
    assert np.all(rho[scene.surface >= 0] < 0)


def test_depth_sensitivity_is_the_change_along_the_epipolar_line(exact):
    R = np.eye(3)  # sensitivity is per pixel of the picture after rotation is removed
    scene = views(R, exact.t)
    rays = to_rays(K, scene.x_cur)
    flow = scene.x_true - scene.x_cur
    usable = np.hypot(*flow.T) > 0.3
    along = flow / np.maximum(np.hypot(*flow.T), 1e-9)[:, None]

    def depth(step):
        return two_view.inverse_depth(rays, to_rays(K, scene.x_true + step * along), FOCAL, R,
                                      exact.t)[0]

    _, per_pixel = two_view.inverse_depth(rays, to_rays(K, scene.x_true), FOCAL, R, exact.t)
    numerical = np.abs(depth(1e-4) - depth(-1e-4)) / 2e-4
    np.testing.assert_allclose(per_pixel[usable], numerical[usable], rtol=1e-5)


def test_inverse_depth_jacobian_is_the_numerical_one(exact):
    rays_cur, rays_prev = to_rays(K, exact.x_cur), to_rays(K, exact.x_true)
    away = np.hypot(*(exact.x_true - exact.x_cur).T) > 3

    def depths(p):
        return two_view.inverse_depth(rays_cur, rays_prev, FOCAL, rotation.exp(p[:3]) @ exact.R,
                                      exact.t + p[3:])[0][away]

    rho, J = formulas.inverse_depth_jacobian(rays_cur, rays_prev, FOCAL, exact.R, exact.t)
    np.testing.assert_allclose(rho[away], depths(np.zeros(6)), atol=1e-13)
    expected = jacobian(depths, np.zeros(6))
    np.testing.assert_allclose(J[away], expected, rtol=1e-3, atol=1e-4 * np.abs(expected).max())


def test_parallax_is_what_translation_leaves(exact):
    rays = to_rays(K, exact.x_cur)
    untranslated = rays - exact.rho[:, None] * exact.t
    expected = (rays[:, :2] - untranslated[:, :2] / untranslated[:, 2:]) * FOCAL
    found = formulas.parallax(rays, to_rays(K, exact.x_true), FOCAL, exact.R)
    np.testing.assert_allclose(found, expected, atol=1e-9)


def test_at_the_epipole_and_without_translation_numbers_stay_finite():
    at_epipole = np.array([[K[0, 2], K[1, 2]]])
    for x, t in ((at_epipole, np.array([0, 0, -1.0])), (GRID, np.zeros(3))):
        rays = to_rays(K, x)
        for result in (epipolar_jacobian(rays, rays, FOCAL, np.eye(3), t),
                       two_view.inverse_depth(rays, rays, FOCAL, np.eye(3), t)):
            assert all(np.all(np.isfinite(part)) for part in result)
