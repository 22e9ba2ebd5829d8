"""A short form of losses.py: lost packets tear the pairs over them, in every codec."""

import pytest
from reliability import clips, losses


@pytest.mark.parametrize('kind', clips.KINDS, ids=lambda kind: kind.name)
def test_a_pair_over_lost_packets_is_torn_and_no_clean_one_is(kind):
    packets = clips.drawn(kind, 75)
    found = losses.measure(packets, [(first, n) for first, n in (
        (26, 1), (31, 2), (36, 3), (30, 5), (37, 7), (41, 15))])
    assert not found['missed']
    assert found['over'] >= 6
    assert losses.false_alarms(packets)[0] == 0
    assert losses.false_alarms(clips.uneven(packets))[0] == 0


@pytest.mark.parametrize('name', ['h264-b0', 'mpeg2-b2', 'h264-pyramid'])
def test_a_camera_that_leaves_out_pictures_before_the_encoder_loses_none(name):
    kind = next(kind for kind in clips.KINDS if kind.name == name)
    packets = clips.paused(clips.drawn(kind, 75), (20, 33, 34, 51))
    assert losses.false_alarms(packets)[0] == 0


def test_a_new_rate_is_taken_for_a_loss_a_few_times_only():
    kind = next(kind for kind in clips.KINDS if kind.name == 'mpeg4-b0')
    packets = clips.paused(clips.drawn(kind, 75), range(30, 75), pause=2)
    assert 1 <= losses.false_alarms(packets)[0] <= 3
