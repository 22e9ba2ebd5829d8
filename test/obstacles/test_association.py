"""Which detection continues which track, and which detections are one vehicle."""

from dataclasses import replace
from types import SimpleNamespace

from mv_slapse.obstacles import association
from mv_slapse.obstacles.detection import Detection, Edge
from mv_slapse.records import ScalePrior
import numpy as np
import pytest

GATE = 0.999
R = np.diag([1e-4, 1e-4, 0.01, 0.01, 0.01, 0.01, 0.1, 0.1])


def ids(detections, expected=None):
    return [[item.id for item in group]
            for group in association.groups(detections, GATE, expected)]


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
    detection(2, 20), detection(2, 10, rate=(0.5, 0, 3.0)), detection(2, 10, depth=60.0)],
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
    assert ids([rear, side]) == [[1, 2]]


@pytest.mark.parametrize('other', [
    detection(2, 16), detection(2, 13, rate=(-0.5, 0, -0.3)),
    detection(2, 13, rate=(0.19, 0, -0.11), depth=40.0)],
    ids=['apart', 'other motion', 'far behind at the same velocity'])
def test_others_stay_apart(other):
    sure = [replace(item, R=0.1 * R) for item in (detection(1, 10), other)]
    assert ids(sure) == [[1], [2]]


def test_what_lies_above_has_no_depth_of_its_own():
    roof = detection(2, 10, row=13, depth=40.0)
    assert ids([detection(1, 10), roof]) == [[1, 2]]


def test_a_part_whose_foot_is_hidden_moves_too_nearly_alike_to_be_another_car():
    whole, part = detection(1, 10), detection(2, 13, rate=(0.45, 0, -0.27), depth=24.0)
    assert ids([whole, part]) == [[1, 2]]
    # At that depth a car with the same velocity would have two thirds of the rate.
    behind = detection(2, 13, rate=(0.31, 0, -0.19), depth=24.0)
    far_less_sure = replace(behind, R=0.01 * R)
    assert ids([replace(whole, R=0.01 * R), far_less_sure]) == [[1], [2]]


def test_parts_of_a_large_vehicle_may_lie_farther_apart():
    def apart(size):
        one = detection(1, 5, row=5, across=size, down=size)
        return ids([one, detection(2, 5 + size + 2, row=5, across=size, down=size)])
    assert apart(3) == [[1], [2]]
    assert apart(8) == [[1, 2]]


def test_what_the_extractor_calls_the_same_region_may_fit_worse():
    jump = np.r_[0, 0, 0, 1.2, 0, 0, 0, 0]
    same, other = detection(1, 10), detection(2, 10)
    for item, pairs in ((same, [(0, 0)]), (other, [])):
        moved = replace(item, z=item.z + 1.2 * jump)
        assert association.associate([track_of(detection())], [moved], GATE) == pairs


def test_a_part_lies_inside_and_moves_alike():
    whole, part = detection(1, 10, across=6, down=6), detection(2, 12, row=17)
    beside, other = detection(2, 15, row=17), detection(2, 12, row=17, rate=(0.5, 0, 0.3))

    def is_part(item):
        return association.is_part((whole.z, 0.1 * R), whole.box, (item.z, 0.1 * R), item.box,
                                   GATE)
    assert is_part(part)
    assert not is_part(beside)
    assert not is_part(other)


def test_regions_of_two_obstacles_never_join():
    rear, side, roof = detection(1, 10), detection(2, 13, across=2), detection(3, 10, row=14)
    assert ids([rear, side, roof], {1: rear.box, 2: side.box}) == [[1, 3], [2]]


def test_what_is_new_joins_an_obstacle_only_where_that_is_expected():
    rear, side = detection(1, 10), detection(2, 13, across=3)
    assert ids([rear, side], {1: rear.box}) == [[1], [2]]
    assert ids([rear, side], {1: rear.box + [0, 0, 32, 0]}) == [[1, 2]]


def test_boxes_that_differ_by_half_a_block_are_the_same():
    box = np.array([100.0, 50.0, 64.0, 32.0])
    assert association.box_overlap(box, box) == 1.0
    assert association.box_overlap(box, box + (8.0, -8.0, -8.0, 12.0)) == 1.0
    assert association.box_overlap(box, box + (0.0, 0.0, 40.0, 0.0)) == pytest.approx(64 / 96)
    assert association.box_overlap(box, box + (72.0, 0.0, 0.0, 0.0)) == 0.0
    assert association.box_overlap(box, box + (40.0, 0.0, 0.0, 0.0)) == pytest.approx(32 / 96)
