from dataclasses import dataclass

from mv_slapse.config import Checked, setting
from mv_slapse.errors import UsageError
from mv_slapse.nodes.settings import FrameSettings, NODE_SETTINGS, require
import pytest

pytest.importorskip('rclpy')

from mv_slapse.nodes import parameters  # noqa: E402
from rclpy.node import Node  # noqa: E402


@dataclass(frozen=True)
class Made(Checked):
    gain: float = setting(1.5, 'm', 'a length', 0.5, 2.0)
    number: int = setting(3, '-', 'a count', 1)
    name: str = setting('x', '-', 'a name')
    on: bool = setting(True, '-', 'a switch')
    pose: tuple = setting((0.0, 1.0), 'm', 'numbers')


def declare(bench, **values):
    def node_type(**kwargs):
        node = Node('made', **kwargs)
        node.made = parameters.declare(node, [('part', Made)])[Made]
        return node

    return bench.start(node_type, **{f'part__{k}': v for k, v in values.items()})


def test_defaults_and_descriptions_come_from_the_settings(bench):
    node = declare(bench)
    assert node.made == Made()
    descriptor = node.describe_parameter('part.gain')
    assert descriptor.description == '[m] a length'
    assert descriptor.read_only
    bounds = descriptor.floating_point_range[0]
    assert (bounds.from_value, bounds.to_value) == (0.5, 2.0)
    assert node.describe_parameter('part.number').integer_range[0].from_value == 1


def test_given_values_reach_the_settings(bench):
    node = declare(bench, gain=0.75, number=7, name='y', on=False, pose=[2.0, 3.0])
    assert node.made == Made(0.75, 7, 'y', False, (2.0, 3.0))


@pytest.mark.parametrize(('name', 'value', 'said'), [
    ('gain', 2.5, r'part\.gain, \[m\] a length.*Min: 0\.5, Max: 2\.0, value: 2\.5'),
    ('number', 0, r'part\.number, .*Min: 1'),
    ('gain', 'much', r'part\.gain has the wrong type.*float such as 1\.5'),
    ('pose', 'here', r'part\.pose has the wrong type')])
def test_a_bad_value_is_refused_with_its_name_and_the_bounds(bench, name, value, said):
    with pytest.raises(UsageError, match=said):
        declare(bench, **{name: value})


def test_an_integer_is_a_float_as_well(bench):
    node = declare(bench, gain=1)
    assert node.made == Made(gain=1.0)
    assert node.get_parameter('part.gain').value == 1.0
    with pytest.raises(UsageError, match=r'part\.gain.*Max: 2\.0'):
        declare(bench, gain=3)


def test_every_node_declares_each_name_once():
    for node, groups in NODE_SETTINGS.items():
        names = [(prefix, item) for prefix, kind in groups for item in kind.__dataclass_fields__]
        assert len(names) == len(set(names)), node


@pytest.mark.parametrize('pose', [(0.0,) * 6, (1.0, 0, 0, 0, 0, 0, 0), (0.0, 0, 0, 0, 0, 0, 2)])
def test_a_pose_of_the_camera_that_is_none_is_refused(pose):
    with pytest.raises(UsageError, match='base_from_camera'):
        FrameSettings(base_from_camera=pose)


def test_a_choice_that_is_none_is_refused_with_the_choices():
    with pytest.raises(UsageError, match='input_type.*choose one of auto, image'):
        require('input_type', 'jpg', ('auto', 'image'))
