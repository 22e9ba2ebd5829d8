"""What recorded odometry and maps say of the camera's way."""

from mv_slapse.fields import scene_from_messages, stamp_from_message
from mv_slapse.ros_frames import RosFrames
from mv_slapse.storage.bag_reader import BagReader
from mv_slapse.storage.tum import Trajectory
import numpy as np
from scipy.spatial.transform import Rotation


def messages(bag: BagReader, topic: str) -> dict:
    """Return the messages of a topic by stamp."""
    return {stamp_from_message(msg.header.stamp): msg for _, msg in bag.messages([topic])}


def trajectory(bag: BagReader, frames: RosFrames) -> Trajectory:
    """Return the camera's trajectory in {W} from odometry and map.

    The map is latched with depth 1: on a busy machine one can be replaced before it was sent. The
    one before stands in, as in the node that joins them.
    """
    odometry, maps = messages(bag, '/odometry'), messages(bag, '/planes/map')
    scenes = [scene_from_messages(
        odometry[stamp], maps[max(at for at in maps if at <= stamp)], frames)
        for stamp in sorted(odometry) if stamp >= min(maps)]
    return Trajectory(
        np.array([scene.stamp for scene in scenes], np.int64),
        np.array([scene.t_world_from_cam for scene in scenes]),
        Rotation.from_matrix([scene.R_world_from_cam for scene in scenes]).as_quat())
