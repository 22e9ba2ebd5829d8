"""Correspondences of a drive through a drawn street, and what comes of them."""

from functools import cache

from mv_slapse.config import SceneSettings, Settings
from mv_slapse.level import levelled
from mv_slapse.pipeline import Slapse
from mv_slapse.records import Correspondences, SegmentKind, WITH_POSE
from mv_slapse.ros_frames import Pose, pose_to_odom, RosFrames
from mv_slapse.scene.scale.height import ENOUGH
from mv_slapse.simulation.drawn import draw_pair
from mv_slapse.simulation.street import Street, StreetSettings
import numpy as np
from sensor_msgs.msg import CameraInfo

STEP = 4  # frames between key frames
HEIGHT = 1.65  # [m] of the camera
WITHOUT_POSE = ENOUGH - 1  # first pairs, before the height tells metres


@cache
def street() -> Street:
    return Street(StreetSettings(n_frames=80, width=320, height=240, focal=250.0))


@cache
def pairs(n: int) -> list:
    """Return the pairs of the first n + 1 key frames."""
    rng = np.random.default_rng(0)
    return [draw_pair(street(), STEP * i, STEP * (i + 1), rng) for i in range(n)]


@cache
def steps(n: int) -> list:
    """Return what the pipeline makes of the pairs."""
    slapse = Slapse(camera(), Settings(scene=SceneSettings(camera_height=HEIGHT)))
    return [slapse.step(pair) for pair in pairs(n)]


def in_odom(scenes) -> list[Pose]:
    """Return the poses of the base where nobody told the camera's place on it."""
    scenes = [scene for scene in scenes if scene.status in WITH_POSE]
    frames = levelled(RosFrames(), scenes[0].planes)
    return [pose_to_odom(Pose(scene.R_world_from_cam, scene.t_world_from_cam), frames)
            for scene in scenes]


def camera():
    return street().camera


def broken() -> Correspondences:
    return Correspondences(900_000_000, 800_000_000, camera().width, camera().height,
                           SegmentKind.BROKEN, reason='a packet was lost')


def camera_info() -> CameraInfo:
    made = camera()
    return CameraInfo(width=made.width, height=made.height, distortion_model=made.lens,
                      d=made.distortion.tolist(), k=made.K.ravel())
