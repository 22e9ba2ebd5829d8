import dataclasses

import made_up
from mv_slapse import fields
from mv_slapse.errors import UnusableInput
from mv_slapse.records import Extraction
from mv_slapse.ros_frames import RosFrames
import numpy as np
import pytest

pytest.importorskip('rclpy')
pytest.importorskip('mv_slapse_msgs')

from mv_slapse.nodes import conversions  # noqa: E402
from mv_slapse_msgs import msg as messages  # noqa: E402
from nav_msgs.msg import Odometry  # noqa: E402
from rclpy.serialization import deserialize_message, serialize_message  # noqa: E402
from sensor_msgs.msg import CameraInfo  # noqa: E402

FRAMES = RosFrames(t_base_from_cam=np.array([0.5, -0.1, 1.6]))


def over_the_wire(message_type, values):
    msg = conversions.to_message(message_type, values)
    return deserialize_message(serialize_message(msg), message_type)


def assert_same(record, expected):
    for name, value in vars(expected).items():
        if isinstance(value, np.ndarray):
            np.testing.assert_allclose(getattr(record, name), value, atol=1e-9, err_msg=name)
            assert getattr(record, name).dtype == value.dtype, name
        elif not isinstance(value, tuple) and not hasattr(value, '__dict__'):
            assert getattr(record, name) == pytest.approx(value), name


def test_correspondences_arrive_bit_for_bit(rng):
    record = made_up.correspondences(rng)
    msg = over_the_wire(messages.Correspondences,
                        fields.correspondences_to_fields(record, FRAMES))
    back = fields.correspondences_from_message(msg)
    for name in ('x_cur', 'x_prev', 'sigma', 'probability', 'block'):
        np.testing.assert_array_equal(getattr(back, name), getattr(record, name))
    for name in ('x_cur', 'x_earlier', 'sigma'):
        np.testing.assert_array_equal(getattr(back.strips, name), getattr(record.strips, name))
    assert back.strips.stamp == record.strips.stamp
    assert msg.header.frame_id == 'camera_optical'
    assert_same(back, record)


def test_columns_travel_as_arrays_not_as_lists(rng):
    values = fields.correspondences_to_fields(made_up.correspondences(rng), FRAMES)
    msg = conversions.to_message(messages.Correspondences, values)
    assert msg.x_cur.typecode == 'f'
    assert msg.x_cur[3] == values['x_cur'][3]


def test_extractions_arrive_with_their_planes(rng):
    record = made_up.extraction(rng)
    back = fields.extraction_from_message(over_the_wire(
        messages.PlaneObservations, fields.extraction_to_fields(record, FRAMES)))
    assert_same(back, record)
    assert_same(back.motion, record.motion)
    assert len(back.planes) == 2
    for plane, expected in zip(back.planes, record.planes, strict=True):
        assert_same(plane, expected)


def test_every_number_of_an_extraction_travels(rng):
    numbers = {f.name: 1.25 for f in dataclasses.fields(Extraction) if f.type is float}
    record = dataclasses.replace(made_up.extraction(rng), **numbers)
    assert_same(fields.extraction_from_message(over_the_wire(
        messages.PlaneObservations, fields.extraction_to_fields(record, FRAMES))), record)


def test_a_scene_arrives_as_odometry_and_map(rng):
    scene = made_up.scene(rng)
    odometry = over_the_wire(Odometry, fields.odometry_to_fields(scene, FRAMES))
    plane_map = over_the_wire(messages.PlaneMap, fields.plane_map_to_fields(scene, FRAMES))
    back = fields.scene_from_messages(odometry, plane_map, FRAMES, scene.baseline)
    assert_same(back, scene)
    assert_same(back.planes[0], scene.planes[0])


def test_obstacles_and_handovers_arrive(rng):
    obstacle, handover = made_up.obstacle(rng), made_up.handover(rng)
    msg = over_the_wire(messages.ObstacleArray, fields.obstacles_to_fields(
        obstacle.stamp, [obstacle], 1, FRAMES))
    assert_same(fields.obstacles_from_message(msg, FRAMES)[0], obstacle)
    msg = over_the_wire(messages.PlaneHandover, fields.handover_to_fields(handover, FRAMES))
    assert_same(fields.handover_from_message(msg, FRAMES), handover)


def camera_info(**changes):
    info = CameraInfo(width=640, height=480, distortion_model='plumb_bob')
    info.k[:] = [500.0, 0, 320, 0, 510, 240, 0, 0, 1]
    info.d = [0.1, -0.2, 0.0, 0.0, 0.05]
    for name, value in changes.items():
        setattr(info, name, value)
    return info


def test_a_camera_is_read_from_its_message():
    camera = fields.camera_from_message(camera_info())
    assert (camera.width, camera.height) == (640, 480)
    np.testing.assert_array_equal(camera.K, [[500, 0, 320], [0, 510, 240], [0, 0, 1]])
    np.testing.assert_array_equal(camera.distortion, [0.1, -0.2, 0, 0, 0.05])


def test_binning_and_region_of_interest_move_the_intrinsics():
    info = camera_info(binning_x=2, binning_y=2)
    info.roi.x_offset, info.roi.y_offset, info.roi.width, info.roi.height = 40, 20, 400, 300
    camera = fields.camera_from_message(info)
    assert (camera.width, camera.height) == (200, 150)
    # the ray of full-resolution pixel 41.5, between the first two binned columns 40..43
    u = (41.5 - 40 + 0.5) / 2 - 0.5
    ray = (41.5 - 320) / 500
    assert u == pytest.approx(camera.K[0, 0] * ray + camera.K[0, 2])


def test_a_region_of_interest_may_be_in_the_corner():
    info = camera_info()
    info.roi.x_offset, info.roi.y_offset, info.roi.width, info.roi.height = 0, 416, 64, 64
    camera = fields.camera_from_message(info)
    np.testing.assert_array_equal(camera.K[:2, 2], (320, 240 - 416))


def test_an_uncalibrated_camera_is_refused_by_name():
    info = camera_info()
    info.k[:] = 0.0
    with pytest.raises(UnusableInput, match='front/camera_info.*not calibrated'):
        fields.camera_from_message(info, 'front/camera_info')


def test_covariances_are_neither_zero_nor_without_bound():
    C = np.reshape(conversions.bounded_covariance(np.diag([0, 1, 1e308, 4, 0, 1e12])), (6, 6))
    assert np.diag(C).min() > 0
    assert np.diag(C).max() < 1e7
    np.testing.assert_allclose(np.diag(C)[[1, 3]], [1, 4], rtol=1e-6)


def test_bounding_keeps_a_covariance_definite(rng):
    A = rng.normal(size=(6, 6)) * np.logspace(-6, 8, 6)[:, None]
    C = np.reshape(conversions.bounded_covariance((A @ A.T).ravel()), (6, 6))
    assert np.linalg.eigvalsh(C).min() > -1e-6
