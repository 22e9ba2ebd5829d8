"""Joint re-estimation of drawn canyons: exact, with noise, and its covariance."""

from canyon import angle_between, CANYON, motion, MOTIONS, turn_between, views
import formulas
from mv_slapse.geometry import rotation
from mv_slapse.surfaces import joint
import numpy as np
import pytest


@pytest.fixture(params=MOTIONS)
def true_motion(request):
    return motion(request.param)


def start(scene, rng, size=0.002):
    t = scene.t + rng.normal(0, size, 3)
    return (rotation.exp(rng.normal(0, size, 3)) @ scene.R, t / np.linalg.norm(t),
            CANYON * (1 + rng.normal(0, 10 * size, (4, 1))))


def test_motion_and_planes_are_exact_without_noise(rng, true_motion):
    scene = views(*true_motion, sigma=0.3)
    R, t, planes, _ = joint.reestimate(scene.pair, start(scene, rng), scene.surface, 0.0,
                                       steps=30)
    assert turn_between(R, scene.R) < 1e-6
    assert angle_between(t, scene.t) < 1e-5
    assert np.linalg.norm(t) == pytest.approx(1)
    np.testing.assert_allclose(planes, CANYON, atol=1e-5)


def test_noise_and_outliers_stay_within_a_bound(rng, true_motion):
    scene = views(*true_motion, rng, sigma=0.3, outliers=0.3)
    R, t, planes, P = joint.reestimate(scene.pair, start(scene, rng), scene.surface, 0.02,
                                       steps=10)
    assert np.degrees(turn_between(R, scene.R)) < 0.05
    assert np.degrees(angle_between(t, scene.t)) < 0.2
    error = np.linalg.norm(planes - CANYON, axis=1) / np.linalg.norm(CANYON, axis=1)
    assert error[:3].max() < 0.03
    # Thirty baselines away there is a pixel of parallax.
    far = planes[3] - CANYON[3]
    assert far @ np.linalg.solve(P[15:, 15:], far) < 30


def test_the_cost_never_grows(rng):
    scene = views(*motion('ahead'), rng, sigma=0.5, outliers=0.3)
    R, t, planes = start(scene, rng, 0.01)

    def cost(*values):
        return formulas.normal_equations(scene.pair, *values, scene.surface, 0.0, 3.0)[2]

    costs = [cost(R, t, planes)]
    for _ in range(6):
        R, t, planes, _ = joint.reestimate(scene.pair, (R, t, planes), scene.surface, 0.0, steps=1)
        costs.append(cost(R, t, planes))
    assert np.all(np.diff(costs) <= 0)
    assert costs[-1] < 0.8 * costs[0]


def test_errors_have_the_size_that_the_covariance_says():
    distances = []
    for seed in range(30):
        scene = views(*motion('ahead'), np.random.default_rng(seed), sigma=0.3)
        R, t, planes, P = joint.reestimate(scene.pair, (scene.R, scene.t, CANYON),
                                 scene.surface, 0.0)
        lift = np.zeros((18, 17))
        lift[:3, :3], lift[3:6, 3:5] = np.eye(3), formulas.tangent_basis(t)
        lift[6:, 5:] = np.eye(12)
        error = np.r_[rotation.log(scene.R @ R.T), scene.t - t, (CANYON - planes).ravel()]
        distances.append(error @ lift @ np.linalg.solve(lift.T @ P @ lift, lift.T @ error))
        np.testing.assert_allclose(P[:, 3:6] @ t, 0, atol=1e-9)
    # Mean of 30 chi-squares with 17 degrees of freedom: 17 +- 1.1. The kernel costs a little.
    assert 12 < np.mean(distances) < 21


def test_without_planes_it_is_the_epipolar_refinement(rng):
    scene = views(*motion('ahead'), rng, sigma=0.3)
    R, t, planes, P = joint.reestimate(scene.pair, (scene.R, scene.t, []),
                                 np.full(len(scene.pair), -1), 0.0)
    assert planes.shape == (0, 3)
    assert P.shape == (6, 6)
    assert np.degrees(turn_between(R, scene.R)) < 0.03
    assert np.degrees(angle_between(t, scene.t)) < 0.3


def test_planes_sharpen_the_motion(rng):
    errors = []
    scene = views(*motion('ahead'), rng, sigma=0.5)
    for planes, index in ((CANYON, scene.surface), ([], np.full(len(scene.pair), -1))):
        P = joint.reestimate(scene.pair, (scene.R, scene.t, planes), index, 0.0)[3]
        errors.append(np.trace(P[:6, :6]))
    assert errors[0] < errors[1]


def test_what_is_known_beforehand_of_a_plane_holds_where_its_blocks_say_little(rng):
    scene = views(*motion('ahead'), rng, sigma=0.3)
    few = np.flatnonzero(scene.surface == 0)[:3]
    index = np.where(scene.surface == 0, -1, scene.surface)
    index[few] = 0
    information = np.eye(3) * 1e8
    mean = CANYON[0] * 1.02
    planes = joint.reestimate(scene.pair, (scene.R, scene.t, CANYON), index, 0.02,
                                 expected=[(0, mean, information)])[2]
    np.testing.assert_allclose(planes[0], mean, rtol=1e-2, atol=1e-3)
    free, P = joint.reestimate(scene.pair, (scene.R, scene.t, CANYON), index, 0.02)[2:]
    known = joint.reestimate(scene.pair, (scene.R, scene.t, CANYON), index, 0.02,
                                 expected=[(0, mean, np.zeros((3, 3)))])[2]
    np.testing.assert_allclose(known, free)
    assert np.linalg.norm(free[0] - mean) > np.linalg.norm(planes[0] - mean)
