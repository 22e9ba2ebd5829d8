from mv_slapse.codec.prior import at, MotionPrior
from mv_slapse.records import Correspondences, SegmentKind
import numpy as np

GRID = 16 * np.mgrid[0:8, 0:10][::-1].reshape(2, -1).T.astype(np.float32) + np.float32(7.5)
INSIDE = (np.abs(GRID - (80, 64)) < (64, 48)).all(axis=1)  # where nothing smooths across an edge
NONE = np.zeros((0, 2), np.float32)
SECOND = 10 ** 9


def pair(x, vector, seconds=0.1):
    return Correspondences(round(seconds * SECOND), 0, 160, 128, SegmentKind.PP,
                           x_cur=x, x_prev=(x + vector).astype(np.float32),
                           probability=np.full(len(x), 0.6, np.float32))


def linear(x):
    return (x - 70) * np.array([0.05, 0.08]) + (4, 1)


def test_nothing_is_expected_before_the_first_pair():
    assert MotionPrior().field(0.1, NONE, NONE) is None


def test_a_pair_without_vectors_changes_nothing():
    prior = MotionPrior()
    prior.add(pair(NONE, NONE))
    assert prior.field(0.1, NONE, NONE) is None


def test_the_same_motion_is_expected_again_in_proportion_to_time():
    prior = MotionPrior()
    prior.add(pair(GRID, linear(GRID)))
    expected = at(prior.field(0.3, NONE, NONE), GRID)
    np.testing.assert_allclose(expected[INSIDE], 3 * linear(GRID[INSIDE]), rtol=1e-4)


def test_a_turn_of_the_camera_shifts_what_is_expected(rng):
    prior, turn = MotionPrior(), np.array([-9, 5])
    prior.add(pair(GRID, linear(GRID)))
    vectors = linear(GRID) + turn
    wrong = rng.random(len(GRID)) < 0.3
    vectors[wrong] += rng.uniform(-60, 60, (np.count_nonzero(wrong), 2))
    field = prior.field(0.1, GRID, vectors.astype(np.float32))
    np.testing.assert_allclose(at(field, GRID)[INSIDE], linear(GRID[INSIDE]) + turn, atol=1)


def test_holes_are_filled_from_around():
    prior = MotionPrior()
    known = np.ones(len(GRID), bool)
    known[[33, 34, 44]] = False
    prior.add(pair(GRID[known], linear(GRID[known])))
    np.testing.assert_allclose(at(prior.field(0.1, NONE, NONE), GRID)[INSIDE],
                               linear(GRID[INSIDE]), atol=0.5)
