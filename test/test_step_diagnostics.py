from dataclasses import replace

import made_up
from mv_slapse.pipeline import Step
from mv_slapse.records import ScaleStatus, SegmentKind, TrackingStatus
from mv_slapse.step_diagnostics import conditions, StepDiagnostics
import numpy as np
import pytest

SECOND = 10**9


def step(stamp=SECOND, kind=SegmentKind.IP, reason='', **scene):
    rng = np.random.default_rng(0)
    return Step(replace(made_up.correspondences(rng, stamp=stamp), kind=kind, reason='a loss'),
                replace(made_up.extraction(rng, stamp=stamp), reason=reason),
                replace(made_up.scene(rng, stamp), **scene), (made_up.obstacle(rng),), ())


@pytest.mark.parametrize(('key', 'level', 'changes'), [
    ('working', 0, {}),
    ('lost', 2, {'status': TrackingStatus.LOST, 'scale_status': ScaleStatus.UNKNOWN}),
    ('initialising', 1, {'status': TrackingStatus.INITIALISING}),
    ('predicted', 1, {'status': TrackingStatus.PREDICTED}),
    ('broken', 1, {'kind': SegmentKind.BROKEN, 'reason': 'too few'}),
    ('no_motion', 1, {'reason': 'too few'}),
    ('no_scale', 1, {'scale_status': ScaleStatus.UNKNOWN})])
def test_the_worst_condition_is_the_state(key, level, changes):
    made = step(**changes)
    assert next(iter(conditions(made))) == key
    status, = StepDiagnostics().add(made)['status']
    values = {item['key']: item['value'] for item in status['values']}
    assert (status['level'], values['condition']) == (level, key)
    assert (status['message'] == 'ok') == (key == 'working')


def test_it_is_told_once_a_second_with_counts_of_all_pairs():
    told = StepDiagnostics()
    found = [told.add(step(i * SECOND // 4, SegmentKind.BROKEN if i == 3 else SegmentKind.PP))
             for i in range(9)]
    due = [i for i, state in enumerate(found) if state]
    assert due == [0, 4, 8]
    values = {item['key']: item['value'] for item in found[4]['status'][0]['values']}
    assert (values['key frame pairs'], values['broken pairs']) == ('5', '1')


def test_a_clock_that_goes_back_does_not_silence_it():
    told = StepDiagnostics()
    assert told.add(step(1000 * SECOND))
    assert told.add(step(SECOND))
