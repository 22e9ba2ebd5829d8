"""Planes of a pair against numpy."""

from mv_slapse.config import ExtractionSettings
from mv_slapse.kernels.binding import compiled
from mv_slapse.surfaces.plane_search import POLICY
from mv_slapse.surfaces.plane_track import KnownPlanes
import numpy as np
import pytest
import surfaces_reference
from walls import UP, walls

RULES = ExtractionSettings(radius=96.0, max_uncertainty=0.12)


def found(depths, known, room=8, rules=RULES):
    """Return what the kernel finds."""
    return compiled.find_planes(
        depths.rays, depths.rho, depths.sigma, depths.x.astype(float), np.ones(len(depths), bool),
        known.plane, known.covariance, known.seen, UP, room,
        {**POLICY, 'min_macroblocks': rules.min_macroblocks})


@pytest.mark.parametrize(('sigma', 'claimed'), [(0.025, 0.025), (0.04, 0.015), (0.01, 0.03)])
def test_planes_of_pairs_in_a_row_are_those_of_numpy(rng, sigma, claimed):
    known = KnownPlanes.none()
    for pair in range(3):
        depths, _ = walls(rng, sigma, claimed)
        thin = depths[rng.random(len(depths)) < 0.8]
        thin.rho[rng.random(len(thin)) < 0.1] *= 1.3
        before, seen, plane, covariance, own, own_covariance, member = found(thin, known)
        expected = surfaces_reference.find_planes(
            thin.rays, thin.rho, thin.sigma, thin.x,
            list(zip(known.plane, known.covariance, strict=True)), UP, 8, 20)
        assert before.tolist() == [track[0] for track in expected]
        assert len(before) or not pair
        for got, right in zip(zip(plane, covariance, own, own_covariance, member, strict=True),
                              expected, strict=True):
            for value, true in zip(got, right[1:], strict=True):
                np.testing.assert_allclose(value, true, rtol=1e-6, atol=1e-10)
        order = np.argsort(-seen, kind='stable')
        known = KnownPlanes(plane, covariance, np.arange(len(seen)), seen, 0 * seen)[order]


def test_a_plane_of_exact_depths_is_exact():
    depths, surface = walls()
    _, _, plane, _, _, _, member = found(depths, KnownPlanes.none())
    assert len(plane) >= 2
    for each, its in zip(plane, member, strict=True):
        error = depths.rho + depths.rays @ each
        assert np.abs(error[its] / depths.rho[its]).max() < 0.02
        assert np.mean(surface[its] == np.bincount(surface[its]).argmax()) > 0.95


def test_means_count_each_estimate_by_its_information(rng):
    planes = rng.normal(size=(2, 4, 3))
    root = rng.normal(size=(2, 4, 3, 3))
    covariance = root @ np.swapaxes(root, -1, -2)
    for i in range(4):
        off, mean, less = compiled.compare_planes(planes[0], covariance[0], planes[1, i],
                                                  covariance[1, i])
        for k in range(4):
            a, b = (planes[0, k], covariance[0, k]), (planes[1, i], covariance[1, i])
            assert off[k] == pytest.approx(surfaces_reference.distance(a, b), rel=1e-6)
            plane, rest = surfaces_reference.fused(a, b)
            np.testing.assert_allclose(mean[k], plane, atol=1e-8)
            np.testing.assert_allclose(less[k], rest, atol=1e-8)
            np.testing.assert_allclose(np.linalg.inv(less[k]), np.linalg.inv(a[1])
                                       + np.linalg.inv(b[1]), rtol=1e-5)


def test_a_missing_constant_and_a_wrong_array_are_named():
    depths, known = walls()[0], KnownPlanes.none()
    policy = {name: value for name, value in POLICY.items() if name != 'lean'}
    with pytest.raises(ValueError, match='no constant lean'):
        compiled.find_planes(depths.rays, depths.rho, depths.sigma, depths.x,
                             np.ones(len(depths), bool), known.plane, known.covariance,
                             known.seen, UP, 8, policy)
    with pytest.raises(ValueError, match='find_planes: rho'):
        found(type(depths)(depths.rays, depths.rho[1:], depths.sigma, depths.x), known)
