from mv_slapse.codec.motion_vectors import FrameVectors
from mv_slapse.codec.segments import LONGEST, MOST_BETWEEN, SegmentBuilder
from mv_slapse.records import FrameType, SegmentKind
import numpy as np
import pytest

STEP = 40_000_000

def frames(types, **changes):
    """A picture each 40 ms for each letter, with one vector in all but I frames."""
    made = []
    for i, letter in enumerate(types):
        n = 0 if letter == 'I' else 1
        values = {'stamp': i * STEP, 'frame_type': FrameType[letter], 'width': 64, 'height': 48,
                  'x': np.zeros((n, 2), np.float32), **changes.get(f'at{i}', {})}
        made.append(FrameVectors(**values))
    return made


def segments(types, **changes):
    builder = SegmentBuilder()
    found = [builder.add(frame) for frame in frames(types, **changes)]
    return [segment for segment in found if segment]


@pytest.mark.parametrize(('types', 'kinds'), [
    ('IPP', 'IP PP'), ('IBBPBBIBP', 'IP PI IP'), ('IPBP', 'IP PP'), ('IBI', 'PI'), ('BBIP', 'IP')])
def test_kinds_are_those_of_the_key_frames_at_both_ends(types, kinds):
    assert [SegmentKind[kind] for kind in kinds.split()] == [s.kind for s in segments(types)]


def test_a_segment_holds_its_b_frames_in_order():
    segment, = segments('IBBBP')
    assert [frame.stamp for frame in segment.between] == [STEP, 2 * STEP, 3 * STEP]
    assert (segment.previous.stamp, segment.current.stamp) == (0, 4 * STEP)


def test_consecutive_segments_share_a_key_frame():
    one, two = segments('IBPBP')
    assert one.current is two.previous


def test_an_i_frame_without_b_frames_is_a_dead_segment():
    segment = segments('IPI')[1]
    assert segment.kind is SegmentKind.BROKEN
    assert 'I frame' in segment.reason


def test_damage_of_a_b_frame_breaks_only_its_segment():
    kinds = [segment.kind for segment in segments('IBPBPBP', at3={'damage': 'lost'})]
    assert kinds == [SegmentKind.IP, SegmentKind.BROKEN, SegmentKind.PP]


def test_a_change_of_size_breaks_the_segment_and_names_both():
    segment = segments('IPP', at2={'width': 32})[1]
    assert segment.kind is SegmentKind.BROKEN
    assert '64x48' in segment.reason
    assert '32x48' in segment.reason


@pytest.mark.parametrize('stamp', [STEP + 1, STEP, 0, -5])
def test_stamps_that_do_not_increase_break_the_segment(stamp):
    segment = segments('IPP', at2={'stamp': stamp})[1]
    assert segment.kind is SegmentKind.BROKEN
    assert 'stamps' in segment.reason


def test_key_frames_seconds_apart_are_not_joined():
    segment = segments('IPP', at2={'stamp': LONGEST + STEP + 1})[1]
    assert segment.kind is SegmentKind.BROKEN
    assert 'too far apart' in segment.reason
    assert segments('IPP', at2={'stamp': LONGEST + STEP})[1].kind is SegmentKind.PP


def test_an_i_frame_is_not_searched_in_pictures_that_a_loss_has_displaced():
    found = segments('IPPPIPI', at2={'damage': 'lost'})
    assert [segment.is_torn for segment in found] == [False, True, True, True, False, False]
    assert found[2].kind is SegmentKind.PP  # vectors join them all the same


def test_a_p_frame_that_is_no_reference_ends_no_segment():
    found = segments('IPPPP', at2={'is_reference': False})
    assert [segment.current.stamp // STEP for segment in found] == [1, 3, 4]
    assert [len(segment.between) for segment in found] == [0, 0, 0]
    lost = segments('IPPPP', at2={'is_reference': False, 'damage': 'lost'})
    assert lost[1].kind is SegmentKind.BROKEN


def test_b_frames_without_end_are_not_all_kept():
    segment, = segments('I' + 300 * 'B' + 'P')
    assert len(segment.between) == MOST_BETWEEN
    assert segment.kind is SegmentKind.BROKEN
