"""Start mv_slapse on a topic, a file, a URL or a bag.

ros2 launch mv_slapse mv_slapse.launch.py input:=/camera/image_raw/ffmpeg
ros2 launch mv_slapse mv_slapse.launch.py input:=drive.mp4 camera_info_url:=camera.yaml
"""

import os
from pathlib import PurePosixPath

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, ExecuteProcess, OpaqueFunction
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node
from launch_ros.substitutions import FindPackageShare

BAG_TOPIC = '/camera/image/ffmpeg'  # where `mv_slapse bag` puts the video
TRANSPORTS = ('ffmpeg', 'compressed', 'h264', 'compressed_video', 'image_compressed')
ARGUMENTS = (
    ('input', '', 'topic, video file, URL, or bag; empty: the topic "video"'),
    ('video_topic', '', f'topic of the video inside a bag; empty: {BAG_TOPIC}'),
    ('camera_info_topic', '', 'empty: camera_info beside the video, as image_transport has it'),
    ('camera_info_url', '', 'calibration file instead of a camera_info topic'),
    ('wheel_odometry_topic', '', 'nav_msgs/Odometry of the wheels, whose speed makes the scale '
     'metric'),
    ('params_file', '', 'parameters of the nodes, such as config/all_in_one.yaml'),
    ('namespace', '', 'of all nodes'),
    ('use_sim_time', '', 'take the time from /clock; empty: only when a bag is played'),
    ('all_in_one', 'true', 'one process, which copies less; false: four nodes'),
    ('bag_tf', 'false', 'play the /tf of a bag, too; where it has odom -> base_link that comes '
     'twice, unless publish_tf is false'),
    ('rviz', 'false', 'show the results'),
    ('fixed_frame', 'odom', 'of the viewer: odom_frame, where that is another, or map'),
    ('respawn', 'true', 'start a node again when it ends'),
    ('log_level', 'info', 'of the nodes: debug, info, warn, error or fatal'),
)
RESPAWN_DELAY = 0.2  # [s]
NODES = ('decoder', 'plane_extraction', 'slam', 'obstacle_tracker')
WITH_CAMERA = ('decoder', 'plane_extraction', 'all_in_one')
WITH_SPEED = ('slam', 'all_in_one')


def generate_launch_description():
    """Return the arguments, and what they decide."""
    arguments = [DeclareLaunchArgument(name, default_value=default, description=text)
                 for name, default, text in ARGUMENTS]
    return LaunchDescription([*arguments, OpaqueFunction(function=start)])


def start(context):
    """Return the nodes, and the bag's player and the viewer where they are asked for."""
    args = {name: LaunchConfiguration(name).perform(context) for name, _, _ in ARGUMENTS}
    kind = kind_of(args['input'])
    args['sim_time'] = is_true(args['use_sim_time'] or str(kind == 'bag'))
    names = ('all_in_one',) if is_true(args['all_in_one']) else NODES
    actions = [node(name, kind, args) for name in names]
    if kind == 'bag':
        # the player advertises its topics at once and waits, so that the nodes can connect
        without = [] if is_true(args['bag_tf']) else ['--exclude-topics', '/tf']
        actions.append(ExecuteProcess(
            cmd=['ros2', 'bag', 'play', args['input'], '--clock', '--delay', '3', *without],
            output='screen'))
    if is_true(args['rviz']):
        actions.append(rviz(args))
    return actions


def node(name, kind, args):
    """Return the action that starts a node; what the command line says wins over the file."""
    parameters = [args['params_file']] if args['params_file'] else []
    overrides = {'use_sim_time': args['sim_time']}
    if name in WITH_CAMERA and args['camera_info_url']:
        overrides['camera_info_url'] = args['camera_info_url']
    if name in ('decoder', 'all_in_one') and kind == 'source':
        overrides['source'] = args['input']
    return Node(package='mv_slapse', executable=name, name=name, namespace=args['namespace'],
                parameters=[*parameters, overrides], remappings=remappings(name, kind, args),
                # the node is started again by a process that has all loaded, and that by launch
                arguments=[*(['--standby'] if is_true(args['respawn']) else []),
                           '--ros-args', '--log-level', args['log_level']],
                output='screen', respawn=is_true(args['respawn']), respawn_delay=RESPAWN_DELAY)


def remappings(name, kind, args):
    """Return where video, calibration and speed come from."""
    topic = {'topic': args['input'], 'bag': args['video_topic'] or BAG_TOPIC}.get(kind, '')
    info = args['camera_info_topic'] or (camera_info_beside(topic) if topic else '')
    pairs = []
    if name in ('decoder', 'all_in_one') and topic:
        pairs.append(('video', topic))
    if name in WITH_CAMERA and info:
        pairs.append(('camera_info', info))
    if name in WITH_SPEED and args['wheel_odometry_topic']:
        pairs.append(('wheel_odometry', args['wheel_odometry_topic']))
    return pairs


def rviz(args):
    """Return the viewer, set up for these topics."""
    config = os.path.join(FindPackageShare('mv_slapse').find('mv_slapse'), 'config',
                          'mv_slapse.rviz')
    return Node(package='rviz2', executable='rviz2', namespace=args['namespace'],
                arguments=['-d', config, '-f', args['fixed_frame']],
                parameters=[{'use_sim_time': args['sim_time']}])


def kind_of(given):
    """Return what the input is: a source (file, URL or device), a bag or a topic."""
    if not given:
        return 'none'
    if os.path.isdir(given) or given.endswith(('.mcap', '.db3')):
        return 'bag'
    if '://' in given or os.path.exists(given):
        return 'source'
    if PurePosixPath(given).suffix:
        # no topic has a dot in its name: this is a file that is not there, which the node says
        return 'source'
    return 'topic'


def camera_info_beside(topic):
    """Return the camera_info of an image topic: its sibling, the transport's name left out."""
    path = PurePosixPath(topic)
    if path.name in TRANSPORTS:
        path = path.parent
    return str(path.parent / 'camera_info')


def is_true(text):
    """Return the truth of an argument."""
    return text.lower() in ('true', '1', 'yes', 'on')
