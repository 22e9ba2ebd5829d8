"""Planes from pair to pair: prediction, likeness, patience."""

from dataclasses import replace

from mv_slapse.surfaces import plane_track as known_planes
from mv_slapse.surfaces.plane_track import DRIFT, KnownPlanes, PATIENCE, WOBBLE
from numeric import jacobian
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

R = Rotation.from_rotvec([0.02, -0.05, 0.01]).as_matrix()
T = np.array([0.1, 0.0, -0.995])
PLANE = np.array([0.15, 0.01, -0.05])


def one(plane, covariance, id_=-1, seen=1, missed=0):
    """Return a single known plane."""
    return KnownPlanes(np.array([plane], float), np.array([covariance]),
                       *(np.array([number]) for number in (id_, seen, missed)))


def test_points_of_a_plane_lie_on_its_prediction(rng):
    known = one(PLANE, np.eye(3) * 1e-6)
    points = rng.normal(size=(3, 3))
    points -= ((points @ PLANE + 1) / (PLANE @ PLANE))[:, None] * PLANE
    # The next baseline is 1.25 of the last: the same points have smaller coordinates.
    moved = points / 1.25 @ R.T + T
    plane = known.predicted(R, T, np.log(1.25), 0.0).plane[0]
    np.testing.assert_allclose(moved @ plane, -1)


def test_its_covariance_follows_by_first_order(rng):
    root = 0.01 * rng.normal(size=(3, 3))
    known = one(PLANE, root @ root.T)
    J = jacobian(lambda p: one(p, np.eye(3)).predicted(R, T, 0.2, 0.0).plane[0], PLANE)
    after = known.predicted(R, T, 0.2, 0.1)
    n = after.plane[0]
    expected = (J @ known.covariance[0] @ J.T + 0.01 * np.outer(n, n)
                + WOBBLE**2 * (n @ n) * np.eye(3))
    np.testing.assert_allclose(after.covariance[0], expected, rtol=1e-5, atol=1e-12)


def test_a_plane_that_the_camera_has_passed_is_gone():
    wall_ahead = one(np.array([0, 0, -1 / 0.5]), np.eye(3))
    assert wall_ahead.predicted(np.eye(3), np.array([0, 0, -1.0]), 0.0, 0.0).id.size == 0


@pytest.mark.parametrize(('sigmas', 'is_near'), [(3.5, True), (4.0, False)])
def test_the_same_plane_lies_within_the_gate(sigmas, is_near):
    known = one(PLANE, np.eye(3) * 3e-4)
    away = PLANE + sigmas * 0.02 * np.array([1.0, 0, 0])
    assert known.near(away, np.eye(3) * 1e-4) == is_near


def test_a_plane_seen_twice_is_waited_for_and_another_is_not():
    assert len(one(PLANE, np.eye(3)).unseen()) == 0
    known = one(PLANE, np.eye(3), seen=2)
    for _ in range(PATIENCE):
        known = known.unseen()
    assert known.missed == [PATIENCE]
    assert len(known.unseen()) == 0


def gone(seen, pairs, plane=PLANE, id_=0):
    """Return a plane that so many pairs have shown and so many since then have not."""
    known = one(plane, np.eye(3) * 1e-6, id_, seen)
    for _ in range(pairs):
        known = known.unseen()
    return known


def test_a_well_seen_plane_may_come_back_as_long_as_it_can_be_told_from_others():
    assert len(gone(known_planes.WELL_SEEN - 1, PATIENCE + 1)) == 0
    away = gone(known_planes.WELL_SEEN, 50)
    assert (away.missed, away.is_away) == (50, True)
    assert not gone(known_planes.WELL_SEEN, PATIENCE).is_away
    vague = replace(away, covariance=np.eye(3)[None] * (0.2 * np.linalg.norm(PLANE))**2 / 3)
    assert len(vague.unseen()) == 0


def test_out_of_view_a_plane_is_wrong_by_what_the_motion_is():
    before = gone(9, 1)
    after = before.predicted(np.eye(3), np.array([0, 0, -1e-9]), 0.0, 0.0)
    np.testing.assert_allclose((after.covariance - before.covariance)[0],
                               DRIFT**2 * (PLANE @ PLANE) * np.eye(3), atol=1e-12)


def together(planes):
    """Return known planes as one record."""
    return sum(planes, KnownPlanes.none())


def test_a_new_plane_is_the_nearest_of_those_out_of_view_or_another():
    away = together(gone(9, 9, PLANE * (1 + 0.004 * i), i) for i in range(3))
    new = PLANE * 1.005, np.eye(3) * 1e-6
    assert away.recognised(*new) == 1
    assert gone(9, 1, PLANE, 5).recognised(*new) == -1  # still in view: another one
    assert away.recognised(PLANE * 1.1, new[1]) == -1
    assert KnownPlanes.none().recognised(*new) == -1


def test_the_longest_out_of_view_are_given_up_first():
    planes = together([gone(9, 0, id_=99), *(gone(9, 10 + i, id_=i) for i in range(40))])
    assert planes.unseen().id.tolist() == [99, *range(known_planes.MOST_KEPT)]
