"""Parameters that only the ROS nodes have, and which settings each node declares; free of ROS.

A parameter's name is ``<part>.<setting>`` as in ``Settings`` (``scene.camera_height``); those of
this module have no prefix (``odom_frame``).
"""

from dataclasses import dataclass, fields
from functools import cache

from mv_slapse.config import (
    Checked,
    DecoderSettings,
    EncoderSettings,
    ExtractionSettings,
    MountSettings,
    ObstacleSettings,
    SceneSettings,
    setting,
)
from mv_slapse.errors import UsageError

INPUT_TYPES = ('auto', 'ffmpeg', 'compressed_video', 'compressed_image', 'image')
RELIABILITIES = ('auto', 'reliable', 'best_effort')
STAMP_ORIGINS = ('clock', 'stream')


@dataclass(frozen=True)
class VideoSettings(Checked):
    """Where the video comes from."""

    source: str = setting(
        '', '-', 'file or URL of a video (file, rtsp, rtp, udp, tcp, http(s)); empty: the topic '
        '"video"')
    source_rate: float = setting(
        1.0, '-', 'speed at which a file is played, 1 is real time; 0: as fast as it decodes',
        0.0, 1000.0)
    stamp_origin: str = setting(
        'clock', '-', 'time of the first frame of "source": the node\'s "clock", or the '
        '"stream"\'s own, which starts at 0')
    input_type: str = setting(
        'auto', '-', f'type of the topic "video", one of {", ".join(INPUT_TYPES)}')
    qos_reliability: str = setting(
        'auto', '-', f'of the subscription to "video", one of {", ".join(RELIABILITIES)}; auto: '
        'reliable where every publisher is')
    qos_depth: int = setting(
        120, '-', 'depth of the subscription to "video", at least two groups of pictures', 1,
        100000)
    camera_frame: str = setting(
        '', '-', 'optical frame of the camera; empty: as in the video\'s header')


@dataclass(frozen=True)
class LatencySettings(Checked):
    """How far a node may fall behind its input."""

    max_latency: float = setting(
        0.5, 's', 'longest time that input may wait: fed faster than it can work, a node drops '
        'whole segments, the oldest first, and says so', 0.02, 3600.0)


@dataclass(frozen=True)
class CameraSettings(Checked):
    """Where the calibration comes from."""

    camera_info_url: str = setting(
        '', '-', 'calibration file (path, file:// or package://); empty: the topic "camera_info"')


@dataclass(frozen=True)
class FrameSettings(Checked):
    """Frames of the outputs, REP-105."""

    odom_frame: str = setting('odom', '-', 'frame in which pose, map and obstacles are given')
    base_frame: str = setting('base_link', '-', 'frame of the robot whose pose is given')
    base_from_camera: tuple[float, ...] = setting(
        (0.0,) * 7, 'm, -', 'pose of the camera\'s optical frame in base_frame, x y z qx qy qz '
        'qw; all zero: from /tf_static, else the camera itself with x forward, z up')
    tf_wait: float = setting(
        1.0, 's', 'how long to wait at the start for the camera\'s pose on /tf_static', 0.0, 60.0)

    def __post_init__(self):
        """Refuse a pose that is none."""
        super().__post_init__()
        pose = self.base_from_camera
        norm = sum(q * q for q in pose[3:]) ** 0.5
        if len(pose) != 7 or any(pose) and abs(norm - 1) > 1e-3:
            raise UsageError(f'base_from_camera = {list(pose)} is not a pose: give 7 numbers '
                             'x y z qx qy qz qw with a unit quaternion')


@dataclass(frozen=True)
class SceneOutputSettings(Checked):
    """What slam publishes and saves."""

    publish_tf: bool = setting(
        True, '-', 'send odom_frame -> base_frame on /tf; false where another node does, such as '
        'robot_localization')
    path_length: int = setting(1000, '-', 'poses kept in the topic "path"', 1, 100000)
    path_period: float = setting(1.0, 's', 'time between two messages on "path"', 0.0, 60.0)
    map_file: str = setting(
        '', '-', 'map of an earlier run (map.json, or what ~/save_map wrote), whose frame '
        'odom_frame becomes where its planes are found again; read at the start and by '
        '~/load_map; empty: none')
    output_directory: str = setting(
        '', '-', 'where ~/save_map and ~/save_trajectory write; empty: $ROS_HOME/mv_slapse '
        '(~/.ros/mv_slapse)')


@dataclass(frozen=True)
class ObstacleOutputSettings(Checked):
    """What obstacle_tracker publishes."""

    point_spacing: float = setting(
        0.2, 'm', 'distance between points on "obstacles/points"', 0.01, 10.0)
    footprint_depth: float = setting(
        0.5, 'm', 'smallest extent of a polygon on "obstacles/polygons"', 0.01, 10.0)


_VIDEO, _CAMERA = ('', VideoSettings), ('', CameraSettings)
_FRAMES, _LATENCY = ('', FrameSettings), ('', LatencySettings)
_SCENE_OUTPUT, _OBSTACLE_OUTPUT = ('', SceneOutputSettings), ('', ObstacleOutputSettings)
_ENCODER, _DECODER = ('encoder', EncoderSettings), ('decoder', DecoderSettings)
_EXTRACTION = ('extraction', ExtractionSettings)
_SCENE, _OBSTACLES = ('scene', SceneSettings), ('obstacles', ObstacleSettings)
_MOUNT = ('scene', MountSettings)

#: node name -> (prefix, settings class) of each group of its parameters
NODE_SETTINGS: dict[str, tuple[tuple[str, type], ...]] = {
    'decoder': (_VIDEO, _CAMERA, _LATENCY, _ENCODER, _DECODER),
    'plane_extraction': (_CAMERA, _LATENCY, _MOUNT, _EXTRACTION),
    'slam': (_FRAMES, _LATENCY, _SCENE_OUTPUT, _SCENE),
    'obstacle_tracker': (_FRAMES, _LATENCY, _OBSTACLE_OUTPUT, _OBSTACLES),
    'all_in_one': (_VIDEO, _CAMERA, _FRAMES, _LATENCY, _SCENE_OUTPUT, _OBSTACLE_OUTPUT, _ENCODER,
                   _DECODER, _EXTRACTION, _SCENE, _OBSTACLES),
}
#: settings of the core: a new value makes its part begin anew, where the last output has ended
CORE = (EncoderSettings, DecoderSettings, ExtractionSettings, MountSettings, SceneSettings,
        ObstacleSettings)
LIVE = (*CORE, LatencySettings, SceneOutputSettings, ObstacleOutputSettings)
FIXED = ('output_directory', 'path_length')  # of these, what is decided at the start


def is_live(kind: type, name: str) -> bool:
    """Return whether a parameter may change while its node runs."""
    return kind in LIVE and name not in FIXED


@cache
def all_names() -> tuple[str, ...]:
    """Return the names of all parameters of all nodes."""
    return tuple(sorted({f'{prefix}.{item.name}' if prefix else item.name
                         for groups in NODE_SETTINGS.values() for prefix, kind in groups
                         for item in fields(kind)}))


def require(name: str, value: str, choices: tuple[str, ...]) -> str:
    """Return the value of a parameter, or raise UsageError where it is none of the choices."""
    if value not in choices:
        raise UsageError(f'parameter {name} = {value!r}: choose one of {", ".join(choices)}')
    return value
