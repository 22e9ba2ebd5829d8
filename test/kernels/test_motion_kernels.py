"""Kernels of a pair's motion, observations and refinement against their formulas."""

from dataclasses import replace

from canyon import CANYON, motion, MOTIONS, views
import formulas
from kernels import motion_reference as reference
from kernels import two_view_reference
from mv_slapse.geometry import rotation, two_view
from mv_slapse.motion import estimate, observations
from mv_slapse.motion.estimate import MotionFit
from mv_slapse.surfaces import joint
import numpy as np
import pytest


@pytest.fixture(params=MOTIONS)
def scene(rng, request):
    return views(*motion(request.param), rng, sigma=0.3, outliers=0.2)


@pytest.fixture
def start(scene, rng):
    t = scene.t + rng.normal(0, 0.01, 3)
    return rotation.exp(rng.normal(0, 0.002, 3)) @ scene.R, t / np.linalg.norm(t)


def arguments(scene):
    pair = scene.pair
    return pair.rays_cur, pair.rays_prev, pair.sigma, pair.focal


def test_robust_weight_and_cost_by_hand():
    error, sigma = np.array([0.0, 1.0, -2.0]), np.array([1.0, 1.0, 2.0])
    np.testing.assert_allclose(reference.robust_weight(error, sigma), [1, 0.25, 0.25])
    assert reference.robust_cost(error, sigma) == pytest.approx(1 / 3)


def test_the_refined_motion(scene, start):
    found = estimate.refined_from(scene.pair, *start)
    expected = reference.refine(*arguments(scene), *start)
    np.testing.assert_allclose(found.R_cur_from_prev, expected.R_cur_from_prev, atol=1e-9)
    np.testing.assert_allclose(found.t_cur_from_prev, expected.t_cur_from_prev, atol=1e-9)
    np.testing.assert_allclose(found.covariance, expected.covariance,
                               atol=1e-7 * np.abs(expected.covariance).max())
    assert found.cost == pytest.approx(expected.cost, abs=1e-10)


def test_a_turn(scene, start):
    for found, expected in zip(estimate.turn(scene.pair, start[0]),
                               reference.turn(*arguments(scene), start[0]), strict=True):
        np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize('before', [0.5, 1.0, 3.0])
def test_the_scale_of_the_noise(scene, start, before):
    fit = MotionFit(*start, np.zeros((6, 6)), 0.0)
    for pair in (scene.pair, scene.pair[:25], scene.pair[:5]):
        assert estimate.calibrated(pair, fit, before) == pytest.approx(
            reference.calibrated(pair, fit, before), rel=1e-9)


def test_the_columns_of_block_observations(scene, start):
    fit = MotionFit(*start, np.zeros((6, 6)), 0.0)
    found = observations.observe(scene.pair, fit, 3.0, 1.0, 0.05)
    for name, column in zip(list(vars(found))[1:],
                            reference.observed(scene.pair, fit, 3.0, 1.0, 0.05), strict=True):
        np.testing.assert_allclose(getattr(found, name), column, rtol=1e-8, atol=1e-9,
                                   err_msg=name)
    assert formulas.behind(scene.pair, *start) == pytest.approx(
        reference.behind(scene.pair, *start), abs=1e-9)


def test_errors_and_depths_of_rays_of_any_length(scene, start, rng):
    cur, prev, _, focal = arguments(scene)
    prev = prev * rng.uniform(0.5, 2, len(prev))[:, None]
    np.testing.assert_allclose(formulas.epipolar_error(cur, prev, focal, *start),
                               reference.epipolar_error(cur, prev, focal, *start), atol=1e-9)
    for found, expected in zip(two_view.inverse_depth(cur, prev, focal, *start),
                               reference.inverse_depth(cur, prev, focal, *start), strict=True):
        np.testing.assert_allclose(found, expected, rtol=1e-8, atol=1e-9)


@pytest.mark.parametrize('more', [{}, {'bias': 0.04, 'dependence': (5.0, 7.0), 'offset': 0.2}])
def test_normal_equations(scene, start, more):
    given = scene.pair, *start, CANYON, scene.surface, 0.03, 3.0
    found = formulas.normal_equations(*given, **more)
    expected = two_view_reference.normal_equations(*given, **more)
    for mine, numpys in zip(found, expected, strict=True):
        np.testing.assert_allclose(mine, numpys, rtol=1e-9, atol=1e-10 * np.abs(numpys).max())


@pytest.mark.parametrize('known', [[], [(1, CANYON[1] * 1.01, 1e5 * np.eye(3))]])
def test_joint_refinement(scene, start, known):
    index = np.where(scene.outlier, joint.LEFT_OUT, scene.surface)
    found = joint.reestimate(scene.pair, (*start, 1.01 * CANYON), index, 0.03, expected=known)
    kept = ~scene.outlier
    expected = two_view_reference.reestimate(scene.pair[kept], *start, 1.01 * CANYON, index[kept],
                                             0.03, expected=known)
    for mine, numpys in zip(found, expected, strict=True):
        np.testing.assert_allclose(mine, numpys, rtol=1e-6, atol=1e-6 * np.abs(numpys).max())


def test_results_are_the_same_from_call_to_call(scene, start):
    first, second = (joint.reestimate(scene.pair, (*start, CANYON), scene.surface, 0.03)
                     for _ in range(2))
    for one, other in zip(first, second, strict=True):
        np.testing.assert_array_equal(one, other)


def test_wrong_arguments_are_refused(scene, start):
    pair = scene.pair
    with pytest.raises(ValueError, match='refine_motion: rays must end with 1'):
        estimate.refined_from(replace(pair, rays_prev=2 * pair.rays_prev), *start)
    with pytest.raises(ValueError, match='index names a plane that is not given'):
        formulas.normal_equations(pair, *start, [], scene.surface, 0.03, 3.0)
    with pytest.raises(ValueError, match='sigma has shape'):
        estimate.refined_from(replace(pair, sigma=pair.sigma[1:]), *start)
