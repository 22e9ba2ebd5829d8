from dataclasses import replace

import formulas
from kernels import evidence_reference
from mv_slapse.codec.motion_vectors import FrameVectors, FUTURE, PAST
from mv_slapse.records import FrameType
import numpy as np
import pytest

COLUMNS, ROWS = 4, 3


def picture(rng, **changes) -> FrameVectors:
    """Return a P picture of whole macroblocks with vectors of quarter pixels."""
    column, row = (grid.ravel() for grid in np.meshgrid(np.arange(COLUMNS), np.arange(ROWS)))
    n = len(column)
    given = {'x': np.stack([column, row], 1).astype(np.float32) * 16 + 7.5,
             'displacement': rng.integers(-40, 40, (n, 2)).astype(np.float32) / 4,
             'direction': np.full(n, PAST, np.int8), 'block': np.full((n, 2), 16, np.uint8)}
    return FrameVectors(0, FrameType.P, 16 * COLUMNS, 16 * ROWS, is_predicted=True,
                        **(given | changes))


def predicted(frame, *wanted):
    rows = np.array([row * COLUMNS + column for column, row in wanted])
    return evidence_reference.predicted(frame, rows, PAST)


def test_a_prediction_is_the_median_of_left_above_and_above_to_the_right(rng):
    frame = picture(rng)
    v = frame.displacement.reshape(ROWS, COLUMNS, 2)
    np.testing.assert_array_equal(predicted(frame, (1, 1), (2, 2)), [
        np.median([v[1, 0], v[0, 1], v[0, 2]], axis=0),
        np.median([v[2, 1], v[1, 2], v[1, 3]], axis=0)])


def test_at_the_border_fewer_macroblocks_predict(rng):
    frame = picture(rng)
    v = frame.displacement.reshape(ROWS, COLUMNS, 2)
    zero = np.zeros(2)
    np.testing.assert_array_equal(predicted(frame, (0, 0), (2, 0), (0, 1), (3, 1)), [
        zero,  # none: the first of the picture
        v[0, 1],  # the left one alone, as nothing is above
        np.median([zero, v[0, 0], v[0, 1]], axis=0),
        np.median([v[1, 2], v[0, 3], v[0, 2]], axis=0)])  # above to the left for to the right


def test_intra_macroblocks_predict_nothing_and_two_others_a_median_with_zero(rng):
    frame = picture(rng)
    direction = frame.direction.copy()
    direction[1] = FUTURE  # none of the past, as in an intra macroblock
    found = predicted(replace(frame, direction=direction), (1, 1))
    v = frame.displacement
    np.testing.assert_array_equal(found[0], np.median([v[COLUMNS], np.zeros(2), v[2]], axis=0))


def test_the_parts_of_a_macroblock_that_touch_predict(rng):
    """Of one above in four parts the lower left one, of one to the left the upper right one."""
    whole = picture(rng)
    for split, part, neighbour in ((1, 2, 'above'), (COLUMNS, 1, 'left')):
        corners = np.array([[-4, -4], [4, -4], [-4, 4], [4, 4]], np.float32)
        parts = rng.integers(-40, 40, (4, 2)).astype(np.float32) / 4
        rest = np.arange(COLUMNS * ROWS) != split
        frame = replace(
            whole, x=np.r_[whole.x[rest], whole.x[split] + corners],
            displacement=np.r_[whole.displacement[rest], parts],
            direction=np.full(len(rest) + 3, PAST, np.int8),
            block=np.r_[whole.block[rest], np.full((4, 2), 8, np.uint8)])
        v = whole.displacement
        around = {'above': [v[COLUMNS], parts[part], v[2]],
                  'left': [parts[part], v[1], v[2]]}[neighbour]
        own = np.array([COLUMNS])  # one row less before it
        found = evidence_reference.predicted(frame, own, PAST)
        np.testing.assert_array_equal(found[0], np.median(around, axis=0))


@pytest.mark.parametrize(('gap', 'rise'), [(0.0, 8.0), (0.25, 4.0), (0.5, 2.0), (2.0, 8 / 256)])
def test_a_vector_near_its_prediction_tells_of_a_point_above(rng, gap, rise):
    frame = picture(rng)
    own = COLUMNS + 1
    frame.displacement[own] = predicted(frame, (1, 1))[0] + [0, gap]
    np.testing.assert_allclose(formulas.leaning(frame)[own], -rise)


def test_vectors_of_a_b_picture_are_predicted_from_those_of_the_same_direction(rng):
    past, own = picture(rng), COLUMNS + 1
    future = replace(past, displacement=past.displacement[::-1].copy())
    both = replace(past, frame_type=FrameType.B, x=np.r_[past.x, future.x],
                   displacement=np.r_[past.displacement, future.displacement],
                   direction=np.repeat(np.int8([PAST, FUTURE]), len(past)),
                   block=np.r_[past.block, future.block])
    for first, alone in ((0, past), (len(past), future)):
        both.displacement[first + own] = predicted(alone, (1, 1))[0]
    leaning = formulas.leaning(both)
    np.testing.assert_array_equal(leaning[[own, len(past) + own]], [-10.5, -10.5])
    assert np.sum(leaning < -10) == 2


def test_nothing_leans_where_the_prediction_is_unknown(rng):
    frame = picture(rng)
    assert not formulas.leaning(replace(frame, is_predicted=False)).any()
    assert not formulas.leaning(replace(frame, references=2)).any()
    half = picture(rng, block=np.full((COLUMNS * ROWS, 2), (16, 8), np.uint8))
    assert not formulas.leaning(half).any()
