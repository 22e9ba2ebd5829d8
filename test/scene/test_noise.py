"""How far errors go together, measured on pairs whose errors are known."""

from dataclasses import replace

import canyon
from canyon import motion, views
from mv_slapse.config import SceneSettings
from mv_slapse.geometry.camera import to_rays
from mv_slapse.records import Label
from mv_slapse.scene import update as scene_update
from mv_slapse.scene.filter import SceneFilter
from mv_slapse.scene.noise import Dependence, measured
import numpy as np
import pytest
from scene_drive import Canyon, METRIC
from scipy import ndimage


def pair(rng, together):
    """Return a canyon whose errors have a share of their variance in common with neighbours."""
    scene = views(*motion('ahead'))
    cell = (scene.x_cur // 16).astype(int)
    wide = rng.normal(size=(*cell.max(axis=0) + 1, 2))
    smooth = 3 * ndimage.uniform_filter(rng.normal(size=wide.shape), (3, 3, 0), mode='wrap')
    error = np.sqrt(1 - together) * wide + np.sqrt(together) * smooth
    x_prev = scene.x_true + 0.3 * error[tuple(cell.T)]
    return replace(scene.pair, x_prev=x_prev, sigma=np.full(len(cell), 0.3),
                   rays_prev=to_rays(canyon.K, x_prev)), scene.R, scene.t


@pytest.mark.parametrize(('together', 'low', 'high'), [(0.0, 0.75, 1.2), (0.5, 3.4, 5.2)])
def test_dependence_is_the_variance_of_a_mean_over_that_of_independent_errors(together, low,
                                                                              high):
    """Errors shared by 3 x 3 macroblocks count 9 times: 1 + 8 together, less at the borders."""
    found = [measured(*pair(np.random.default_rng(seed), together))[0] for seed in range(20)]
    assert low < np.mean(found) < high


def test_a_noise_twice_as_large_as_said_counts_four_times():
    noisy, R, t = pair(np.random.default_rng(0), 0.0)
    sure = replace(noisy, sigma=noisy.sigma / 1.5)
    assert measured(sure, R, t)[0] / measured(noisy, R, t)[0] == pytest.approx(1.5**2, rel=0.3)


def test_the_mean_forgets_where_it_began_and_one_bad_pair_moves_it_by_little():
    dependence = Dependence(6.0)
    for seed in range(30):
        dependence = dependence.seen(*pair(np.random.default_rng(seed), 0.0))
    settled = dependence.value
    assert 1.2 <= settled < 1.4
    dependence = dependence.seen(*pair(np.random.default_rng(99), 1.0))
    assert settled < dependence.value < 1.5 * settled


def test_a_few_correspondences_tell_nothing():
    few, R, t = pair(np.random.default_rng(0), 0.0)
    before = Dependence(6.0)
    assert before.seen(few[:40], R, t) is before


def test_vectors_that_are_copied_tell_of_a_place_that_errs():
    dependence, before, unlabelled = Dependence(6.0), SceneSettings(), np.zeros(0, np.int8)
    for seed in range(10):
        dependence = dependence.seen(*pair(np.random.default_rng(seed), 0.5))
    copied = 1.5 * 0.3 * (dependence.value - 1)
    assert copied > 2 * before.place_bias
    assert dependence.settings(before, unlabelled).place_bias == pytest.approx(copied)
    independent = Dependence(1.2, 10, 0.3)
    assert independent.settings(before, unlabelled).place_bias == before.place_bias


@pytest.mark.parametrize('share', [0.0, 0.2])
def test_vectors_around_movers_lean_so_that_a_turn_adds_up(share):
    """As much in each pair: the roll is as unsure as so many pairs make it, not their root."""
    filter_, n = SceneFilter(METRIC), 20
    for k in range(1, n + 1):
        seen = Canyon().extraction(k)
        rows = np.arange(len(seen.label)) % 10 < 10 * share
        estimate = filter_.step(replace(
            seen, label=np.where(rows, Label.MOVING, seen.label).astype(np.int8),
            plane_id=np.where(rows, -1, seen.plane_id).astype(np.int32)))[0]
    rolling = METRIC.mover_bias * share * scene_update.stationary(seen)[0].roll_arm
    leaning = n * np.hypot(METRIC.vector_bias, rolling) / seen.K[0, 0]
    assert leaning < np.sqrt(estimate.pose_covariance[5, 5]) < leaning + 0.004


def test_vectors_without_a_label_count_for_movers_as_the_others_do():
    label = np.array([Label.MOVING] * 2 + [Label.STATIONARY] * 5 + [Label.INFINITY]
                     + [Label.UNKNOWN] * 8, np.int8)
    found = Dependence(4.0).settings(SceneSettings(mover_bias=0.8), label)
    assert (found.mover_bias, found.dependence) == (pytest.approx(0.2), 4.0)
    assert Dependence(4.0).settings(SceneSettings(), label[8:]).mover_bias == 0


def test_the_lean_of_a_first_pair_counts_in_the_second_which_has_labels_first():
    told = np.array([Label.MOVING] * 5 + [Label.STATIONARY] * 15, np.int8)
    bias = [Dependence(4.0, pairs).settings(SceneSettings(mover_bias=0.8), label).mover_bias
            for pairs, label in ((1, 0 * told), (2, told), (3, told))]
    assert bias == pytest.approx([0.0, 0.2 * np.sqrt(2), 0.2])


def test_one_pair_tells_more_of_a_stream_than_the_value_before_any():
    seen = pair(np.random.default_rng(0), 0.0)
    values = [Dependence(value).seen(*seen).value for value in (20.0, 1.5)]
    assert values[0] == pytest.approx(values[1], rel=1e-12)
