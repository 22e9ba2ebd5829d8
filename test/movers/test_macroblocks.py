from mv_slapse.movers import mask
from mv_slapse.records import CameraMotion, Extraction, MotionStatus, SegmentKind
import numpy as np


def vote(x, block, label, plane, x_picture=None, size=(40, 32)):
    """Vote on a grid of 3x2 macroblocks, the last column of which the border cuts."""
    x, block = np.array(x, np.float32), np.array(block, np.uint8)
    n = len(x)
    extraction = Extraction(
        1, 0, *size, SegmentKind.PP, np.eye(3), CameraMotion(MotionStatus.MOVING), x_cur=x,
        x_prev=x, sigma=np.ones(n, np.float32), block=block, label=np.array(label, np.int8),
        plane_id=np.array(plane, np.int32))
    places = x if x_picture is None else np.array(x_picture, np.float32)
    return mask.vote(extraction, places)


def test_a_macroblock_has_the_label_of_its_vector():
    labels, planes = vote([[23.5, 23.5]], [[16, 16]], [1], [9])
    np.testing.assert_array_equal(labels, [-1, -1, -1, -1, 1, -1])
    np.testing.assert_array_equal(planes, [-1, -1, -1, -1, 9, -1])


def test_partitions_vote_with_their_area():
    x = [[3.5, 3.5], [11.5, 3.5], [7.5, 11.5]]
    labels, planes = vote(x, [[8, 8], [8, 8], [16, 8]], [0, 0, 1], [3, 3, 9])
    assert (labels[0], planes[0]) == (0, 3)  # equal areas: the lower label
    labels, planes = vote(x, [[8, 8], [4, 8], [16, 8]], [0, 0, 1], [3, 3, 9])
    assert (labels[0], planes[0]) == (1, 9)


def test_wrong_vectors_do_not_vote():
    labels, planes = vote([[3.5, 3.5], [7.5, 11.5]], [[8, 8], [16, 8]], [2, -1], [-1, -1])
    assert (labels[0], planes[0]) == (2, -1)


def test_the_plane_is_that_of_the_winners():
    x = [[3.5, 3.5], [11.5, 3.5], [3.5, 11.5], [11.5, 11.5]]
    labels, planes = vote(x, [[8, 8], [4, 8], [8, 8], [10, 10]], [0, 0, 0, 1], [4, 4, 5, 9])
    assert (labels[0], planes[0]) == (0, 4)


def test_what_may_move_gives_no_macroblock_a_plane():
    labels, planes = vote([[7.5, 7.5], [23.5, 7.5]], [[16, 16], [16, 16]], [0, 0], [-2, 4])
    np.testing.assert_array_equal(labels[:2], [0, 0])
    np.testing.assert_array_equal(planes[:2], [-1, 4])


def test_blocks_stand_where_the_picture_has_them_not_where_undistorted():
    labels, _ = vote([[14.0, 7.5]], [[16, 16]], [0], [2], x_picture=[[23.5, 7.5]])
    np.testing.assert_array_equal(labels[:2], [-1, 0])


def test_what_lies_outside_is_left_out():
    labels, _ = vote([[-9.0, 5.0], [60.0, 5.0]], [[16, 16]] * 2, [0, 0], [1, 1])
    assert not np.any(labels >= 0)
