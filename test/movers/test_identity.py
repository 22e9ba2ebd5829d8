"""The memory of movers: histories follow the vectors, and go on where there are none."""

from dataclasses import replace

from mv_slapse.movers.identity import FADING, FIRST_ID, Judged, LIFETIME, Memory
from mv_slapse.records import CameraMotion, Extraction, MotionStatus, SegmentKind
import numpy as np
import pytest

PAIR = 100_000_000  # [ns]
STEP = np.array([16.0, 0.0])  # [px] that blocks move in a pair


def extraction(x, k=1, step=STEP):
    """Return an Extraction of pair k whose blocks (N, 2) came from ``step`` to the left."""
    x = np.array(x, np.float32).reshape(-1, 2)
    n = len(x)
    return Extraction(
        (k + 1) * PAIR, k * PAIR, 320, 160, SegmentKind.PP, np.eye(3),
        CameraMotion(MotionStatus.MOVING), x_cur=x, x_prev=x - np.float32(step),
        sigma=np.full(n, 0.3, np.float32), block=np.full((n, 2), 16, np.uint8),
        label=np.zeros(n, np.int8), plane_id=np.full(n, -1, np.int32))


def remembered(x, score=8.0, k=1):
    """Return a Memory of blocks (N, 2) of one mover at the end of pair k."""
    return after(Memory(), extraction(x, k), score, score / 2, FIRST_ID, FIRST_ID + 1)


def after(memory, seen, score=0.0, left=0.0, id_=-1, next_id=None):
    """Return a Memory after a pair whose blocks have a score and an id."""
    n = len(seen.x_cur)
    judged = Judged(seen.x_cur.astype(float), seen.x_prev.astype(float), seen.block.astype(float),
                    np.full(n, score), np.full(n, left), np.full(n, id_))
    return memory.after(seen, judged, next_id or memory.next_id)


def test_an_empty_memory_knows_nothing():
    score, _, id_ = Memory().inherited(extraction([(39.5, 39.5)]))
    assert np.isnan(score).all()
    assert (id_ == -1).all()


def test_a_block_inherits_from_where_its_vector_points():
    score, left, id_ = remembered([(39.5, 39.5)]).inherited(
        extraction([(55.5, 39.5), (103.5, 39.5)], 2))
    assert (score[0], left[0]) == (8.0, 4.0)
    assert np.isnan([score[1], left[1]]).all()
    assert id_.tolist() == [FIRST_ID, -1]


def test_a_mover_without_vectors_in_a_pair_goes_on_as_it_moved():
    memory = remembered([(39.5, 39.5)])
    memory = after(memory, extraction([(200, 100)], 2))
    score, left, id_ = memory.inherited(extraction([(71.5, 39.5)], 3))
    assert (score[0], left[0]) == (8.0 * FADING, 4.0 * FADING)
    assert id_[0] == FIRST_ID


def test_what_has_a_vector_hides_what_was_there():
    memory = remembered([(39.5, 39.5)])
    memory = after(memory, extraction([(55.5, 39.5)], 2), -1.0)
    assert memory.score.tolist() == [-1.0]


def test_it_bridges_a_pair_that_never_came():
    score, _, id_ = remembered([(39.5, 39.5)]).inherited(extraction([(71.5, 39.5)], 3))
    assert score[0] == 8.0
    assert id_[0] == FIRST_ID


def test_what_leaves_the_picture_is_forgotten():
    memory = remembered([(311.5, 39.5)])
    memory = after(memory, extraction(np.zeros((0, 2)), 2))
    assert len(memory.x) == 0
    score, _, _ = remembered([(311.5, 39.5)]).inherited(extraction([(311.5, 39.5)], 3, (0, 0)))
    assert np.isnan(score[0])


@pytest.mark.parametrize(('age', 'known'), [(LIFETIME - 1, True), (LIFETIME, False)])
def test_it_lasts_half_a_second(age, known):
    memory = remembered([(39.5, 39.5)])
    later = replace(extraction([(39.5, 39.5) + age / PAIR * STEP], 2, (0, 0)),
                    previous_stamp=memory.stamp + age)
    assert np.isfinite(memory.inherited(later)[0][0]) == known


def test_time_that_runs_backwards_leaves_only_the_next_id():
    memory = remembered([(39.5, 39.5)])
    assert np.isnan(memory.inherited(extraction([(39.5, 39.5)], 0, (0, 0))).score).all()
    memory = after(memory, extraction(np.zeros((0, 2)), -1))
    assert len(memory.x) == 0
    assert memory.next_id == FIRST_ID + 1


@pytest.mark.parametrize('k', [2, 3])
def test_new_regions_get_new_ids(k):
    assert remembered([(39.5, 39.5)], k=k).next_id == FIRST_ID + 1
