import pytest

pytest.importorskip('rclpy')
pytest.importorskip('mv_slapse_msgs')

from mv_slapse import fields  # noqa: E402
from mv_slapse.config import ExtractionSettings, SceneSettings  # noqa: E402
from mv_slapse.nodes.conversions import to_message  # noqa: E402
from mv_slapse.nodes.parameters import unknown  # noqa: E402
from mv_slapse.nodes.plane_extraction import PlaneExtractionNode  # noqa: E402
from mv_slapse.nodes.settings import (  # noqa: E402
    LatencySettings,
    NODE_SETTINGS,
    SceneOutputSettings,
)
from mv_slapse.nodes.slam import SlamNode  # noqa: E402
from mv_slapse.ros_frames import RosFrames  # noqa: E402
from mv_slapse_msgs.msg import PlaneObservations  # noqa: E402
from nav_msgs.msg import Odometry  # noqa: E402
from nodes import drives  # noqa: E402
from nodes.bench import value_of  # noqa: E402
from rcl_interfaces.srv import SetParameters  # noqa: E402
from rclpy.parameter import Parameter  # noqa: E402


def change(bench, node, **values):
    """Set parameters of a node as `ros2 param set` does; return the answers."""
    messages = [Parameter(name.replace('__', '.'), value=value).to_parameter_msg()
                for name, value in values.items()]
    return bench.call(SetParameters, f'/{node}/set_parameters', parameters=messages).results


def test_an_output_setting_changes_at_once(bench):
    node = bench.start(SlamNode, tf_wait=0.0)
    [result] = change(bench, 'slam', publish_tf=False)
    assert result.successful
    assert not node.settings[SceneOutputSettings].publish_tf
    assert node.resets == 0


def test_an_integer_is_taken_for_a_float(bench):
    node = bench.start(SlamNode, tf_wait=0.0)
    results = change(bench, 'slam', max_latency=2)
    assert [r.successful for r in results] == [True]
    assert node.settings[LatencySettings].max_latency == 2.0
    assert isinstance(node.get_parameter('max_latency').value, float)


@pytest.mark.parametrize(('values', 'said'), [
    ({'max_latency': -1.0}, 'max_latency'), ({'scene__camera_height': 'high'}, 'type'),
    ({'odom_frame': 'map'}, 'read-only'), ({'output_directory': '/'}, 'read-only'),
    ({'scene__camera_hight': 1.0}, 'undeclared')])
def test_what_cannot_be_or_is_decided_at_the_start_is_refused(bench, values, said):
    node = bench.start(SlamNode, tf_wait=0.0)
    before = dict(node.settings)
    [result] = change(bench, 'slam', **values)
    assert not result.successful
    assert said in result.reason
    assert node.settings == before


def test_a_new_setting_of_the_core_lets_its_part_begin_anew_with_it(bench):
    node = bench.start(PlaneExtractionNode)
    node._camera.camera = drives.camera()
    node.restart()
    before = node._extractor
    [result] = change(bench, 'plane_extraction', extraction__max_planes=3)
    assert result.successful
    assert node.settings[ExtractionSettings].max_planes == 3
    assert node._extractor is not before
    assert node._extractor._settings.max_planes == 3


def test_a_new_height_of_the_camera_reaches_the_filter_and_the_pose_goes_on(bench):
    odometry = bench.listen(Odometry, 'odometry')
    node = bench.start(SlamNode, tf_wait=0.0, scene__camera_height=drives.HEIGHT)
    publisher = bench.advertise(PlaneObservations, 'planes/observations')
    steps = drives.steps(4 + 2 * drives.WITHOUT_POSE)
    for step in steps[:3 + drives.WITHOUT_POSE]:
        publisher.publish(seen(step))
    assert bench.spin(lambda: len(odometry) == 3, 20)
    [result] = change(bench, 'slam', scene__camera_height=2 * drives.HEIGHT)
    assert result.successful
    assert node.settings[SceneSettings].camera_height == 2 * drives.HEIGHT
    for step in steps[3 + drives.WITHOUT_POSE:]:
        publisher.publish(seen(step))
    assert bench.spin(lambda: len(odometry) == 4, 20)
    x = [msg.pose.pose.position.x for msg in odometry]
    # twice as long as before, from where the trajectory had come to
    pairs = 1 + drives.WITHOUT_POSE
    assert x[3] - x[2] == pytest.approx(2 * pairs * (x[2] - x[1]), rel=0.25)
    assert value_of(node, 'resets') == '1'


def seen(step):
    return to_message(PlaneObservations, fields.extraction_to_fields(
        step.extraction, RosFrames(camera='cam')))


def test_unknown_parameters_are_told_with_the_nearest_name(bench):
    node = bench.start(SlamNode, tf_wait=0.0, scene__camera_hight=1.0, source='film.mp4', zzz=1)
    assert unknown(node) == [
        'parameter scene.camera_hight is unknown and not used: did you mean scene.camera_height?',
        'parameter zzz is unknown and not used: docs/parameters.md lists all']


def test_every_node_has_a_bound_of_its_latency():
    assert all(('', LatencySettings) in groups for groups in NODE_SETTINGS.values())
