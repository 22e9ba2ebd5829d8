"""Definition 1 on drawn canyons: direction, infinity, depth and its error."""

from canyon import CANYON, K, motion, MOTIONS, views
import formulas
from mv_slapse.geometry.camera import to_rays
from mv_slapse.geometry.rotation import exp
from mv_slapse.geometry.two_view import Pair
from mv_slapse.motion import estimate
from mv_slapse.motion import observations as block_observations
from mv_slapse.motion.estimate import MotionFit
import numpy as np
import pytest


@pytest.fixture(params=MOTIONS)
def true_motion(request):
    return motion(request.param)


def judged(scene, pair=None, relief=0.0):
    fit = MotionFit(scene.R, scene.t, np.zeros((6, 6)), 0.0)
    return block_observations.observe(pair or scene.pair, fit, 3.0, 1.0, relief)


def may_turn(seen):
    return block_observations.may_turn(seen.parallax[seen.epipolar_inlier], 1.0)


def test_most_blocks_say_which_way_the_camera_moves(rng, true_motion):
    R, t = true_motion
    scene = views(R, t, rng, sigma=0.3, outliers=0.3)
    for start in (t, -t):
        assert estimate.refined_from(scene.pair, R, start).t_cur_from_prev @ t > 0.99


def test_every_right_block_with_parallax_is_before_the_camera(true_motion):
    scene = views(*true_motion)
    near = scene.surface >= 0
    pair = scene.pair[near & (np.hypot(*(scene.x_true - scene.x_cur).T) > 1e-6)]
    assert formulas.behind(pair, scene.R, scene.t) == 0
    assert formulas.behind(pair, scene.R, -scene.t) == 1


def test_exact_stationary_blocks_keep_all_constraints(true_motion):
    scene = views(*true_motion)
    evidence = judged(scene)
    np.testing.assert_allclose(evidence.epipolar_error, 0, atol=1e-6)
    assert evidence.epipolar_inlier.all()
    assert not evidence.backward.any()
    np.testing.assert_allclose(evidence.rho, scene.rho, atol=1e-9)


def test_blocks_without_parallax_are_at_infinity(true_motion):
    scene = views(*true_motion)
    evidence = judged(scene)
    assert evidence.at_infinity[scene.surface < 0].all()
    np.testing.assert_array_equal(evidence.at_infinity, evidence.parallax < 1)
    near = (scene.surface >= 0) & (evidence.rho > 0.2)
    assert evidence.at_infinity[near].mean() < 0.05


def test_noise_leaves_997_permille_inside_three_sigma(rng, true_motion):
    evidence = judged(views(*true_motion, rng, sigma=0.3))
    assert 0.99 < evidence.epipolar_inlier.mean() <= 1
    assert 0.9 < np.std(evidence.epipolar_error) < 1.1


def test_depths_scatter_as_their_sigma_says(rng, true_motion):
    scene = views(*true_motion, rng, sigma=0.3)
    evidence = judged(scene)
    use = (scene.surface >= 0) & (evidence.parallax > 3)
    error = (evidence.rho - scene.rho)[use] / evidence.sigma_rho[use]
    assert 0.9 < np.sqrt(np.mean(error**2)) < 1.12


def test_relief_adds_its_share_of_the_depth(true_motion):
    scene = views(*true_motion)
    flat, rough = judged(scene), judged(scene, relief=0.05)
    np.testing.assert_allclose(rough.sigma_rho,
                               np.sqrt(flat.sigma_rho**2 + (0.05 * flat.rho)**2))


def test_an_object_that_overtakes_moves_against_the_flow():
    scene = views(*motion('ahead'))
    mover = (scene.surface == 3)
    # A car ahead that draws away at twice the camera's speed: its depth grows by a baseline.
    X = scene.points[mover] - 2 * np.array([0, 0, 1.0])
    x_prev = scene.x_true.copy()
    projected = (X - scene.t) @ scene.R @ K.T
    x_prev[mover] = projected[:, :2] / projected[:, 2:]
    pair = Pair(scene.pair.rays_cur, to_rays(K, x_prev), x_prev, np.full(len(x_prev), 0.05), K)
    evidence = judged(scene, pair)
    seen = mover & (evidence.parallax >= 1)
    assert seen.any()
    assert evidence.backward[seen].all()
    assert not evidence.backward[~mover].any()


def test_an_object_that_crosses_leaves_its_epipolar_lines():
    scene = views(*motion('ahead'))
    mover = (scene.surface == 3) & (np.abs(scene.x_cur[:, 1] - K[1, 2]) < 60)
    x_prev = scene.x_true + mover[:, None] * [0.0, 6.0]
    pair = Pair(scene.pair.rays_cur, to_rays(K, x_prev), x_prev, np.full(len(x_prev), 0.3), K)
    evidence = judged(scene, pair)
    assert evidence.epipolar_inlier[~mover].all()
    assert evidence.epipolar_inlier[mover].mean() < 0.2


def off_a_turn(scene):
    return estimate.turn(scene.pair, scene.R)[2] * scene.pair.sigma


def turns_only(scene, seen=None):
    return block_observations.turns_only(off_a_turn(scene), (seen or judged(scene)).rho, 1.0)


def test_a_turn_shows_no_parallax_and_a_motion_does(rng, true_motion):
    R, t = true_motion
    moves = views(R, t, rng, 0.3, outliers=0.1)
    turns = views(R, t, rng, 0.3, planes=1e-6 * CANYON, outliers=0.1)
    assert not may_turn(judged(moves))
    assert may_turn(judged(turns))
    assert turns_only(turns)


@pytest.mark.parametrize('true_motion', ['ahead'], indirect=True)
def test_a_slow_motion_that_passes_for_a_turn_is_told_by_what_a_turn_leaves(rng, true_motion):
    """Parallax like that of a turn whose rotation was misjudged, but not everywhere alike."""
    R, t = true_motion
    creeps = views(R, t, rng, 0.3, planes=0.1 * CANYON)
    assert may_turn(judged(creeps))
    assert not turns_only(creeps)
    misjudged = views(R, t, rng, 0.3, planes=1e-6 * CANYON)
    wrong = MotionFit(exp([0, 2.0 / K[0, 0], 0]) @ R, np.array([1.0, 0, 0]), np.zeros((6, 6)), 0.0)
    evidence = block_observations.observe(misjudged.pair, wrong, 3.0, 1.0, 0.0)
    assert 1.5 < np.median(evidence.parallax) < 3
    assert may_turn(evidence)
    assert turns_only(misjudged, evidence)


@pytest.mark.parametrize('true_motion', ['ahead'], indirect=True)
def test_vectors_that_are_wrong_make_no_motion_of_a_turn(rng, true_motion):
    R, t = true_motion
    turns = views(R, t, rng, 1.5, planes=1e-6 * CANYON)
    assert np.mean(off_a_turn(turns) > 2) > 2 * block_observations.TURNING_SHARE
    assert turns_only(turns)
    assert not turns_only(views(R, t, rng, 1.5, planes=0.1 * CANYON))


def test_a_mask_selects_all_columns():
    scene = views(*motion('ahead'))
    depths = block_observations.Depths(scene.pair.rays_cur, scene.rho,
                                       np.full(len(scene.rho), 0.004), scene.x_cur)
    part = depths[depths.x[:, 0] < 100]
    assert len(part) == len(part.x) == np.sum(depths.x[:, 0] < 100)
    assert part.x[:, 0].max() < 100
    np.testing.assert_array_equal(part.rays[:, 0], depths.rays[depths.x[:, 0] < 100, 0])
