from dataclasses import fields as attributes
from dataclasses import is_dataclass, replace
from types import SimpleNamespace

import made_up
from mv_slapse import fields
from mv_slapse.records import Label, ScaleStatus
from mv_slapse.ros_frames import RosFrames
import numpy as np
from numpy.testing import assert_allclose
import pytest


@pytest.fixture
def frames(rng) -> RosFrames:
    return RosFrames(R_base_from_cam=made_up.rotation(rng), t_base_from_cam=rng.normal(size=3),
                     R_odom_from_start=made_up.rotation(rng), t_odom_from_start=rng.normal(size=3))


def as_message(value):
    """Nest namespaces as messages nest; stands for both ROS' and the bags' classes."""
    if isinstance(value, dict):
        return SimpleNamespace(**{name: as_message(item) for name, item in value.items()})
    return [as_message(item) for item in value] if isinstance(value, list) else value


def assert_same(actual, expected):
    assert type(actual) is type(expected)
    if is_dataclass(expected):
        for item in attributes(expected):
            assert_same(getattr(actual, item.name), getattr(expected, item.name))
    elif isinstance(expected, tuple | list):
        assert len(actual) == len(expected)
        for a, b in zip(actual, expected, strict=True):
            assert_same(a, b)
    elif isinstance(expected, np.ndarray):
        assert actual.dtype == expected.dtype
        assert_allclose(actual, expected, atol=1e-9)
    elif isinstance(expected, float):
        assert actual == pytest.approx(expected, abs=1e-9)
    else:
        assert actual == expected


def test_correspondences_come_back_as_they_were(rng, frames):
    record = made_up.correspondences(rng)
    msg = as_message(fields.correspondences_to_fields(record, frames))
    assert_same(fields.correspondences_from_message(msg), record)


def test_an_empty_pair_comes_back_empty(rng, frames):
    record = made_up.correspondences(rng, n=0)
    msg = as_message(fields.correspondences_to_fields(record, frames))
    assert_same(fields.correspondences_from_message(msg), record)


def test_what_may_move_comes_back_as_it_was(rng, frames):
    record = made_up.extraction(rng)
    record = replace(record, planes=(*record.planes, made_up.observation(rng, Label.UNKNOWN, -2)),
                     plane_id=rng.choice([-2, -1, 7, 9], len(record.x_cur)).astype(np.int32))
    msg = as_message(fields.extraction_to_fields(record, frames))
    assert_same(fields.extraction_from_message(msg), record)


def test_an_extraction_comes_back_as_it_was(rng, frames):
    record = made_up.extraction(rng)
    msg = as_message(fields.extraction_to_fields(record, frames))
    assert_same(fields.extraction_from_message(msg), record)


def test_a_scene_comes_back_from_odometry_and_map(rng, frames):
    record = made_up.scene(rng)
    odometry = as_message(fields.odometry_to_fields(record, frames))
    plane_map = as_message(fields.plane_map_to_fields(record, frames))
    assert_same(fields.scene_from_messages(odometry, plane_map, frames, record.baseline), record)


def test_obstacles_come_back_as_they_were(rng, frames):
    record = made_up.obstacle(rng)
    msg = as_message(fields.obstacles_to_fields(record.stamp, [record], ScaleStatus.METRIC,
                                                frames))
    assert_same(fields.obstacles_from_message(msg, frames), [record])
    assert msg.scale_status == 1


def test_a_handover_comes_back_as_it_was(rng, frames):
    record = made_up.handover(rng)
    msg = as_message(fields.handover_to_fields(record, frames))
    assert_same(fields.handover_from_message(msg, frames), record)
    assert msg.to_label == Label.MOVING


def test_columns_have_the_types_of_the_messages(rng):
    msg = fields.extraction_to_fields(made_up.extraction(rng), RosFrames())
    assert {msg[name].dtype for name in ('x_cur', 'y_prev', 'sigma')} == {np.dtype(np.float32)}
    assert msg['block_width'].dtype == np.uint8
    assert msg['label'].dtype == np.int8
    assert msg['plane_id'].dtype == np.int32


def test_headers_name_stamp_and_frame(rng):
    record = made_up.scene(rng, stamp=1_700_000_001_500_000_003)
    odometry = fields.odometry_to_fields(record, RosFrames('map', 'robot', 'eye'))
    assert odometry['header'] == {'stamp': {'sec': 1_700_000_001, 'nanosec': 500_000_003},
                                  'frame_id': 'map'}
    assert odometry['child_frame_id'] == 'robot'
    assert fields.twist_to_fields(record, RosFrames())['header']['frame_id'] == 'camera_link'


def test_a_drive_straight_on_is_along_x_in_odom_and_in_the_twist(rng):
    record = made_up.scene(rng)
    ahead = np.array([0.0, 0.0, 2.0])
    values = {**vars(record), 'R_world_from_cam': np.eye(3), 't_world_from_cam': ahead,
              'velocity_world': ahead}
    odometry = fields.odometry_to_fields(type(record)(**values), RosFrames())
    assert odometry['pose']['pose']['position'] == {'x': 2.0, 'y': 0.0, 'z': 0.0}
    assert odometry['pose']['pose']['orientation'] == {'x': 0.0, 'y': 0.0, 'z': 0.0, 'w': 1.0}
    assert odometry['twist']['twist']['linear'] == {'x': 2.0, 'y': 0.0, 'z': 0.0}


def test_transforms_chain_from_odom_to_the_camera(rng, frames):
    record = made_up.scene(rng)
    base = as_message(fields.transform_to_fields(record, frames))
    camera = as_message(fields.camera_transform_to_fields(record.stamp, frames))
    assert (base.header.frame_id, base.child_frame_id) == (frames.odom, frames.base)
    assert (camera.header.frame_id, camera.child_frame_id) == (frames.base, frames.camera)
    t = camera.transform.translation
    assert_allclose([t.x, t.y, t.z], frames.t_base_from_cam)
