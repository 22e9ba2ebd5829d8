from dataclasses import replace
from functools import partial

import made_up
from mv_slapse import fields
from mv_slapse.plane_messages import PlaneMessages
from mv_slapse.ros_frames import RosFrames
from mv_slapse.storage import messages
import numpy as np

to_message = partial(messages.to_message, 'mv_slapse_msgs/msg/MapPlane')


def test_planes_that_have_not_changed_are_made_messages_once():
    rng, kept = np.random.default_rng(0), PlaneMessages(to_message)
    planes = [replace(made_up.map_plane(rng), id=id_) for id_ in (3, 7, 8)]
    frames = RosFrames(t_odom_from_start=rng.normal(size=3))
    first = kept.of(planes, frames)
    planes[1] = replace(made_up.map_plane(rng), id=7)
    second = kept.of(planes[1:], replace(frames))
    assert second[1] is first[2]
    assert second[0].normal.x != first[1].normal.x
    moved = replace(frames, t_odom_from_start=rng.normal(size=3))
    expected = [repr(to_message(fields.map_plane_to_fields(plane, moved))) for plane in planes]
    assert [repr(plane) for plane in kept.of(planes, moved)] == expected
    assert [repr(plane) for plane in kept.of(planes, moved)] == expected


def test_a_message_with_messages_in_it_is_the_same_bytes():
    rng, name = np.random.default_rng(0), 'mv_slapse_msgs/msg/PlaneMap'
    scene = replace(made_up.scene(rng), planes=(made_up.map_plane(rng), made_up.map_plane(rng)))
    values = fields.plane_map_to_fields(scene, RosFrames(), 3, 10**9)
    mixed = PlaneMessages(to_message).map_fields(scene, RosFrames(), 3, 10**9)
    assert messages.serialize(name, mixed) == messages.serialize(name, values)
    assert messages.to_message(name, messages.to_message(name, mixed)).planes == mixed['planes']
