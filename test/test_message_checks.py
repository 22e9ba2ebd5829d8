from types import SimpleNamespace

import made_up
from mv_slapse import fields
from mv_slapse.message_checks import InvalidMessage
from mv_slapse.ros_frames import RosFrames
import numpy as np
import pytest
from test_fields import as_message

NAN = float('nan')


@pytest.fixture
def rng():
    return np.random.default_rng(0)


def spoilt(column, value, at=3):
    def spoil(msg):
        changed = np.array(getattr(msg, column))
        changed[at] = value
        setattr(msg, column, changed)
    return spoil


def put(name, value):
    def spoil(msg):
        *path, last = name.split('.')
        for part in path:
            msg = getattr(msg, part)
        setattr(msg, last, value)
    return spoil


def shorter(name):
    return lambda msg: setattr(msg, name, getattr(msg, name)[:1])


PAIR = [
    (shorter('sigma'), 'length of sigma = 1: must be 30, as that of x_cur'),
    (put('kind', 99), r'kind = 99: must be one of 0 \(IP\)'),
    (spoilt('x_cur', NAN), r'x_cur\[3\] = nan: must be -1e\+06 to'),
    (spoilt('y_prev', np.inf), r'y_prev\[3\] = inf'),
    (spoilt('sigma', 0.0), r'sigma\[3\] = 0\.0: must be 0\.0001 to 10000'),
    (put('width', 2**32 - 1), 'width = 4294967295: must be 1 to 32768 px'),
    (put('height', 0), 'height = 0'),
    (lambda msg: (put('width', 32000)(msg), put('height', 32000)(msg)), 'width, height'),
    (lambda msg: (put('width', 16)(msg), put('height', 16)(msg)), 'length of x_cur = 30: must be'),
    (put('header.stamp.nanosec', 2**31), "header.stamp = '0 s 2147483648 ns'"),
    (put('header.stamp.sec', -1), "header.stamp = '-1 s"),
    (put('previous_stamp.sec', 100), 'previous_stamp = .*must be before header.stamp'),
    (put('previous_stamp', SimpleNamespace(sec=0, nanosec=399_999_999)), 'by 0.1 ms'),
]
OF_CORRESPONDENCES = [
    (put('n_b', 2**31), 'n_b = 2147483648: must be 0 to 1000'),
    (spoilt('probability', 1.5), r'probability\[3\] = 1\.5: must be 0 to 1'),
    (shorter('strip_sigma'), 'length of strip_sigma = 1: must be 10, as that of strip_x_cur'),
    (spoilt('strip_y_cur', NAN), r'strip_y_cur\[3\] = nan: must be -1e\+06 to'),
    (spoilt('strip_x_earlier', np.inf), r'strip_x_earlier\[3\] = inf'),
    (spoilt('strip_sigma', 0.0), r'strip_sigma\[3\] = 0\.0: must be 0\.0001 to 10000'),
    (put('strip_stamp.sec', -1), "strip_stamp = '-1 s")]
OF_EXTRACTIONS = [
    (put('k', np.zeros(9)), 'k = .*must be a camera matrix'),
    (spoilt('k', NAN, 0), r'k\[0\] = .*nan.*must be finite'),
    (spoilt('rotation', 0.9, 0), 'rotation = .*must be a rotation matrix'),
    (spoilt('translation', NAN, 1), r'translation\[1\]'),
    (spoilt('motion_covariance', -1.0, 0), 'diagonal of motion_covariance = -1'),
    (put('motion_status', 7), 'motion_status = 7'),
    (put('baseline_ratio', NAN), 'baseline_ratio = nan'),
    (put('baseline_ratio_sigma', -1.0), 'baseline_ratio_sigma = -1'),
    (spoilt('label', 9), r'label\[3\] = 9: must be -1 to 2'),
    (shorter('plane_id'), 'length of plane_id = 1'),
    (shorter('macroblock_plane'), 'length of macroblock_plane = 1'),
    (lambda msg: put('label', 5)(msg.planes[0]), r'planes\[\].label = 5'),
    (lambda msg: put('covariance', np.zeros(36))(msg.planes[0]),
     r'length of planes\[\].covariance = 36: must be 9'),
    (lambda msg: put('score', NAN)(msg.planes[1]), r'planes\[\].score = nan'),
    (lambda msg: put('planes', msg.planes * 6000)(msg), 'length of planes = 12000')]


@pytest.mark.parametrize(('spoil', 'said'), [*PAIR, *OF_CORRESPONDENCES])
def test_wrong_correspondences_are_refused_by_field_and_value(rng, spoil, said):
    msg = as_message(fields.correspondences_to_fields(made_up.correspondences(rng), RosFrames()))
    fields.correspondences_from_message(msg)
    spoil(msg)
    with pytest.raises(InvalidMessage, match=said):
        fields.correspondences_from_message(msg)


@pytest.mark.parametrize(('spoil', 'said'), [*PAIR, *OF_EXTRACTIONS])
def test_wrong_observations_are_refused_by_field_and_value(rng, spoil, said):
    msg = as_message(fields.extraction_to_fields(made_up.extraction(rng), RosFrames()))
    fields.extraction_from_message(msg)
    spoil(msg)
    with pytest.raises(InvalidMessage, match=said):
        fields.extraction_from_message(msg)


def test_a_broken_pair_may_have_jumped_in_time(rng):
    msg = as_message(fields.correspondences_to_fields(made_up.correspondences(rng), RosFrames()))
    msg.kind, msg.previous_stamp = 4, SimpleNamespace(sec=9, nanosec=0)
    assert fields.correspondences_from_message(msg).previous_stamp == 9_000_000_000


@pytest.mark.parametrize(('spoil', 'said'), [
    (put('pose.pose.orientation.w', 5.0), 'pose.orientation'),
    (put('pose.pose.position.x', NAN), r'pose.position\[0\] = .*nan'),
    (put('twist.twist.angular.z', np.inf), r'twist.twist.angular\[2\]'),
    (lambda msg: put('covariance', np.full(36, NAN))(msg.pose), r'pose.covariance\[0\]')])
def test_a_wrong_pose_is_refused_by_field_and_value(rng, spoil, said):
    scene = made_up.scene(rng)
    odometry = as_message(fields.odometry_to_fields(scene, RosFrames()))
    plane_map = as_message(fields.plane_map_to_fields(scene, RosFrames()))
    spoil(odometry)
    with pytest.raises(InvalidMessage, match=said):
        fields.scene_from_messages(odometry, plane_map, RosFrames())


@pytest.mark.parametrize(('spoil', 'said'), [
    (put('tracking', 9), 'tracking = 9'), (put('scale_status', 3), 'scale_status = 3'),
    (lambda msg: put('depth', NAN)(msg.planes[0]), r'planes\[\].depth = nan'),
    (lambda msg: put('outline', msg.planes[0].outline * 9999)(msg.planes[0]),
     'length of outline = 39996')])
def test_a_wrong_map_is_refused_by_field_and_value(rng, spoil, said):
    scene = made_up.scene(rng)
    odometry = as_message(fields.odometry_to_fields(scene, RosFrames()))
    plane_map = as_message(fields.plane_map_to_fields(scene, RosFrames()))
    spoil(plane_map)
    with pytest.raises(InvalidMessage, match=said):
        fields.scene_from_messages(odometry, plane_map, RosFrames())


@pytest.mark.parametrize(('spoil', 'said'), [
    (put('to_label', 77), 'to_label = 77'), (put('plane', np.full(3, NAN)), r'plane\[0\]'),
    (put('velocity', np.zeros(2)), 'length of velocity = 2: must be 3')])
def test_a_wrong_handover_is_refused_by_field_and_value(rng, spoil, said):
    msg = as_message(fields.handover_to_fields(made_up.handover(rng), RosFrames()))
    spoil(msg)
    with pytest.raises(InvalidMessage, match=said):
        fields.handover_from_message(msg, RosFrames())


@pytest.mark.parametrize('speed', [NAN, 2000.0, -np.inf])
def test_a_speed_that_no_vehicle_has_is_refused(rng, speed):
    odometry = as_message(fields.odometry_to_fields(made_up.scene(rng), RosFrames()))
    odometry.twist.twist.linear.x = speed
    with pytest.raises(InvalidMessage, match=r'twist.twist.linear\[0\]'):
        fields.speed_from_message(odometry)
