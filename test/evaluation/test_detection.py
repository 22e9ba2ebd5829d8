from mv_slapse.evaluation import detection
from mv_slapse.evaluation.detection import grid_index, PointLabels
from mv_slapse.evaluation.truth import LabelTable
from mv_slapse.geometry.blocks import grid_centres
from mv_slapse.records import Label
import numpy as np
from numpy.testing import assert_allclose
import pytest

PERIOD = 100_000_000
N = 12
COLUMNS, ROWS = 10, 5
MOVER = 100
OBSTACLE_NAMES = ('stamp', 'id', 'x', 'y', 'width', 'height', 'px', 'py', 'pz', 'vx', 'vy', 'vz',
                  'ttc', 'n_macroblocks')


def obstacles_of(rows, state='confirmed'):
    """Return an obstacles.csv of (key frame, id, x, y) with boxes of 64x32 px."""
    values = [(PERIOD * k, id_, x, y, 64, 32, 1, 2, 10, 0, 0, 5, 4, 8) for k, id_, x, y in rows]
    columns = np.array(values, float).reshape(-1, len(OBSTACLE_NAMES)).T
    table = dict(zip(OBSTACLE_NAMES, columns, strict=True))
    return {**table, 'state': np.array([state] * len(rows), str)}


def movers_of(rows):
    table = obstacles_of(rows)
    del table['state']
    return table


def label_table(label, plane=None):
    y, x = np.mgrid[:ROWS, :COLUMNS]
    label = np.tile(np.ravel(label), (N, 1))
    return LabelTable(PERIOD * np.arange(N), 16.0 * x.ravel() + 7.5, 16.0 * y.ravel() + 7.5,
                      label, np.full_like(label, -1) if plane is None else
                      np.tile(np.ravel(plane), (N, 1)))


def grid(moving=()):
    label = np.zeros((ROWS, COLUMNS), int)
    for row, column in moving:
        label[row, column] = Label.MOVING
    return label


ON_MOVER = [(row, column) for row in (1, 2) for column in (2, 3, 4, 5)]


def test_overlap_is_intersection_over_union():
    a = np.array([[0, 0, 4, 2], [10, 10, 1, 1.0]])
    b = np.array([[2, 0, 4, 2.0]])
    assert_allclose(detection.iou(a, b), [[1 / 3], [0]])


def test_only_confirmed_obstacles_are_counted():
    table = obstacles_of([(1, 5, 0, 0), (2, 5, 0, 0), (2, 6, 0, 0)])
    table['state'][2] = 'tentative'
    figures = detection.obstacle_figures(table, 4)
    assert figures == {'obstacles_confirmed': 1, 'confirmed_obstacles_per_frame': 0.5}


def test_boxes_are_met_where_they_overlap_enough():
    frames = {'frame': np.array([1.0, 2, 3]), 'x': np.zeros(3), 'y': np.zeros(3),
              'width': np.full(3, 64.0), 'height': np.full(3, 32.0)}
    stamps = PERIOD * np.arange(1, 4)
    table = obstacles_of([(1, 5, 0, 0), (2, 5, 50, 0)])
    figures = detection.box_figures(table, stamps, frames, 10.0)
    assert (figures['boxes_met'], figures['boxes_total']) == (1, 3)
    assert figures['boxes_met_percent'] == pytest.approx(100 / 3)
    table['state'][0] = 'tentative'
    assert detection.box_figures(table, stamps, frames, 10.0)['boxes_met'] == 0


def points_on(places, label):
    """Return points that stay at macroblocks (row, column) for all frames."""
    x = np.array([[16 * column + 2, 16 * row + 13] for row, column in places], float)
    return PointLabels(np.repeat(x[:, None], N, 1), np.ones((len(x), N), bool),
                       np.array(label), 10.0)


def test_a_mover_is_found_where_half_of_its_points_are_called_moving():
    places = [(0, 1), (0, 5), (3, 1), (3, 5)]  # hull of 4 x 3 macroblocks
    for moving, found in ((places[:2], 1), (places[:1], 0)):
        figures = detection.point_figures(label_table(grid(moving)), points_on(places, [2] * 4))
        assert (figures['movers_found'], figures['movers_total']) == (found, 1)
        assert figures['movers_missed'] == ([] if found else [2])


def test_a_small_mover_does_not_count():
    figures = detection.point_figures(label_table(grid(ON_MOVER)),
                                      points_on([(1, 2), (1, 3), (2, 2)], [2] * 3))
    assert figures['movers_total'] == 0


def test_stationary_points_called_moving_are_a_share_of_those_with_a_vector():
    label = grid([(0, 0)])
    label[0, 1] = Label.UNKNOWN
    places = [(0, 0), (0, 1), (0, 2), (0, 3), (0, 4)]
    figures = detection.point_figures(label_table(label), points_on(places, [1] * 5))
    assert figures['stationary_called_moving_percent'] == pytest.approx(25)


def test_points_outside_the_picture_or_not_visible_are_left_out():
    points = points_on([(0, 0), (40, 40), (0, 2)], [1, 1, 1])
    points.tracks[1, :, 0] = np.nan
    points.visible[2] = False
    figures = detection.point_figures(label_table(grid([(0, 2)])), points)
    assert figures['stationary_called_moving_percent'] == 0


def block_figures(label, true=None):
    if true is None:
        true = label_table(grid(ON_MOVER), np.where(grid(ON_MOVER) == 1, MOVER, 1))
    return detection.block_figures(label_table(label), true,
                                   movers_of([(k, MOVER, 32, 16) for k in range(N)]))


def test_a_rendered_mover_is_found_by_its_macroblocks():
    found = block_figures(grid(ON_MOVER))
    assert (found['movers_found'], found['movers_total']) == (1, 1)
    assert found['stationary_called_moving_percent'] == 0
    missed = block_figures(grid())
    assert (missed['movers_found'], missed['movers_missed']) == (0, [MOVER])


def test_confused_labels_are_counted_by_truth_and_call():
    label = grid(ON_MOVER[:6])
    label[4, :5] = Label.MOVING
    label[0, 0] = Label.UNKNOWN
    table = block_figures(label)['label_confusion']
    n = (N - 1) * np.array([[1, 36, 5, 0], [0, 2, 6, 0], [0, 0, 0, 0]])
    assert table == n.tolist()


def test_movers_have_boxes_around_their_visible_points():
    tracks = np.array([[[10.0, 20], [12, 20]], [[30, 50], [32, 50]], [[5, 5], [6, 5]],
                       [[90, 90], [91, 90]]])
    visible = np.array([[1, 1], [1, 1], [1, 1], [0, 1]], bool)
    found = detection.point_boxes(PointLabels(tracks, visible, np.array([2, 2, 1, 3]), 10.0))
    np.testing.assert_array_equal(found['stamp'], [0, 100_000_000, 100_000_000])
    np.testing.assert_array_equal(found['id'], [2, 2, 3])
    np.testing.assert_array_equal(detection.boxes(found),
                                  [[10, 20, 20, 30], [12, 20, 20, 30], [91, 90, 0, 0]])


@pytest.mark.parametrize(('moving', 'still', 'hidden', 'expected'), [
    (3, 2, 0, True), (2, 2, 0, False), (0, 0, 3, False), (1, 0, 0, True)])
def test_a_box_holds_a_mover_where_most_visible_points_move(moving, still, hidden, expected):
    label = np.repeat([2, 1, 2, 3], [moving, still, hidden, 4])
    places = np.where(label == 3, 500.0, 50.0)[:, None, None]  # the last mover is elsewhere
    visible = np.repeat([True, True, False, True], [moving, still, hidden, 4])[:, None]
    points = PointLabels(np.broadcast_to(places, (len(label), 2, 2)),
                         np.broadcast_to(visible, (len(label), 2)), label, 10.0)
    rows = {'stamp': np.array([100_000_000, 200_000_000]), 'x': np.full(2, 40.0),
            'y': np.full(2, 40.0), 'width': np.full(2, 16.0), 'height': np.full(2, 16.0)}
    np.testing.assert_array_equal(detection.hold_movers(rows, points), [expected, False])


def test_a_pixel_has_the_number_of_the_centre_beside_it_or_none_outside():
    centres = grid_centres(40, 32)
    np.testing.assert_array_equal(grid_index(centres + (7.9, -7.9), 40, 32), np.arange(6))
    np.testing.assert_array_equal(
        grid_index(np.array([[-0.6, 5.0], [47.6, 5.0], [5.0, -0.6], [5.0, 31.6]]), 40, 32), -1)
