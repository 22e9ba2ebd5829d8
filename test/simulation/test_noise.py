"""Drawn errors of vectors have the sizes that were asked for."""

from dataclasses import replace

from mv_slapse.geometry.camera import to_pixels, to_rays
from mv_slapse.records import Label
from mv_slapse.simulation import drawn
from mv_slapse.simulation.noise import NoisyVectors, VectorNoise
from mv_slapse.simulation.street import Street, StreetSettings
import numpy as np
import pytest

NONE = VectorNoise(sigma=0.0, together=0.0, outliers=0.0, relief=0.0, surface_bias=0.0,
                   depth_bias=0.0, offset=0.0, mover_lean=0.0, place=0.0, heave=0.0)
FIRST, SECOND = 20, 24


@pytest.fixture(scope='module')
def street():
    return Street(StreetSettings(seed=3))


@pytest.fixture(scope='module')
def exact(street):
    return drawn.draw(street, FIRST, SECOND, np.random.default_rng(0), 0.0, 0.0)


def errors(street, exact, seeds=1, **noise):
    """Return the errors (seeds, N, 2) of x_prev [px]."""
    found = []
    for seed in range(seeds):
        vectors = NoisyVectors(street, replace(NONE, **noise), np.random.default_rng(seed))
        found.append(vectors.pair(FIRST, SECOND).x_prev - exact.x_true)
    return np.array(found)


def test_without_noise_the_pair_is_exact(street, exact):
    np.testing.assert_allclose(errors(street, exact), 0, atol=1e-4)


def test_noise_has_its_variance_and_neighbours_share_theirs(street, exact):
    found = errors(street, exact, 20, sigma=0.3, together=0.5)
    assert np.std(found) == pytest.approx(0.3, rel=0.03)
    x = exact.correspondences.x_cur
    beside = np.all(np.diff(x, axis=0) == (16, 0), axis=1)
    # Two windows of 3 x 3 side by side share 6 of 9 blocks.
    shared = np.mean((found[:, :-1] * found[:, 1:])[:, beside]) / 0.09
    assert shared == pytest.approx(0.5 * 6 / 9, abs=0.05)


def test_a_share_of_the_vectors_is_wrong(street, exact):
    wrong = np.abs(errors(street, exact, 5, outliers=0.2)).max(axis=2) > 0.01
    assert wrong.mean() == pytest.approx(0.2, abs=0.02)


@pytest.mark.parametrize(('kind', 'same_in_a_pair'), [('depth_bias', True), ('relief', False)])
def test_depths_err_by_a_share_of_the_parallax(street, exact, kind, same_in_a_pair):
    found = errors(street, exact, 60, **{kind: 0.02})
    R = street.pose(SECOND)[0].T @ street.pose(FIRST)[0]
    K = street.camera.K
    far = to_pixels(K, to_rays(K, exact.correspondences.x_cur.astype(float)) @ R)
    parallax = exact.x_true - far
    seen = (exact.surface >= 0) & (np.linalg.norm(parallax, axis=1) > 2)
    share = np.sum(found * parallax, axis=2)[:, seen] / np.sum(parallax**2, axis=1)[seen]
    assert np.std(share) == pytest.approx(0.02, rel=0.3)
    assert np.allclose(share, share[:, :1], atol=1e-4) is same_in_a_pair


def test_surfaces_err_each_by_a_share_of_its_own(street, exact):
    found = errors(street, exact, surface_bias=0.05)[0]
    length = np.linalg.norm(found, axis=1)
    assert np.all(length[exact.surface < 0] < 1e-4)
    assert np.all(length[exact.surface == 0].mean() > 1e-3)


def test_an_offset_turns_all_vectors_alike_and_lasts(street, exact):
    vectors = NoisyVectors(street, replace(NONE, offset=0.5), np.random.default_rng(2))
    means = []
    for _ in range(200):
        error = vectors.pair(FIRST, SECOND).x_prev - exact.x_true
        means.append(error.mean(axis=0))
    assert np.std(error - error.mean(axis=0)) < np.linalg.norm(np.std(means, axis=0))
    assert np.std(means, axis=0) == pytest.approx(np.full(2, 0.5), rel=0.25)
    assert np.abs(np.mean(means, axis=0)).max() > 0.1


def test_vectors_lean_by_the_share_that_movers_have():
    busy = Street(StreetSettings(seed=0, movers=('bus_ahead', 'bus_beside')))
    truth = drawn.draw(busy, FIRST, SECOND, np.random.default_rng(0), 0.0, 0.0)
    share = np.mean(truth.label == Label.MOVING)
    assert share > 0.3
    # Half of the variance lasts, half is the pair's.
    leans = errors(busy, truth, 100, mover_lean=1.0).mean(axis=1)
    assert np.std(leans, axis=0) == pytest.approx(np.full(2, np.sqrt(2) * share), rel=0.25)
    still = Street(StreetSettings(seed=0, movers=()))
    truth = drawn.draw(still, FIRST, SECOND, np.random.default_rng(0), 0.0, 0.0)
    np.testing.assert_allclose(errors(still, truth, mover_lean=1.0), 0, atol=1e-4)


def test_vectors_tell_of_a_point_beside_the_middle_of_their_block(street, exact):
    rng = np.random.default_rng(1)
    vectors = NoisyVectors(street, replace(NONE, place=2.0), rng)
    found = vectors.pair(FIRST, SECOND).x_prev - exact.x_true
    beside = np.random.default_rng(1)
    beside.normal(0, 1, 4)  # what lasts and was drawn before
    offset = beside.normal(0, 2.0, 2)
    x = exact.correspondences.x_cur.astype(float)
    there, surface, seen = drawn.match(street, FIRST, SECOND, x + offset)
    inner = seen & (surface == exact.surface)
    assert inner.mean() > 0.8
    np.testing.assert_allclose((x + found + exact.x_true - x)[inner], (there - offset)[inner],
                               atol=1e-3)
    assert np.abs(found[exact.surface == 0]).mean() > 0.05  # the motion differs there


def test_the_height_above_the_ground_swings_about_its_mean(street, exact):
    vectors = NoisyVectors(street, replace(NONE, heave=0.05, heave_time=0.4),
                           np.random.default_rng(0))
    R = street.pose(SECOND)[0].T @ street.pose(FIRST)[0]
    far = to_pixels(street.camera.K,
                    to_rays(street.camera.K, exact.correspondences.x_cur.astype(float)) @ R)
    road = exact.surface == street.names.index('ground')
    parallax = (exact.x_true - far)[road]
    shares = []
    for _ in range(300):
        error = vectors.pair(FIRST, SECOND).x_prev - exact.x_true
        assert np.abs(error[~road]).max() < 1e-3
        shares.append(np.sum(error[road] * parallax) / np.sum(parallax**2))
    shares = np.array(shares)
    assert np.std(shares) == pytest.approx(0.05, rel=0.25)
    lasting = np.mean(shares[1:] * shares[:-1]) / np.var(shares)
    step = (SECOND - FIRST) / street.settings.fps
    assert lasting == pytest.approx(np.exp(-step / 0.4), abs=0.12)
