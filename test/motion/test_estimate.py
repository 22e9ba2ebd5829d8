"""Camera motion of drawn canyons: exact, with noise, with outliers, on one plane."""

from dataclasses import replace

from canyon import angle_between, CANYON, motion, MOTIONS, turn_between, views
import formulas
from mv_slapse.geometry import rotation
from mv_slapse.motion import estimate
import numpy as np
import pytest

THRESHOLD = 0.7 / 500


@pytest.fixture(params=MOTIONS)
def true_motion(request):
    return motion(request.param)


def disturbed(R, t, rng, size=0.01):
    t = t + rng.normal(0, size, 3)
    return rotation.exp(rng.normal(0, 0.2 * size, 3)) @ R, t / np.linalg.norm(t)


def refined(scene, R, t):
    return estimate.refined_from(scene.pair, R, t)


def five_points(scene):
    pair = scene.pair
    return estimate.from_essential_matrix(pair.rays_cur, pair.rays_prev, THRESHOLD)


def test_five_points_give_the_motion_up_to_its_direction(true_motion):
    scene = views(*true_motion)
    (R, t), (R_too, opposite) = five_points(scene)
    assert turn_between(R, scene.R) < 1e-4
    assert min(angle_between(t, scene.t), angle_between(-t, scene.t)) < 1e-3
    np.testing.assert_array_equal(R, R_too)
    np.testing.assert_array_equal(t, -opposite)


def test_no_essential_matrix_is_no_motion(monkeypatch):
    rays = views(*motion('ahead')).pair.rays_cur
    for answer in (None, np.full((3, 3), np.nan), np.zeros((0, 0))):
        monkeypatch.setattr(estimate.cv2, 'findEssentialMat',
                            lambda *args, E=answer, **settings: (E, None))
        assert estimate.from_essential_matrix(rays, rays, THRESHOLD) == []


def test_refined_motion_is_exact_without_noise(rng, true_motion):
    scene = views(*true_motion)
    # Blocks without parallax would hold a poor start's direction no better than they do noise.
    fit = refined(scene, *disturbed(*true_motion, rng, 0.001))
    assert turn_between(fit.R_cur_from_prev, scene.R) < 1e-9
    assert angle_between(fit.t_cur_from_prev, scene.t) < 1e-8
    assert np.linalg.norm(fit.t_cur_from_prev) == pytest.approx(1)
    assert fit.cost < 1e-9


def test_noise_and_outliers_cost_hundredths_of_a_degree(rng, true_motion):
    scene = views(*true_motion, rng, sigma=0.3, outliers=0.4)
    starts = five_points(scene)
    t = max((t for _, t in starts), key=lambda t: t @ scene.t)
    fit = refined(scene, starts[0][0], t)
    assert np.degrees(turn_between(fit.R_cur_from_prev, scene.R)) < 0.04
    assert np.degrees(angle_between(fit.t_cur_from_prev, scene.t)) < 0.5


def test_one_plane_is_enough_from_a_start(rng):
    scene = views(*motion('ahead'), rng, sigma=0.3, planes=CANYON[:1])
    fit = refined(scene, *disturbed(scene.R, scene.t, rng))
    assert np.degrees(turn_between(fit.R_cur_from_prev, scene.R)) < 0.1
    assert np.degrees(angle_between(fit.t_cur_from_prev, scene.t)) < 1.0


def test_errors_have_the_size_that_the_covariance_says(true_motion):
    distances = []
    for seed in range(30):
        rng = np.random.default_rng(seed)
        scene = views(*true_motion, rng, sigma=0.3)
        fit = refined(scene, *true_motion)
        basis = formulas.tangent_basis(fit.t_cur_from_prev)
        error = np.r_[rotation.log(scene.R @ fit.R_cur_from_prev.T),
                      basis.T @ (scene.t - fit.t_cur_from_prev)]
        lift = np.zeros((6, 5))
        lift[:3, :3], lift[3:, 3:] = np.eye(3), basis
        distances.append(error @ np.linalg.solve(lift.T @ fit.covariance @ lift, error))
        np.testing.assert_allclose(fit.covariance[3:, 3:] @ fit.t_cur_from_prev, 0, atol=1e-12)
    # Mean of 30 chi-squares with 5 degrees of freedom: 5 +- 0.58. The kernel costs a little.
    assert 3.0 < np.mean(distances) < 8.0


def test_a_poor_start_reaches_the_motion_that_a_good_one_does(rng):
    """Half of the vectors are wrong, and the direction starts 4 degrees off."""
    R, t = motion('sideways')
    scene = views(R, t, rng, sigma=0.3)
    rays = scene.pair.rays_prev.copy()
    wrong = rng.uniform(size=len(rays)) < 0.5
    rays[wrong, :2] += rng.uniform(-0.02, 0.02, (wrong.sum(), 2))
    poor = rotation.exp(np.array([0.0, 0.05, 0.05])) @ t
    pair = replace(scene.pair, rays_prev=rays)
    good, found = (estimate.refined_from(pair, R, start) for start in (t, poor))
    assert found.cost == pytest.approx(good.cost, abs=1 / len(rays))
    assert angle_between(found.t_cur_from_prev, good.t_cur_from_prev) < 0.01


def test_a_standing_camera_gives_finite_numbers(rng):
    scene = views(np.eye(3), np.zeros(3), rng, sigma=0.1)
    fit = refined(scene, np.eye(3), np.array([0, 0, -1.0]))
    assert np.all(np.isfinite(fit.covariance))
    assert np.degrees(turn_between(fit.R_cur_from_prev, np.eye(3))) < 0.05


def test_a_turn_is_found_with_its_error_and_without_the_wrong_vectors(rng):
    """Against vectors that a turn on the spot makes, noise, and a fifth that are wrong."""
    R = rotation.exp(np.array([0.01, 0.06, -0.02]))
    far = views(R, motion('ahead')[1], planes=CANYON * 0, rng=rng, sigma=0.3).pair
    wrong = rng.uniform(size=len(far)) < 0.2
    rays = far.rays_prev.copy()
    rays[wrong, :2] += rng.uniform(-0.03, 0.03, (wrong.sum(), 2))
    found, covariance, off = estimate.turn(replace(far, rays_prev=rays), np.eye(3))
    error = rotation.log(found @ R.T)
    assert error @ np.linalg.solve(covariance[:3, :3], error) < 25
    assert np.degrees(np.linalg.norm(error)) < 0.02
    assert np.mean(off[~wrong] < 3) > 0.95
    assert np.mean(off[wrong] < 3) < 0.3
    assert not covariance[3:].any()
