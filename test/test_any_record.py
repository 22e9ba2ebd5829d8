"""Any record goes into messages and their bytes, and comes back; any wrong value is refused.

HYPOTHESIS_EXAMPLES sets how many of each are tried.
"""

from contextlib import suppress
from dataclasses import fields as attributes
from dataclasses import is_dataclass
import os

import pytest

hypothesis = pytest.importorskip('hypothesis')

from hypothesis import given, settings  # noqa: E402
from hypothesis import strategies as st  # noqa: E402
from mv_slapse import fields  # noqa: E402
from mv_slapse.message_checks import InvalidMessage  # noqa: E402
from mv_slapse.records import ScaleStatus  # noqa: E402
from mv_slapse.storage import messages  # noqa: E402
import numpy as np  # noqa: E402
import strategies as s  # noqa: E402

EXAMPLES = int(os.environ.get('HYPOTHESIS_EXAMPLES', '15'))
some = settings(max_examples=EXAMPLES, derandomize=True, deadline=None, database=None,
                suppress_health_check=list(hypothesis.HealthCheck))
OURS = 'mv_slapse_msgs/msg/'
ODD = st.sampled_from([float('nan'), float('inf'), -1e300, -1, 2**31, '', [], [1.0] * 7, None])


def there_and_back(name, values):
    """Return the message that the bytes of a message give."""
    return messages.typestore().deserialize_cdr(messages.serialize(name, values), name)


def same(actual, expected, scale=1.0):
    """Compare records; places to some digits of how far away they are."""
    assert type(actual) is type(expected)
    if is_dataclass(expected):
        for item in attributes(expected):
            same(getattr(actual, item.name), getattr(expected, item.name), scale)
    elif isinstance(expected, tuple | list):
        assert len(actual) == len(expected)
        for one, other in zip(actual, expected, strict=True):
            same(one, other, scale)
    elif isinstance(expected, np.ndarray | float):
        size = np.max(np.abs(expected), initial=0, where=np.isfinite(expected))
        np.testing.assert_allclose(actual, expected, rtol=0, atol=1e-9 * max(size * scale, 1))
    else:
        assert actual == expected


@given(s.correspondences(), s.frames)
@some
def test_correspondences(record, frames):
    values = fields.correspondences_to_fields(record, frames)
    msg = there_and_back(OURS + 'Correspondences', values)
    same(fields.correspondences_from_message(msg), record)


@given(s.extractions(), s.frames)
@some
def test_extractions_with_their_observations_and_motion(record, frames):
    msg = there_and_back(OURS + 'PlaneObservations', fields.extraction_to_fields(record, frames))
    same(fields.extraction_from_message(msg), record)


@given(s.scenes, s.frames)
@some
def test_scenes_with_their_planes(record, frames):
    odometry = there_and_back('nav_msgs/msg/Odometry', fields.odometry_to_fields(record, frames))
    plane_map = there_and_back(OURS + 'PlaneMap',
                               fields.plane_map_to_fields(record, frames, record.resets))
    fields.check_odometry(odometry)
    fields.check_plane_map(plane_map)
    found = fields.scene_from_messages(odometry, plane_map, frames, record.baseline)
    # turned about a point that is far away
    same(found, record, 1e6)
    assert found.resets == record.resets


@given(st.lists(s.obstacles(stamp=10**18), max_size=2), s.frames)
@some
def test_obstacles(records, frames):
    msg = there_and_back(OURS + 'ObstacleArray', fields.obstacles_to_fields(
        10**18, records, ScaleStatus.METRIC, frames))
    same(fields.obstacles_from_message(msg, frames), records, 1e6)


@given(s.handovers, s.frames)
@some
def test_handovers(record, frames):
    msg = there_and_back(OURS + 'PlaneHandover', fields.handover_to_fields(record, frames))
    same(fields.handover_from_message(msg, frames), record, 1e6)


READERS = {
    'Correspondences': (s.correspondences(), fields.correspondences_to_fields,
                        fields.correspondences_from_message),
    'PlaneObservations': (s.extractions(), fields.extraction_to_fields,
                          fields.extraction_from_message),
    'PlaneMap': (s.scenes, fields.plane_map_to_fields, fields.check_plane_map),
    'PlaneHandover': (s.handovers, fields.handover_to_fields,
                      lambda msg: fields.handover_from_message(msg, fields.RosFrames()))}


def leaves(msg, path=()):
    """Yield where the values of a message stand."""
    for name in vars(msg):
        value = getattr(msg, name)
        if name.startswith('__'):
            continue
        if hasattr(value, '__dataclass_fields__'):
            yield from leaves(value, (*path, name))
        else:
            yield (*path, name)


@pytest.mark.parametrize('kind', READERS)
def test_one_odd_value_is_refused_or_read_and_never_anything_else(kind):
    records, to_fields, read = READERS[kind]

    @given(records, s.frames, st.data())
    @some
    def check(record, frames, data):
        msg = there_and_back(OURS + kind, to_fields(record, frames))
        *way, last = data.draw(st.sampled_from(sorted(leaves(msg))))
        inner = msg
        for name in way:
            inner = getattr(inner, name)
        now = getattr(inner, last)
        odd = data.draw(ODD)
        if isinstance(now, np.ndarray):
            if not len(now):
                return
            changed = now.copy() if isinstance(odd, str | list | type(None)) else now.astype(float)
            if isinstance(odd, list):
                changed = changed[:-1]
            elif not isinstance(odd, str | type(None)):
                with np.errstate(all='ignore'):
                    changed[data.draw(st.integers(0, len(now) - 1))] = odd
                    changed = changed.astype(now.dtype)
            object.__setattr__(inner, last, changed)
        elif isinstance(now, int | float) and isinstance(odd, int | float):
            whole = isinstance(now, int) and not np.isfinite(odd)
            object.__setattr__(inner, last, -1 if whole else type(now)(odd))
        with suppress(InvalidMessage):
            read(msg)

    check()
