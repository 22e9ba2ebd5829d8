"""Which detection continues which track, and which detections are one vehicle."""

from dataclasses import replace
from types import SimpleNamespace

from mv_slapse.filters import association
from mv_slapse.filters.detections import box_of, Detection, Edge
from mv_slapse.records import ScalePrior
import numpy as np
import pytest

GATE = 0.999
R = np.diag([1e-4, 1e-4, 0.01, 0.01, 0.01, 0.01, 0.1, 0.1])


def blocks(column, row, across=3, down=2):
    x, y = np.meshgrid(16 * (column + np.arange(across)) + 7.5, 16 * (row + np.arange(down)) + 7.5)
    return np.c_[x.ravel(), y.ravel()]


def detection(id_=1, column=10, row=15, rate=(0.5, 0, -0.3), depth=15.0, has_depth=True, **size):
    x = blocks(column, row, **size)
    centre = (x.mean(axis=0) - [320, 240]) / 600
    z = np.r_[centre, np.log(depth), rate, 0, 0]
    return Detection(id_, z, R, has_depth, x, np.full(x.shape, 16.0), ScalePrior.GROUND_CONTACT,
                     Edge(16.0 * (row + 2), 8.0, 60.0))


def track_of(item):
    return SimpleNamespace(mu=item.z, P=R, x=item.x, plane_id=item.id)


def test_overlap_is_the_share_of_the_smaller_region():
    assert association.overlap(blocks(0, 0), blocks(0, 0)) == 1
    assert association.overlap(blocks(0, 0, 4, 4), blocks(1, 1, 2, 2)) == 1
    assert association.overlap(blocks(0, 0, 2, 2), blocks(1, 0, 2, 2)) == 0.5
    assert association.overlap(blocks(0, 0), blocks(8, 0)) == 0


def test_neighbours_are_not_exchanged_whatever_their_order():
    a, b = detection(1, 10), detection(2, 14, rate=(-0.5, 0, 0))
    for order in ((a, b), (b, a)):
        pairs = association.associate([track_of(a), track_of(b)], order, GATE)
        assert {(i, order[j].id) for i, j in pairs} == {(0, 1), (1, 2)}


def test_the_best_assignment_counts_not_the_nearest_first():
    left, right = track_of(detection(1, 10)), track_of(detection(2, 11))
    middle, far = detection(1, 11), detection(2, 12)
    assert association.associate([left, right], [middle, far], GATE) == [(0, 0), (1, 1)]


@pytest.mark.parametrize('stranger', [
    detection(2, 20), detection(1, 10, rate=(0.5, 0, 3.0)), detection(1, 10, depth=60.0)],
    ids=['elsewhere', 'other motion', 'other depth'])
def test_what_does_not_fit_stays_free(stranger):
    assert association.associate([track_of(detection())], [stranger], GATE) == []


def test_a_depth_that_is_no_evidence_does_not_speak_against_a_detection():
    guess = detection(1, 10, depth=60.0, has_depth=False)
    assert association.associate([track_of(detection())], [guess], GATE) == [(0, 0)]


def test_of_two_alike_the_one_that_overlaps_more_continues():
    track = track_of(detection(5, 10, across=4))
    other, same = detection(6, 11, across=4), detection(7, 10, across=4)
    same = replace(same, z=other.z)
    assert association.associate([track], [other, same], GATE) == [(0, 1)]


def test_nothing_to_assign_is_no_pair():
    assert association.associate([], [detection()], GATE) == []
    assert association.associate([track_of(detection())], [], GATE) == []


def test_squared_distance_leaves_the_slope_out():
    item = detection()
    mu = item.z + np.r_[0.01, 0, 0, 0.1, 0, 0, 9, 9]
    distance, dof = association.squared_distance(mu, R, item)
    assert distance == pytest.approx(0.01**2 / 2e-4 + 0.1**2 / 0.02)
    assert dof == 6
    assert association.squared_distance(mu, R, replace(item, has_depth=False))[1] == 5


def test_touching_faces_of_one_motion_join():
    rear, side = detection(1, 10), detection(2, 13, rate=(0.4, 0, -0.24), depth=18.0, across=2)
    joined = association.grouped([rear, side], GATE)
    assert [item.id for item in joined] == [1]
    np.testing.assert_array_equal(joined[0].box, box_of(np.r_[rear.x, side.x], np.full((10, 2),
                                                                                       16.0)))
    np.testing.assert_array_equal(joined[0].z, rear.z)


@pytest.mark.parametrize('other', [
    detection(2, 16), detection(2, 13, rate=(-0.5, 0, -0.3)), detection(2, 13, depth=40.0)],
    ids=['apart', 'other motion', 'far behind'])
def test_others_stay_apart(other):
    assert [item.id for item in association.grouped([detection(1, 10), other], GATE)] == [1, 2]


def test_what_lies_above_has_no_depth_of_its_own():
    roof = detection(2, 10, row=13, depth=40.0)
    assert [item.id for item in association.grouped([detection(1, 10), roof], GATE)] == [1]
