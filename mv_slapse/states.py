"""All conditions of a node, as /diagnostics and docs/diagnostics.md name them; free of ROS.

A node is in the condition that hinders it most: what failed comes before what is waited for, that
before what works but not well. It is WORKING only while something usable has come out of it in the
last seconds, never by the absence of complaints.
"""

from dataclasses import dataclass
from enum import IntEnum


class Kind(IntEnum):
    """How much a condition hinders, the worst first."""

    FAILED = 0
    WAITING = 1
    DEGRADED = 2
    WORKING = 3


@dataclass(frozen=True)
class Condition:
    """A condition: its kind, the nodes that know it, what it means, and what to do next."""

    kind: Kind
    nodes: tuple[str, ...]
    meaning: str
    next_step: str


VIDEO = ('decoder', 'all_in_one')
CAMERA = ('decoder', 'plane_extraction', 'all_in_one')
SCENE = ('slam', 'all_in_one')
MOUNTED = ('slam', 'obstacle_tracker', 'all_in_one')
ALL = ('decoder', 'plane_extraction', 'slam', 'obstacle_tracker', 'all_in_one')

#: in the order in which they are told where several of one kind hold
CONDITIONS: dict[str, Condition] = {
    'fault': Condition(
        Kind.FAILED, ALL, 'a part of the node ended with an error of its own and was started anew',
        'report the traceback in the log'),
    'unusable': Condition(
        Kind.FAILED, ALL, 'the input cannot be used: its codec, its size, its type, its file',
        'do what the message says'),
    'bad_camera': Condition(
        Kind.FAILED, CAMERA, 'the calibration cannot be used', 'calibrate the camera'),
    'qos': Condition(
        Kind.FAILED, ALL, 'publisher and subscription do not fit', 'do what the message says'),
    'unreachable': Condition(
        Kind.FAILED, VIDEO, 'the source is not there, or broke off; it is opened again and again',
        'switch it on, check address and network'),
    'undecodable': Condition(
        Kind.FAILED, VIDEO, 'packets come, key pictures among them, but none can be decoded',
        'check that the topic carries a whole stream of one codec, and that no packets are lost'),
    'lost': Condition(
        Kind.FAILED, SCENE, 'the pose is lost, none is published',
        'check the video; it recovers by itself on good input, or call ~/reset'),
    'paused': Condition(
        Kind.WAITING, ALL, 'paused', 'call ~/pause with data: false to go on'),
    'ended': Condition(
        Kind.WAITING, VIDEO, 'the source has ended', 'start the node again to play it again'),
    'no_camera': Condition(
        Kind.WAITING, CAMERA, 'no camera_info yet', 'start the camera driver, remap camera_info, '
        'or set camera_info_url to a calibration file'),
    'no_extrinsics': Condition(
        Kind.WAITING, MOUNTED, 'the camera\'s place on the robot is looked for on /tf_static',
        'publish it, or set base_from_camera; tf_wait is how long it is waited for'),
    'no_publisher': Condition(
        Kind.WAITING, ALL, 'a topic has no publisher', 'start what publishes it, or remap it'),
    'silent': Condition(
        Kind.WAITING, ALL, 'a topic has a publisher but brings no messages',
        'check what publishes it'),
    'no_key_frame': Condition(
        Kind.WAITING, VIDEO, 'packets come, but no key picture yet, with which decoding begins',
        'wait, or have the encoder send one every second or two (-g 30)'),
    'initialising': Condition(
        Kind.WAITING, SCENE, 'there is no pose yet', 'move the camera, with scene.camera_height '
        'over ground in its view'),
    'no_pose': Condition(
        Kind.WAITING, ('obstacle_tracker',), 'slam gives no pose', 'see what slam says'),
    'no_output': Condition(
        Kind.WAITING, ALL, 'nothing has come out of this node', 'wait; if it lasts, see the '
        'counters beside this message'),
    'overload': Condition(
        Kind.DEGRADED, ALL, 'fed faster than it can work: segments are dropped to keep up',
        'lower the rate or the size of the pictures, or free the CPU; max_latency bounds how far '
        'it may fall behind'),
    'rejected': Condition(
        Kind.DEGRADED, ALL, 'a message says what cannot be; it was dropped',
        'correct its publisher'),
    'dropped': Condition(
        Kind.DEGRADED, ALL, 'messages were lost on the way',
        'make the publisher reliable, or raise qos_depth'),
    'broken': Condition(
        Kind.DEGRADED, VIDEO, 'the last pair of key frames is broken',
        'check the stream if this lasts'),
    'no_motion': Condition(
        Kind.DEGRADED, ('plane_extraction', 'all_in_one'), 'the camera\'s motion is not known',
        'check correspondences if this lasts'),
    'predicted': Condition(
        Kind.DEGRADED, SCENE, 'the pose is a prediction',
        'check correspondences and planes/observations if this lasts'),
    'no_scale': Condition(
        Kind.DEGRADED, SCENE, 'the scale is not known, lengths have no unit',
        'set scene.camera_height, or publish the speed on wheel_odometry'),
    'unplaced': Condition(
        Kind.DEGRADED, SCENE, 'the planes of map_file are not found again, poses are in another '
        'frame', 'tell on initialpose where it is in that map, or drive on'),
    'clock': Condition(
        Kind.DEGRADED, SCENE, 'wheel_odometry is stamped by another clock and not used',
        'stamp both with one clock'),
    'working': Condition(Kind.WORKING, ALL, 'ok', ''),
}
