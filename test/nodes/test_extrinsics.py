from mv_slapse.ros_frames import R_BODY_FROM_OPTICAL
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

pytest.importorskip('rclpy')

from mv_slapse.nodes.extrinsics import chain, Extrinsics  # noqa: E402
from mv_slapse.nodes.shell import Shell  # noqa: E402
from nodes.bench import LATCHED  # noqa: E402


class Slam(Shell):
    def __init__(self, **kwargs):
        super().__init__('slam', **kwargs)
        self.extrinsics = Extrinsics(self)


def pose(x, yaw):
    matrix = np.eye(4)
    matrix[:3, :3] = Rotation.from_euler('z', yaw).as_matrix()
    matrix[0, 3] = x
    return matrix


def test_a_chain_of_transforms_is_multiplied_from_the_root():
    parents = {'optical': ('link', pose(1.0, np.pi / 2)), 'link': ('base', pose(2.0, 0.0)),
               'other': ('base', pose(9.0, 0.0))}
    np.testing.assert_allclose(chain(parents, 'optical', 'base')[:3, 3], [3, 0, 0])
    point = chain(parents, 'optical', 'base') @ [1, 0, 0, 1]
    np.testing.assert_allclose(point[:3], [3, 1, 0], atol=1e-12)
    assert chain(parents, 'optical', 'map') is None


def test_a_ring_of_transforms_does_not_hang():
    assert chain({'a': ('b', np.eye(4)), 'b': ('a', np.eye(4))}, 'a', 'base') is None


def test_the_parameter_gives_the_place_of_the_camera(bench):
    given = [0.5, 0.0, 1.6, -0.5, 0.5, -0.5, 0.5]
    frames = bench.start(Slam, base_from_camera=given).extrinsics.frames('cam')
    np.testing.assert_allclose(frames.R_base_from_cam, R_BODY_FROM_OPTICAL, atol=1e-12)
    np.testing.assert_allclose(frames.t_base_from_cam, [0.5, 0, 1.6])
    assert (frames.odom, frames.base, frames.camera) == ('odom', 'base_link', 'cam')


def test_nothing_known_is_said_and_only_after_the_wait(bench):
    node = bench.start(Slam, tf_wait=0.2)
    assert node.extrinsics.frames('cam') is None or not tf_installed()
    assert bench.spin(lambda: node.extrinsics.frames('cam') is not None)
    np.testing.assert_array_equal(node.extrinsics.frames('cam').R_base_from_cam,
                                  R_BODY_FROM_OPTICAL)
    said = {value.key: value.value for value in node.health.status().values}
    assert 'base_from_camera' in said['extrinsics']


def test_a_latched_static_transform_is_found(bench):
    tf2_msgs = pytest.importorskip('tf2_msgs.msg')
    from geometry_msgs.msg import TransformStamped
    transform = TransformStamped(child_frame_id='cam')
    transform.header.frame_id = 'base_link'
    transform.transform.translation.z = 1.2
    publisher = bench.peer.create_publisher(tf2_msgs.TFMessage, '/tf_static', LATCHED)
    publisher.publish(tf2_msgs.TFMessage(transforms=[transform]))
    node = bench.start(Slam, tf_wait=5.0)
    assert bench.spin(lambda: node.extrinsics.frames('cam') is not None, 4.0)
    np.testing.assert_allclose(node.extrinsics.frames('cam').t_base_from_cam, [0, 0, 1.2])


def tf_installed():
    from mv_slapse.nodes.extrinsics import tf_message_type
    return tf_message_type() is not None
