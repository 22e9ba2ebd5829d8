"""State of an obstacle relative to the camera: definitions and Jacobians."""

from mv_slapse.geometry import plane as planes
from mv_slapse.kernels.binding import compiled
from mv_slapse.obstacles import motion_model as om
from numeric import jacobian
import numpy as np
import obstacles_reference as reference
import pytest
from scipy.optimize import minimize
from scipy.spatial.transform import Rotation

DT = 0.1


def random_state(rng):
    return np.r_[rng.normal(0, 0.2, 2), rng.normal(2.5, 0.3), rng.normal(0, 0.3, 3),
                 rng.normal(0, 0.3, 2)]


def random_step(rng):
    R = Rotation.from_euler('YXZ', rng.normal(0, 0.05, 3)).as_matrix()
    return om.CameraStep(R, rng.normal(0, 0.5, 3), DT, rng.normal(0, 5, 3), np.diag([1, 2, 3.0]))


def random_covariance(rng, n=om.SIZE, scale=0.1):
    A = scale * rng.normal(size=(n, n))
    return A @ A.T + 1e-3 * np.eye(n)


def test_from_cartesian_undoes_to_cartesian_at_any_scale_of_w(rng):
    mu = random_state(rng)
    cartesian, _ = om.to_cartesian(mu)
    np.testing.assert_allclose(compiled.obstacle_from_cartesian(cartesian)[0], mu)
    cartesian[6:] *= 7
    np.testing.assert_allclose(compiled.obstacle_from_cartesian(cartesian)[0], mu)


def test_a_surface_may_turn_by_so_much_in_a_time(rng):
    still = om.CameraStep(np.eye(3), np.zeros(3), DT, np.zeros(3), np.zeros((3, 3)))
    mu = np.r_[random_state(rng)[:3], np.zeros(5)]
    _, _, Q = om.predict(mu, still, np.zeros(3), np.zeros((3, 3)), 0.0)
    expected = np.zeros((om.SIZE, om.SIZE))
    expected[om.SLOPE, om.SLOPE] = np.eye(2) * om.SLOPE_NOISE**2 * DT
    np.testing.assert_allclose(Q, expected, atol=1e-12)


def test_plane_holds_the_centre(rng):
    mu = random_state(rng)
    assert om.plane(mu) @ om.to_cartesian(mu)[0][:3] == pytest.approx(-1)


def test_prediction_moves_position_and_plane_at_constant_velocity(rng):
    mu, step, after = random_state(rng), random_step(rng), rng.normal(0, 5, 3)
    moved, _, _ = om.predict(mu, step, after, np.zeros((3, 3)), 0.0)
    R, t = step.R_cur_from_prev, step.t_cur_from_prev
    before, now = om.to_cartesian(mu)[0], om.to_cartesian(moved)[0]
    velocity = before[3:6] - step.before
    np.testing.assert_allclose(now[:3], R @ (before[:3] + DT * velocity) + t)
    np.testing.assert_allclose(now[3:6], R @ velocity + after)
    # (15) of [MVO] for the plane, then the change of frame.
    expected = planes.transform(planes.transform(om.plane(mu), np.eye(3), DT * velocity), R, t)
    np.testing.assert_allclose(om.plane(moved), expected)


def test_jacobians_are_the_numerical_ones(rng):
    mu, step, after = random_state(rng), random_step(rng), rng.normal(0, 5, 3)
    _, F, _ = om.predict(mu, step, after, np.zeros((3, 3)), 0.0)
    np.testing.assert_allclose(
        F, jacobian(lambda m: om.predict(m, step, after, np.zeros((3, 3)), 0.0)[0], mu),
        rtol=1e-5, atol=1e-5)
    cartesian, to = om.to_cartesian(mu)
    np.testing.assert_allclose(to, jacobian(lambda m: om.to_cartesian(m)[0], mu), atol=1e-6,
                               rtol=1e-5)
    np.testing.assert_allclose(
        compiled.obstacle_from_cartesian(cartesian)[1],
        jacobian(lambda c: compiled.obstacle_from_cartesian(c)[0], cartesian), atol=1e-6)


def test_noise_of_prediction_is_that_of_sampled_camera_speeds(rng):
    mu, step = random_state(rng), random_step(rng)
    after, after_covariance = rng.normal(0, 5, 3), np.diag([0.2, 0.1, 0.3])
    small = 1e-3
    step = step._replace(before_covariance=small * step.before_covariance)
    mean, _, Q = om.predict(mu, step, after, small * after_covariance, 0.0)
    samples = []
    for _ in range(4000):
        wrong = step._replace(before=rng.multivariate_normal(step.before,
                                                             step.before_covariance))
        also = rng.multivariate_normal(after, small * after_covariance)
        samples.append(om.predict(mu, wrong, also, np.zeros((3, 3)), 0.0)[0] - mean)
    Q[om.SLOPE, om.SLOPE] -= om.SLOPE_NOISE**2 * DT * np.eye(2)
    np.testing.assert_allclose(np.cov(np.transpose(samples))[:6, :6], Q[:6, :6],
                               atol=0.1 * np.abs(Q[:6, :6]).max())


def test_the_slope_of_a_surface_walks_at_random(rng):
    """Its variance grows with the time, not with the square of it."""
    mu, zero = random_state(rng), np.zeros((3, 3))
    step = om.CameraStep(np.eye(3), np.zeros(3), 0.1, np.zeros(3), zero)
    noise = [om.predict(mu, step._replace(dt=dt), np.zeros(3), zero, 0.0)[2][om.SLOPE, om.SLOPE]
             for dt in (0.1, 0.2)]
    np.testing.assert_allclose(noise[0], om.SLOPE_NOISE**2 * 0.1 * np.eye(2), atol=1e-9)
    np.testing.assert_allclose(noise[1], 2 * noise[0], atol=1e-9)


def test_acceleration_adds_the_same_in_two_steps_as_in_one():
    one = reference._motion_noise(0.2, 2.0, np.zeros((3, 3)), np.zeros((3, 3)))
    half = reference._motion_noise(0.1, 2.0, np.zeros((3, 3)), np.zeros((3, 3)))
    F = np.eye(6)
    F[:3, 3:] = 0.1 * np.eye(3)
    np.testing.assert_allclose(F @ half @ F.T + half, one)


def test_an_obstacle_that_passes_the_camera_is_out_of_sight(rng):
    mu = np.r_[0, 0, 0.0, 0, 0, -12, 0, 0]
    step = om.CameraStep(np.eye(3), np.zeros(3), DT, np.zeros(3), np.zeros((3, 3)))
    assert om.predict(mu, step, np.zeros(3), np.zeros((3, 3)), 1.0) is None


def test_motion_has_the_covariance_of_its_samples(rng):
    mu, P = random_state(rng), random_covariance(rng, scale=0.005) * 1e-2
    scene, scene_covariance = rng.normal(0, 5, 3), np.diag([1e-4, 2e-4, 3e-4])
    found = om.motion(mu, P, scene, scene_covariance)
    samples = [np.r_[om.to_cartesian(m)[0][:3], om.to_cartesian(m)[0][3:6] - s] for m, s in zip(
        rng.multivariate_normal(mu, P, 4000), rng.multivariate_normal(scene, scene_covariance,
                                                                      4000), strict=True)]
    np.testing.assert_allclose(np.cov(np.transpose(samples)), found.covariance,
                               atol=0.1 * found.covariance.max())


def test_a_still_surface_at_any_depth_has_no_moving_statistic(rng):
    scene, P = np.array([0.5, 0, -10.0]), random_covariance(rng, scale=0.01)
    for depth in (5.0, 20.0, 60.0):
        mu = np.r_[0.1, 0, np.log(depth), scene / depth, 0, 0]
        assert om.moving_statistic(mu, P, scene, np.eye(3)) == pytest.approx(0, abs=1e-9)


def test_moving_statistic_is_the_smallest_distance_over_all_depths(rng):
    scene, S = np.array([0.5, 0, -10.0]), 0.1 * np.eye(3)
    mu, P = random_state(rng), random_covariance(rng, scale=0.1)
    ahead = scene / np.linalg.norm(scene)
    variance = P[2, 2] + 0.1 / (scene @ scene)  # of the depth, and of the speed as a factor

    def distance(log_depth):
        offset = log_depth - mu[2]
        gain = P[om.RATE, 2] / variance
        error = mu[om.RATE] + gain * offset - scene / np.exp(log_depth)
        C = P[om.RATE, om.RATE] - np.outer(gain, P[om.RATE, 2]) + (
            S - 0.1 * np.outer(ahead, ahead)) / np.exp(2 * log_depth)
        return error @ np.linalg.solve(C, error) + offset**2 / variance
    starts = mu[2] + np.linspace(-3, 3, 13) * np.sqrt(variance)
    expected = min(minimize(lambda x: distance(x[0]), [s], method='Nelder-Mead').fun
                   for s in starts)
    assert om.moving_statistic(mu, P, scene, S) == pytest.approx(expected, rel=0.05, abs=0.05)


def test_a_speed_that_is_unsure_is_still_not_zero():
    scene, P = np.array([0.0, 0, -10.0]), np.diag([1e-4] * 2 + [0.01] + [1e-3] * 3 + [0.1] * 2)
    with_us = np.r_[0, 0, np.log(20), 0, 0, 0, 0, 0]
    faster = np.r_[0, 0, np.log(20), scene / 20 * 1.3, 0, 0]
    unsure = np.diag([0.0, 0, 3.0])**2
    assert om.moving_statistic(with_us, P, scene, unsure) > 30
    assert om.moving_statistic(faster, P, scene, unsure) < 2


def test_what_may_be_nearer_than_it_seems_explains_closing_but_not_receding():
    scene, P = np.array([0.0, 0, -10.0]), np.diag([1e-4] * 2 + [4e-4] + [1e-4] * 3 + [0.1] * 2)
    near, far = (np.r_[0, 0, np.log(10), scene / depth, 0, 0] for depth in (8.0, 12.5))
    both = [om.moving_statistic(mu, P, scene, np.zeros((3, 3))) for mu in (near, far)]
    assert min(both) > 50
    one_sided = [om.moving_statistic(mu, P, scene, np.zeros((3, 3)), 0.12) for mu in (near, far)]
    assert one_sided[0] < 5
    assert one_sided[1] == both[1]


def test_motion_that_no_depth_explains_counts_however_wide_the_depth_is():
    scene = np.array([0, 0, -10.0])
    P = np.diag([1e-4, 1e-4, 1.0, 1e-3, 1e-3, 1e-3, 0.1, 0.1])
    away = np.r_[0, 0, np.log(20), 0, 0, 0.3, 0, 0]
    slow = np.r_[0, 0, np.log(20), 0, 0, -0.2, 0, 0]
    assert om.moving_statistic(away, P, scene, np.zeros((3, 3))) > 16
    assert om.moving_statistic(slow, P, scene, np.zeros((3, 3))) < 2
