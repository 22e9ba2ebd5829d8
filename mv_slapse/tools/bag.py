"""``mv_slapse bag``: a video file as a rosbag2 bag that a robot could have recorded."""

from dataclasses import dataclass, replace
from pathlib import Path

from mv_slapse import fields
from mv_slapse.calibration import fitted
from mv_slapse.codec.packet import Packet
from mv_slapse.errors import UnusableInput
from mv_slapse.geometry.camera import Camera
from mv_slapse.ros_frames import Pose, RosFrames
from mv_slapse.storage.bag_writer import BagWriter
from mv_slapse.storage.tum import Trajectory
from mv_slapse.tools.inputs import open_input
from mv_slapse.video_messages import FFMPEG_PACKET, packet_to_fields

VIDEO_TOPIC = '/camera/image/ffmpeg'
CAMERA_TOPIC = '/camera/camera_info'
TRUTH_TOPIC = '/ground_truth'
SECOND = 1_000_000_000


@dataclass(frozen=True)
class BagContent:
    """What was written: the bag, and the number of packets, calibrations and true poses."""

    path: str
    packets: int
    camera_infos: int
    true_poses: int


def make_bag(video: str, camera: Camera, truth: Trajectory | None, output: str | Path,
             start: int = 0, max_frames: int | None = None) -> BagContent:
    """Write a bag with the packets of a video as FFMPEGPacket, its camera and its true poses.

    Parameters
    ----------
    truth : Trajectory or None
        Poses of the camera; the first becomes the origin of odom.
    start : int
        Added to every stamp [ns]; without it a file's first frame has stamp 0.
    max_frames : int or None
        Stop after so many packets.

    Raises
    ------
    UnusableInput, UsageError
        Where the video, or the place to write to, cannot be used.
    """
    with open_input(str(video)) as source:
        if source.size:
            camera = fitted(camera, *source.size, str(video))
        first = next(source.packets, None)
        if first is None:
            raise UnusableInput(f'{video} has no pictures; was the recording finished?')
        with BagWriter(output) as bag:
            recorder = _Recorder(bag, camera, _poses(truth), start)
            recorder.write(first)
            while recorder.n_packets != max_frames and (packet := next(source.packets, None)):
                recorder.write(packet)
    return BagContent(str(output), recorder.n_packets, recorder.n_infos, recorder.n_poses)


class _Recorder:
    """Joins packets, calibrations and true poses in the order in which a robot sends them."""

    def __init__(self, bag: BagWriter, camera: Camera, poses: list[tuple[int, Pose]], start: int):
        self._bag, self._camera, self._poses, self._start = bag, camera, poses, start
        self._frames = RosFrames()
        self._now = self._last_info = -SECOND
        self.n_packets = self.n_infos = self.n_poses = 0

    def write(self, packet: Packet):
        """Write a packet, and what is due by then of the calibration and the true poses."""
        # A packet is sent when its picture has been taken, and after all packets before it.
        self._now = max(self._now, packet.stamp)
        if self._now - self._last_info >= SECOND:
            self._write_info()
        size = self._camera.width, self._camera.height
        values = packet_to_fields(replace(packet, stamp=packet.stamp + self._start), size,
                                  self.n_packets, self._frames.camera)
        self._bag.write(VIDEO_TOPIC, FFMPEG_PACKET, values, self._now + self._start)
        self.n_packets += 1
        self._write_poses()

    def _write_info(self):
        stamp = self._now + self._start
        values = fields.camera_to_fields(self._camera, stamp, self._frames.camera)
        self._bag.write(CAMERA_TOPIC, 'sensor_msgs/msg/CameraInfo', values, stamp)
        self._last_info = self._now
        self.n_infos += 1

    def _write_poses(self):
        while self.n_poses < len(self._poses) and self._poses[self.n_poses][0] <= self._now:
            stamp, pose = self._poses[self.n_poses]
            values = fields.camera_pose_to_fields(stamp + self._start, pose, self._frames)
            self._bag.write(TRUTH_TOPIC, 'geometry_msgs/msg/PoseStamped', values,
                            self._now + self._start)
            self.n_poses += 1


def _poses(truth: Trajectory | None) -> list[tuple[int, Pose]]:
    """Return stamps [ns] and poses, the first of which is the origin."""
    if truth is None or not len(truth):
        return []
    R, t = truth.rotations(), truth.positions
    return [(int(stamp), Pose(R[0].T @ R_k, R[0].T @ (t_k - t[0])))
            for stamp, R_k, t_k in zip(truth.stamps, R, t, strict=True)]
