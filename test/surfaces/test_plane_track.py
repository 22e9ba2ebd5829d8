"""Planes from pair to pair: prediction, fusion, patience."""

from dataclasses import replace

from mv_slapse.surfaces import plane_track as known_planes
from mv_slapse.surfaces.plane_track import DRIFT, kept, KnownPlane, PATIENCE, recognised, WOBBLE
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


def gone(seen, pairs, plane=PLANE, id_=0):
    """Return a plane that so many pairs have shown and so many since then have not."""
    known = KnownPlane(plane, np.eye(3) * 1e-6, id=id_, seen=seen)
    for _ in range(pairs):
        known = known and known.unseen()
    return known


def test_a_well_seen_plane_may_come_back_as_long_as_it_can_be_told_from_others():
    assert gone(known_planes.WELL_SEEN - 1, PATIENCE + 1) is None
    away = gone(known_planes.WELL_SEEN, 50)
    assert (away.missed, away.is_away) == (50, True)
    assert not gone(known_planes.WELL_SEEN, PATIENCE).is_away
    vague = replace(away, covariance=np.eye(3) * (0.2 * np.linalg.norm(PLANE))**2 / 3)
    assert vague.unseen() is None


def test_out_of_view_a_plane_is_wrong_by_what_the_motion_is():
    before = gone(9, 1)
    after = before.predicted(np.eye(3), np.array([0, 0, -1e-9]), 0.0, 0.0)
    np.testing.assert_allclose(after.covariance - before.covariance,
                               DRIFT**2 * (PLANE @ PLANE) * np.eye(3), atol=1e-12)


def test_a_new_plane_is_the_nearest_of_those_out_of_view_or_another():
    away = [gone(9, 9, PLANE * (1 + 0.004 * i), i) for i in range(3)]
    new = KnownPlane(PLANE * 1.005, np.eye(3) * 1e-6)
    assert recognised(new, away).id == 1
    assert recognised(new, [gone(9, 1, PLANE, 5)]) is None  # still in view: another one
    assert recognised(replace(new, plane=PLANE * 1.1), away) is None


def test_the_longest_out_of_view_are_given_up_first():
    planes = [gone(9, 0, id_=99), *(gone(9, 10 + i, id_=i) for i in range(40))]
    assert [plane.id for plane in kept(planes)] == [99, *range(known_planes.MOST)]
