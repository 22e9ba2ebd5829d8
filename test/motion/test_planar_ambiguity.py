"""A plane allows two motions; the one that leaves it before the camera is taken."""

from dataclasses import replace

import formulas
from mv_slapse.geometry import two_view
from mv_slapse.geometry.camera import to_pixels, to_rays
from mv_slapse.geometry.rotation import angle, exp
from mv_slapse.motion import planar_ambiguity
from mv_slapse.motion.estimate import refined_from
import numpy as np
import pytest

K = np.array([[450.0, 0, 320], [0, 450, 240], [0, 0, 1]])
GRID = np.stack(np.meshgrid(np.arange(8, 640, 16), np.arange(8, 480, 16)), -1).reshape(-1, 2)
PLANE = np.array([0.1, 0.05, -1.0]) / 2.0
R = exp(np.array([0.01, -0.02, 0.03]))
T = np.array([0.9, 0.3, 0.1]) / np.linalg.norm([0.9, 0.3, 0.1])


def floor(rng, noise=0.1, baseline=0.1):
    """Return the pair of a camera that looks down on a floor and flies along it."""
    rays = to_rays(K, GRID.astype(float))
    X = rays / -(rays @ PLANE)[:, None]
    x_prev = to_pixels(K, (X - baseline * T) @ R) + noise * rng.normal(size=GRID.shape)
    return two_view.Pair(rays, to_rays(K, x_prev), x_prev, np.full(len(GRID), 0.1), K)


def fits(pair):
    """Return the motions of the floor, the right one first."""
    motions = [refined_from(pair, *motion)
               for motion in planar_ambiguity.from_homography(pair)]
    return sorted(motions, key=lambda fit: angle(fit.R_cur_from_prev @ R.T))


def test_both_motions_of_a_plane_fit_its_epipolar_lines(rng):
    pair = floor(rng)
    right, *_, wrong = fits(pair)
    assert wrong.cost == pytest.approx(right.cost, abs=0.02)
    assert wrong.t_cur_from_prev @ T < 0.9
    for fit, least, most in ((right, 0.0, 0.02), (wrong, planar_ambiguity.MANY_BEHIND, 0.5)):
        assert least <= fit.behind <= most
        assert fit.behind == formulas.behind(pair, fit.R_cur_from_prev,
                                                       fit.t_cur_from_prev)


def test_the_motion_that_leaves_the_plane_before_the_camera_is_taken(rng):
    pair = floor(rng)
    right, *_, wrong = fits(pair)
    for fit in (right, wrong):
        found = planar_ambiguity.unfolded(pair, fit)
        assert angle(found.R_cur_from_prev @ R.T) < np.radians(0.1)
        assert found.t_cur_from_prev @ T > np.cos(np.radians(1))
    assert planar_ambiguity.unfolded(pair, right) is right


def test_without_parallax_there_is_no_motion_of_a_plane(rng):
    assert planar_ambiguity.from_homography(floor(rng, noise=0.0, baseline=0.0)) == []


def test_a_motion_that_explains_much_more_replaces_the_predicted_one(rng):
    pair = floor(rng)
    right, *_ = fits(pair)
    unit = planar_ambiguity.AMBIGUITY / len(pair)
    slight, clear = (replace(right, cost=right.cost - step * unit) for step in (0.9, 1.1))
    assert planar_ambiguity.likeliest(pair, right, [slight]).cost == right.cost
    assert planar_ambiguity.likeliest(pair, right, [clear]).cost == clear.cost
    assert planar_ambiguity.likeliest(pair, None, [right, slight]).cost == slight.cost


def test_blocks_behind_the_camera_are_not_explained(rng):
    """Noise and wrong vectors may favour the twin by as much as they do here."""
    pair = floor(rng)
    right, *_, wrong = fits(pair)
    favoured = replace(wrong, cost=right.cost - 2 * planar_ambiguity.AMBIGUITY / len(pair))
    assert planar_ambiguity.likeliest(pair, right, [favoured]).cost == right.cost
    assert planar_ambiguity.likeliest(pair, favoured, [right]).cost == right.cost


def test_the_sign_of_a_direction_follows_from_what_is_before_the_camera(rng):
    pair = floor(rng)
    right, *_ = fits(pair)
    turned = refined_from(pair, right.R_cur_from_prev, -right.t_cur_from_prev)
    assert turned.t_cur_from_prev @ right.t_cur_from_prev > 0
    assert turned.t_cur_from_prev @ T > 0


def test_a_motion_that_explains_far_less_is_no_twin(rng, monkeypatch):
    pair = floor(rng)
    right, *_, wrong = fits(pair)
    for dearer, taken in ((0.05, True), (0.15, False)):
        other = replace(right, cost=wrong.cost + dearer)
        monkeypatch.setattr(planar_ambiguity, 'refined_from', lambda *_, other=other: other)
        assert (planar_ambiguity.unfolded(pair, wrong) is not wrong) == taken
