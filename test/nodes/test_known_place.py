"""map_file and ~/load_map: poses in the frame of an earlier run's map, where it is found again."""

from dataclasses import replace
import json
from pathlib import Path

import pytest

pytest.importorskip('rclpy')
pytest.importorskip('mv_slapse_msgs')

import known_walls as walls  # noqa: E402
from mv_slapse.errors import UnusableInput  # noqa: E402
from mv_slapse.level import levelled  # noqa: E402
from mv_slapse.nodes.known_place import KnownPlace  # noqa: E402
from mv_slapse.nodes.placement import Placement  # noqa: E402
from mv_slapse.nodes.scene_output import SceneOutput  # noqa: E402
from mv_slapse.nodes.shell import Shell  # noqa: E402
from mv_slapse.ros_frames import pose_to_odom, RosFrames  # noqa: E402
from mv_slapse.storage.archives import map_content, read_map, write_json  # noqa: E402
from mv_slapse_msgs.msg import PlaneMap  # noqa: E402
from nav_msgs.msg import Odometry  # noqa: E402
from nodes.bench import LATCHED, messages_of, value_of  # noqa: E402
import numpy as np  # noqa: E402
from rclpy.parameter import Parameter  # noqa: E402
from std_srvs.srv import Trigger  # noqa: E402

SECOND = 10**9
TRUE = walls.pose(np.random.default_rng(5))


class Output(Shell):
    """What slam does with the scenes of its filter."""

    def __init__(self, **kwargs):
        super().__init__('slam', **kwargs)
        self.placement = Placement(self)
        self.output, self.known = SceneOutput(self), KnownPlace(self, self.placement)

    def restart(self):
        self.placement.restart()
        self.known.restart()

    def take(self, scene):
        frames = self.known.look(scene, RosFrames())
        self.output.publish(scene, frames, self.placement)


@pytest.fixture
def saved(tmp_path):
    """The map of a run that began at the origin."""
    planes = walls.seen(walls.CORNER, walls.ORIGIN, 3)
    write_json(tmp_path / 'map.json', map_content(walls.scene(planes), planes))
    return str(tmp_path / 'map.json')


def position(msg):
    p = msg.pose.pose.position
    return np.array([p.x, p.y, p.z])


def scenes():
    """Return what a run sees that began elsewhere: the wall ahead, which tells all, comes late."""
    street = walls.seen(walls.STREET, TRUE, 4)
    corner = walls.seen(walls.CORNER, TRUE, 4)
    return [walls.scene(street, SECOND), walls.scene(corner, 2 * SECOND),
            walls.scene(corner, 3 * SECOND)]


def test_odom_becomes_the_frame_of_the_map_once_it_is_found_again(bench, saved):
    odometry = bench.listen(Odometry, 'odometry')
    maps = bench.listen(PlaneMap, 'planes/map', LATCHED)
    node = bench.start(Output, map_file=saved)
    assert bench.spin(lambda: bench.peer.count_publishers('/odometry'))
    bench.spin(lambda: False, 0.3)
    node.take(scenes()[0])
    assert value_of(node, 'condition') == 'unplaced'
    assert 'do not tell the place in every direction' in messages_of(node)
    for scene in scenes()[1:]:
        node.take(scene)
    assert bench.spin(lambda: len(odometry) == 3 and len(maps) == 3)
    assert value_of(node, 'condition') == 'working'
    assert value_of(node, 'known map').startswith('found again by 4 planes, within ')
    assert [msg.resets for msg in maps] == [0, 1, 1]
    level = levelled(RosFrames(), read_map(saved).planes)  # as the earlier run's odom was
    true = pose_to_odom(TRUE, level)
    np.testing.assert_allclose(position(odometry[0]), level.t_odom_from_start)
    assert np.linalg.norm((position(odometry[1]) - true.t)[:2]) < 1.5
    np.testing.assert_array_equal(position(odometry[2]), position(odometry[1]))
    assert odometry[1].pose.covariance[0] > odometry[0].pose.covariance[0] + 0.01**2
    wall = maps[-1].planes[3]  # across, at 60 m in the frame of the map
    assert wall.normal.x == pytest.approx(-1, abs=0.02)
    assert wall.depth == pytest.approx(60, abs=1)


def test_after_a_reset_it_is_looked_for_again(bench, saved):
    node = bench.start(Output, map_file=saved)
    for scene in scenes():
        node.take(scene)
    assert bench.call(Trigger, '/slam/reset').success
    before = node.placement.start(RosFrames()).t
    np.testing.assert_array_equal(before, np.zeros(3))
    node.take(scenes()[1])
    assert np.linalg.norm(node.placement.start(RosFrames()).t[[0, 2]] - TRUE.t[[0, 2]]) < 1.5


def test_load_map_reads_what_the_parameter_names(bench, saved, tmp_path):
    node = bench.start(Output)
    refused = bench.call(Trigger, '/slam/load_map')
    assert (refused.success, refused.message.split(';')[0]) == (False, 'map_file is not set')
    node.set_parameters([Parameter('map_file', value=saved)])
    loaded = bench.call(Trigger, '/slam/load_map')
    assert loaded.success
    assert loaded.message.startswith('4 planes are looked for')
    node.take(scenes()[1])
    assert value_of(node, 'known map').startswith('found again')
    node.set_parameters([Parameter('map_file', value=str(tmp_path / 'none.json'))])
    refused = bench.call(Trigger, '/slam/load_map')
    assert not refused.success
    assert 'none.json cannot be read' in refused.message


@pytest.mark.parametrize('changes', [
    {'normal': [1, 1, 1]}, {'depth': float('nan')}, {'outline': [[0, 0, 1e300]]},
    {'covariance': (-np.eye(4)).tolist()}, {'normal': 'x'}, {'first_seen': None}])
def test_a_map_that_says_what_cannot_be_is_refused(saved, tmp_path, changes):
    from mv_slapse.storage.archives import read_map
    content = json.loads(Path(saved).read_text())
    content['planes'][0].update(changes)
    (tmp_path / 'other.json').write_text(json.dumps(content))
    with pytest.raises(UnusableInput, match='is no map of mv_slapse'):
        read_map(tmp_path / 'other.json')


def test_a_map_is_read_as_it_was_written(saved):
    from mv_slapse.storage.archives import read_map
    known = read_map(saved)
    assert known.is_metric
    for plane, given in zip(known.planes, walls.seen(walls.CORNER, walls.ORIGIN, 3), strict=True):
        np.testing.assert_array_equal(plane.outline, given.outline)
        assert replace(plane, normal=0, covariance=0, outline=0) == replace(
            given, normal=0, covariance=0, outline=0, n_macroblocks=0)
