from mv_slapse.records import CameraMotion, Correspondences, Extraction, MotionStatus, SegmentKind
from mv_slapse.storage import labels
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
    return labels.vote(Correspondences(1, 0, *size, SegmentKind.PP, x_cur=places), extraction)


def test_the_grid_covers_blocks_that_the_border_cuts():
    assert labels.grid_shape(1240, 376) == (78, 24)
    np.testing.assert_array_equal(labels.grid_centres(40, 32)[:4],
                                  [[7.5, 7.5], [23.5, 7.5], [39.5, 7.5], [7.5, 23.5]])


def test_a_macroblock_has_the_label_of_its_vector():
    grid = vote([[23.5, 23.5]], [[16, 16]], [1], [9])
    np.testing.assert_array_equal(grid.label, [-1, -1, -1, -1, 1, -1])
    np.testing.assert_array_equal(grid.plane, [-1, -1, -1, -1, 9, -1])


def test_partitions_vote_with_their_area():
    x = [[3.5, 3.5], [11.5, 3.5], [7.5, 11.5]]
    grid = vote(x, [[8, 8], [8, 8], [16, 8]], [0, 0, 1], [3, 3, 9])
    assert (grid.label[0], grid.plane[0]) == (0, 3)  # equal areas: the lower label
    grid = vote(x, [[8, 8], [4, 8], [16, 8]], [0, 0, 1], [3, 3, 9])
    assert (grid.label[0], grid.plane[0]) == (1, 9)


def test_wrong_vectors_do_not_vote():
    grid = vote([[3.5, 3.5], [7.5, 11.5]], [[8, 8], [16, 8]], [2, -1], [-1, -1])
    assert (grid.label[0], grid.plane[0]) == (2, -1)


def test_the_plane_is_that_of_the_winners():
    x = [[3.5, 3.5], [11.5, 3.5], [3.5, 11.5], [11.5, 11.5]]
    grid = vote(x, [[8, 8], [4, 8], [8, 8], [10, 10]], [0, 0, 0, 1], [4, 4, 5, 9])
    assert (grid.label[0], grid.plane[0]) == (0, 4)


def test_blocks_stand_where_the_picture_has_them_not_where_undistorted():
    grid = vote([[14.0, 7.5]], [[16, 16]], [0], [2], x_picture=[[23.5, 7.5]])
    np.testing.assert_array_equal(grid.label[:2], [-1, 0])


def test_what_lies_outside_is_left_out():
    grid = vote([[-9.0, 5.0], [60.0, 5.0]], [[16, 16]] * 2, [0, 0], [1, 1])
    assert not np.any(grid.label >= 0)
