from dataclasses import replace
from types import SimpleNamespace

import made_up
from mv_slapse import fields
from mv_slapse.config import SceneSettings
from mv_slapse.nodes.scene_join import continues, SceneJoin, SceneMemory
from mv_slapse.records import ScaleStatus, Speed, TrackingStatus
from mv_slapse.ros_frames import RosFrames
from mv_slapse.scene.filter import SceneFilter
from mv_slapse.storage import messages
import numpy as np
import pytest
from scene_drive import Canyon, DT, SPEED

FRAMES = RosFrames()
OK, LOST = int(TrackingStatus.OK), int(TrackingStatus.LOST)


def message(stamp, **fields):
    time = SimpleNamespace(sec=stamp // 10**9, nanosec=stamp % 10**9)
    return SimpleNamespace(header=SimpleNamespace(stamp=time), stamp=stamp, **fields)


def through_cdr(name, values):
    return messages.typestore().deserialize_cdr(messages.serialize(name, values), name)


@pytest.fixture
def joined():
    return []


@pytest.fixture
def join(joined):
    def complete(observations, odometry, plane_map):
        joined.append((observations.stamp, odometry and odometry.stamp, plane_map.stamp))

    return SceneJoin(complete, lambda: joined.append('dropped'))


def test_messages_of_one_stamp_join_in_whatever_order_they_come(join, joined):
    join.add_map(message(1, tracking=OK))
    join.add_observations(message(2))
    join.add_observations(message(1))
    join.add_odometry(message(1))
    join.add_odometry(message(2))
    assert joined == [(1, 1, 1)]
    join.add_map(message(2, tracking=OK))
    assert joined == [(1, 1, 1), (2, 2, 2)]


def test_without_a_pose_the_map_alone_completes(join, joined):
    join.add_observations(message(1))
    join.add_map(message(1, tracking=LOST))
    assert joined == [(1, None, 1)]


def test_a_lost_map_is_replaced_by_the_one_before(join, joined):
    for stamp in (1, 2, 3):
        join.add_observations(message(stamp))
        join.add_odometry(message(stamp))
        if stamp != 2:
            join.add_map(message(stamp, tracking=OK))
    assert joined == [(1, 1, 1), (2, 2, 1), (3, 3, 3)]


def test_observations_whose_odometry_is_lost_are_dropped(join, joined):
    for stamp in (1, 2, 3):
        join.add_observations(message(stamp))
        join.add_map(message(stamp, tracking=OK))
        if stamp != 2:
            join.add_odometry(message(stamp))
    assert joined == [(1, 1, 1), 'dropped', (3, 3, 3)]


def test_observations_that_wait_stay_bounded(join, joined):
    for stamp in range(500):
        join.add_observations(message(stamp))
    for stamp in range(500):
        join.add_map(message(stamp, tracking=LOST))
    assert joined == [(stamp, None, stamp) for stamp in range(400, 500)]


def test_a_second_run_with_earlier_stamps_joins_as_well(join, joined):
    for stamp in (7, 8, 9, 1, 2):
        join.add_observations(message(stamp))
        join.add_odometry(message(stamp))
        join.add_map(message(stamp, tracking=OK))
    assert joined == [(stamp, stamp, stamp) for stamp in (7, 8, 9, 1, 2)]


def odometry_of(x, stamp):
    def xyz(x):
        return SimpleNamespace(x=x, y=0.0, z=0.0, w=1.0)

    pose = SimpleNamespace(position=xyz(x), orientation=xyz(0.0))
    twist = SimpleNamespace(linear=xyz(10.0), angular=xyz(0.0))
    return message(stamp, pose=SimpleNamespace(pose=pose, covariance=np.eye(6)),
                   twist=SimpleNamespace(twist=twist, covariance=np.eye(6)))


def map_of(tracking=OK):
    return SimpleNamespace(tracking=tracking, reason='', scale_status=1, scale_source='', resets=0,
                           planes=[], unit=1.0)


def remember(memory, x, stamp):
    extraction = made_up.extraction(np.random.default_rng(0), stamp=stamp)
    odometry = None if x is None else odometry_of(x, stamp)
    return memory.scene(extraction, odometry, map_of(LOST if x is None else OK), FRAMES)


def test_the_baseline_is_the_distance_to_the_pose_before():
    memory = SceneMemory()
    remember(memory, 0.8, 100_000_000)
    assert remember(memory, 1.9, 200_000_000).baseline == pytest.approx(1.1)


@pytest.mark.parametrize('stamp', [100_000_000, 900_000_000])
def test_where_the_pose_before_is_not_known_the_velocity_gives_the_baseline(stamp):
    memory = SceneMemory()
    if stamp > 500_000_000:
        remember(memory, 0.8, 100_000_000)
    assert remember(memory, 9.0, stamp).baseline == pytest.approx(1.0)


def test_without_a_pose_the_last_scene_stands_with_its_new_status():
    memory = SceneMemory()
    assert remember(memory, None, 100_000_000) is None
    before = remember(memory, 0.8, 200_000_000)
    lost = remember(memory, None, 300_000_000)
    assert (lost.stamp, lost.status) == (300_000_000, TrackingStatus.LOST)
    np.testing.assert_array_equal(lost.t_world_from_cam, before.t_world_from_cam)


def test_a_pose_continues_the_one_before_as_far_as_speed_and_covariance_allow():
    before = remember(SceneMemory(), 50.0, 100_000_000)
    assert continues(None, before)
    sure = {'pose_covariance': 1e-4 * np.eye(6)}
    near = remember(SceneMemory(), 51.0, 200_000_000)
    origin = remember(SceneMemory(), 0.0, 200_000_000)
    assert continues(replace(before, **sure), replace(near, **sure))
    assert not continues(replace(before, **sure), replace(origin, **sure))
    assert continues(before, replace(origin, pose_covariance=100 * np.eye(6)))


@pytest.mark.parametrize('unit', [0.5, 2.0, 20.0])
def test_a_baseline_is_known_and_continues_where_the_unit_becomes_the_metre(unit):
    memory = SceneMemory()
    before = remember(memory, 50.0, 100_000_000)
    assert before.scale_status is ScaleStatus.METRIC
    before = replace(before, velocity_world=before.velocity_world / unit, unit=1 / unit,
                     scale_status=ScaleStatus.UNKNOWN)
    memory.last = before
    scene = remember(memory, 51.0, 200_000_000)
    assert scene.baseline == pytest.approx(1.0)
    sure = {'pose_covariance': 1e-4 * np.eye(6)}
    assert continues(replace(before, **sure), replace(scene, **sure))
    assert not continues(scene, before)


def test_every_baseline_is_right_where_a_speed_makes_metres_late():
    canyon, memory, n = Canyon(), SceneMemory(), 20
    filter_, found = SceneFilter(SceneSettings()), []
    for k in range(1, n + 1):
        extraction = canyon.extraction(k)
        told = [Speed(extraction.previous_stamp, SPEED)] if k > 15 else []
        scene = filter_.step(extraction, (), told)[0]
        there = memory.scene(extraction, *(
            through_cdr(name, to_fields(scene, FRAMES)) for name, to_fields in (
                ('nav_msgs/msg/Odometry', fields.odometry_to_fields),
                ('mv_slapse_msgs/msg/PlaneMap', fields.plane_map_to_fields))), FRAMES)
        found.append((there.baseline, scene.baseline, scene.scale_status))
    assert {status for *_, status in found} == set(ScaleStatus)
    np.testing.assert_allclose([f[0] for f in found[1:]], [f[1] for f in found[1:]], rtol=1e-3)
    assert found[15][0] == pytest.approx(DT * SPEED, rel=1e-3)  # 3.8 m about the origin
