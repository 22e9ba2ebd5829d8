from pathlib import Path

import made_up
from mv_slapse import fields
from mv_slapse.errors import UnusableInput
from mv_slapse.ros_frames import RosFrames
from mv_slapse.storage import messages
import numpy as np
import pytest
from rosbags.typesys import get_types_from_msg

FRAMES = RosFrames()
EXTERNAL = Path(__file__).parents[1] / 'interfaces'


def through_cdr(name, values):
    return messages.typestore().deserialize_cdr(messages.serialize(name, values), name)


def test_a_message_survives_serialisation(rng):
    record = made_up.extraction(rng)
    msg = through_cdr('mv_slapse_msgs/msg/PlaneObservations',
                      fields.extraction_to_fields(record, FRAMES))
    again = fields.extraction_from_message(msg)
    np.testing.assert_array_equal(again.x_prev, record.x_prev)
    np.testing.assert_array_equal(again.plane_id, record.plane_id)
    np.testing.assert_array_equal(again.planes[1].covariance, record.planes[1].covariance)
    assert again.label.dtype == np.int8
    assert (again.reason, again.motion.status) == (record.reason, record.motion.status)


def test_a_pose_survives_serialisation(rng):
    scene = made_up.scene(rng)
    odometry = through_cdr('nav_msgs/msg/Odometry', fields.odometry_to_fields(scene, FRAMES))
    plane_map = through_cdr('mv_slapse_msgs/msg/PlaneMap',
                            fields.plane_map_to_fields(scene, FRAMES))
    again = fields.scene_from_messages(odometry, plane_map, FRAMES)
    np.testing.assert_allclose(again.t_world_from_cam, scene.t_world_from_cam, atol=1e-12)
    np.testing.assert_allclose(again.planes[0].outline, scene.planes[0].outline, atol=1e-12)


def test_a_field_that_is_not_given_is_zero_or_empty():
    msg = through_cdr('visualization_msgs/msg/Marker', {'id': 3})
    assert (msg.id, msg.ns, msg.type, msg.frame_locked, list(msg.points)) == (3, '', 0, False, [])
    odometry = through_cdr('nav_msgs/msg/Odometry', {})
    np.testing.assert_array_equal(odometry.pose.covariance, np.zeros(36))


def test_a_field_that_does_not_exist_is_refused():
    with pytest.raises(KeyError, match='Vector3 has no field w'):
        messages.to_message('geometry_msgs/msg/Vector3', {'x': 1.0, 'w': 1.0})


def test_every_message_of_the_package_is_known():
    names = {path.stem for path in messages.definition_folder().glob('*.msg')}
    assert {'Correspondences', 'PlaneObservations', 'PlaneMap', 'ObstacleArray',
            'PlaneHandover'} <= names
    assert {f'mv_slapse_msgs/msg/{name}' for name in names} <= set(messages.typestore().types)


@pytest.mark.parametrize('name', ['ffmpeg_image_transport_msgs/msg/FFMPEGPacket',
                                  'foxglove_msgs/msg/CompressedVideo',
                                  'tf2_msgs/msg/TFMessage'])
def test_messages_of_other_packages_are_as_their_definitions(name):
    package, _, message = name.split('/')
    text = (EXTERNAL / package / 'msg' / f'{message}.msg').read_text()
    expected = get_types_from_msg(text, name)[name]
    assert messages.typestore().fielddefs[name] == expected


def test_definitions_are_found_in_an_installed_share_folder(tmp_path, monkeypatch):
    share = tmp_path / 'share' / 'mv_slapse_msgs' / 'msg'
    share.mkdir(parents=True)
    (share / 'Correspondences.msg').touch()
    module = tmp_path / 'lib' / 'python3' / 'site-packages' / 'mv_slapse' / 'storage' / 'm.py'
    monkeypatch.setattr(messages, '__file__', str(module))
    assert messages.definition_folder() == share


def test_missing_definitions_are_named(tmp_path, monkeypatch):
    monkeypatch.setattr(messages, '__file__', str(tmp_path / 'a' / 'b' / 'c.py'))
    monkeypatch.setattr(messages.sys, 'prefix', str(tmp_path))
    monkeypatch.setenv('AMENT_PREFIX_PATH', '')
    with pytest.raises(UnusableInput, match='mv_slapse_msgs are not found; install'):
        messages.definition_folder()
