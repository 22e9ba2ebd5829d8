from mv_slapse.codec.evidence import collect, halves, is_ambiguous
from mv_slapse.codec.motion_vectors import FrameVectors
from mv_slapse.codec.segments import Segment
from mv_slapse.config import DecoderSettings
from mv_slapse.records import FrameType, SegmentKind
import numpy as np

WIDTH, HEIGHT = 160, 128
SETTINGS = DecoderSettings()
GRID = 16 * np.mgrid[0:8, 0:10][::-1].reshape(2, -1).T.astype(np.float32) + np.float32(7.5)
MOTION = np.array([6, -3], np.float32)  # px, from key frame k to k-1


def frame(stamp, kind, *vectors, **columns):
    """A picture whose blocks all have the given (direction, displacement) vectors."""
    x = np.tile(GRID, (len(vectors), 1))
    values = {'x': x, 'displacement': np.repeat([v for _, v in vectors], len(GRID), axis=0).astype(
        np.float32) if vectors else x[:0], 'direction': np.repeat(
            [d for d, _ in vectors], len(GRID)).astype(np.int8),
        'block': np.full((len(x), 2), 16, np.uint8)}
    return FrameVectors(stamp, kind, WIDTH, HEIGHT, **{**values, **columns})


def segment(*between, current=None, end=400):
    current = frame(end, FrameType.P, (-1, MOTION)) if current is None else current
    kind = SegmentKind.IP if current.frame_type is FrameType.P else SegmentKind.PI
    return Segment(frame(0, FrameType.I), current, between, kind)


def b_frame(stamp, **columns):
    """A B frame of a uniform motion over 400."""
    share = stamp / 400
    return frame(stamp, FrameType.B, (-1, share * MOTION), (1, (share - 1) * MOTION), **columns)


def test_direct_evidence_is_the_vectors_of_the_p_frame():
    evidence = collect(segment(), SETTINGS)
    np.testing.assert_array_equal(evidence.x_cur, GRID)
    np.testing.assert_array_equal(evidence.vector, np.tile(MOTION, (len(GRID), 1)))
    assert (evidence.variance == 1).all()


def test_indirect_evidence_joins_both_ends_of_a_b_block():
    i_frame = frame(400, FrameType.I)
    evidence = collect(segment(b_frame(100), current=i_frame), SETTINGS)
    np.testing.assert_allclose(evidence.vector, np.tile(MOTION, (len(GRID), 1)), atol=1e-5)
    np.testing.assert_allclose(evidence.x_cur, GRID - 0.75 * MOTION, atol=1e-5)
    assert (evidence.variance == 2).all()


def test_a_stale_vector_of_a_list_that_is_not_used_is_no_evidence():
    middle = b_frame(200)
    middle.displacement[5] = (40, 0)
    middle.displacement[len(GRID) + 9] = (0, -30)
    kept = collect(segment(middle, current=frame(400, FrameType.I)), SETTINGS)
    expected = np.delete(GRID, [5, 9], axis=0) - 0.5 * MOTION
    np.testing.assert_allclose(kept.x_cur, expected, atol=1e-5)


def test_a_block_with_one_vector_gives_no_indirect_evidence():
    only_past = frame(200, FrameType.B, (-1, MOTION / 2))
    assert len(collect(segment(only_past, current=frame(400, FrameType.I)), SETTINGS)) == 0


def test_halves_are_the_b_frames_own_vectors():
    first, second = halves(segment(b_frame(200)), SETTINGS)
    assert (first.previous.stamp, first.current.stamp) == (0, 200)
    assert (second.previous.stamp, second.current.stamp) == (200, 400)
    one, two = collect(first, SETTINGS), collect(second, SETTINGS)
    np.testing.assert_allclose(one.x_cur, GRID)
    np.testing.assert_allclose(one.vector, np.tile(MOTION / 2, (len(GRID), 1)))
    np.testing.assert_allclose(two.x_cur, GRID - MOTION / 2)
    np.testing.assert_allclose(two.vector, np.tile(MOTION / 2, (len(GRID), 1)))


def test_halves_leave_out_blocks_whose_vectors_contradict():
    middle = b_frame(200)
    middle.displacement[5] = (40, 0)
    assert [len(collect(half, SETTINGS)) for half in halves(segment(middle), SETTINGS)] == [79, 79]


def test_predicted_vectors_tell_of_a_point_above_the_middle_of_their_block():
    current = frame(400, FrameType.P, (-1, MOTION), is_predicted=True)
    for between in ((), (b_frame(200),)):
        evidence = collect(segment(*between, current=current), SETTINGS)
        rise = (GRID - evidence.x_cur[evidence.variance == 1]).reshape(8, 10, 2)
        np.testing.assert_array_equal(rise[1:, 1:], np.broadcast_to([0, 8], (7, 9, 2)))
        assert rise[0, 0].max() < 1e-3  # the first is predicted as zero


def test_the_two_vectors_of_a_b_block_tell_of_the_mean_of_their_points():
    middle = b_frame(200, is_predicted=True)
    own = 45
    middle.displacement[len(GRID) + own] += [0, 0.25]  # to the future: half as high
    evidence = collect(segment(middle, current=frame(400, FrameType.I)), SETTINGS)
    rise = GRID + middle.displacement[len(GRID):] - evidence.x_cur
    np.testing.assert_allclose(rise[[44, own]], [[0, 10.5], [0, 7.875]], atol=1e-4)


def test_the_blocks_of_halves_are_where_they_tell_of_but_stay_in_their_macroblocks():
    halves_ = halves(segment(b_frame(200, is_predicted=True)), SETTINGS)
    for half, moved in zip(halves_, (0, MOTION / 2), strict=True):
        rise = (GRID - moved - collect(half, SETTINGS).x_cur).reshape(8, 10, 2)
        np.testing.assert_allclose(rise[1:, 1:], np.broadcast_to([0, 8], (7, 9, 2)), atol=1e-5)


def test_only_several_references_are_ambiguous():
    assert not is_ambiguous(segment(b_frame(200)))
    assert is_ambiguous(segment(b_frame(200, references=2)))
    assert is_ambiguous(segment(current=frame(400, FrameType.P, (-1, MOTION), references=3)))


def test_of_a_pyramid_only_the_top_joins_the_key_frames():
    """The frames beside it have vectors half as long, from one key frame to the top."""
    def half(stamp):
        return frame(stamp, FrameType.B, (-1, 0.25 * MOTION), (1, -0.25 * MOTION),
                     is_reference=False)

    top = b_frame(200, is_reference=True)
    evidence = collect(segment(half(100), top, half(300), current=frame(400, FrameType.I)),
                       SETTINGS)
    np.testing.assert_allclose(evidence.vector, np.tile(MOTION, (len(GRID), 1)), atol=1e-5)
    untold = collect(segment(b_frame(100), b_frame(200), b_frame(300)), SETTINGS)
    assert len(untold) == 4 * len(GRID)
