"""Planes from pair to pair: prediction, fusion, patience."""

from mv_slapse.planes.known import KnownPlane, PATIENCE, WOBBLE
from numeric import jacobian
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

R = Rotation.from_rotvec([0.02, -0.05, 0.01]).as_matrix()
T = np.array([0.1, 0.0, -0.995])
PLANE = np.array([0.15, 0.01, -0.05])


def test_points_of_a_plane_lie_on_its_prediction(rng):
    known = KnownPlane(PLANE, np.eye(3) * 1e-6)
    points = rng.normal(size=(3, 3))
    points -= ((points @ PLANE + 1) / (PLANE @ PLANE))[:, None] * PLANE
    # The next baseline is 1.25 of the last: the same points have smaller coordinates.
    moved = points / 1.25 @ R.T + T
    plane = known.predicted(R, T, np.log(1.25), 0.0).plane
    np.testing.assert_allclose(moved @ plane, -1)


def test_its_covariance_follows_by_first_order(rng):
    root = 0.01 * rng.normal(size=(3, 3))
    known = KnownPlane(PLANE, root @ root.T)
    J = jacobian(lambda p: KnownPlane(p, np.eye(3)).predicted(R, T, 0.2, 0.0).plane, PLANE)
    after = known.predicted(R, T, 0.2, 0.1)
    n = after.plane
    expected = (J @ known.covariance @ J.T + 0.01 * np.outer(n, n)
                + WOBBLE**2 * (n @ n) * np.eye(3))
    np.testing.assert_allclose(after.covariance, expected, rtol=1e-5, atol=1e-12)


def test_a_plane_that_the_camera_has_passed_is_gone():
    wall_ahead = KnownPlane(np.array([0, 0, -1 / 0.5]), np.eye(3))
    assert wall_ahead.predicted(np.eye(3), np.array([0, 0, -1.0]), 0.0, 0.0) is None


def test_two_pairs_of_equal_covariance_count_alike():
    known = KnownPlane(PLANE, np.eye(3) * 4e-4, id=3, seen=2, missed=1)
    fused = known.fused(PLANE + 0.02, np.eye(3) * 4e-4)
    np.testing.assert_allclose(fused.plane, PLANE + 0.01)
    np.testing.assert_allclose(fused.covariance, np.eye(3) * 2e-4, atol=1e-12)
    assert (fused.id, fused.seen, fused.missed) == (3, 3, 0)


def test_fusion_adds_information(rng):
    a, b = (root @ root.T for root in rng.normal(size=(2, 3, 3)))
    fused = KnownPlane(PLANE, a).fused(PLANE, b)
    np.testing.assert_allclose(np.linalg.inv(fused.covariance),
                               np.linalg.inv(a) + np.linalg.inv(b), rtol=1e-6)


@pytest.mark.parametrize(('sigmas', 'is_near'), [(3.5, True), (4.0, False)])
def test_the_same_plane_lies_within_the_gate(sigmas, is_near):
    known = KnownPlane(PLANE, np.eye(3) * 3e-4)
    away = PLANE + sigmas * 0.02 * np.array([1.0, 0, 0])
    assert known.is_near(away, np.eye(3) * 1e-4) == is_near


def test_a_plane_seen_twice_is_waited_for_and_another_is_not():
    assert KnownPlane(PLANE, np.eye(3)).unseen() is None
    known = KnownPlane(PLANE, np.eye(3), seen=2)
    for _ in range(PATIENCE):
        known = known.unseen()
    assert known.missed == PATIENCE
    assert known.unseen() is None
