"""From video messages to correspondences: what the nodes ``decoder`` and ``all_in_one`` share."""

from collections.abc import Callable

from mv_slapse.codec.decoder import CorrespondenceDecoder
from mv_slapse.codec.packet import Packet
from mv_slapse.config import DecoderSettings
from mv_slapse.geometry.calibration import check_size
from mv_slapse.geometry.camera import Camera
from mv_slapse.nodes.camera_input import CameraInput
from mv_slapse.nodes.gate import Gate
from mv_slapse.nodes.settings import VideoSettings
from mv_slapse.nodes.shell import Shell
from mv_slapse.nodes.video_source import VideoSource
from mv_slapse.nodes.video_topic import VideoTopic
from mv_slapse.records import Correspondences, SegmentKind

BACKWARDS = 1_000_000_000  # [ns] a stamp this much earlier is a new run, not a B frame
HELD = 600  # packets kept until the camera is known


class Decoding:
    """Camera, video and decoder; calls ``sink`` with each record and the camera's frame."""

    def __init__(self, node: Shell, sink: Callable[[Correspondences, str], None],
                 on_camera: Callable[[Camera], None] = lambda _: None):
        """Connect to the topics or the source that the parameters name."""
        self._node, self._sink, self._on_new_camera = node, sink, on_camera
        self._decoder: CorrespondenceDecoder | None = None
        self._newest, self._frame = 0, ''
        self._gate = Gate(lambda *_: self._decoder is not None, self._feed, HELD)
        self._camera = CameraInput(node, self._on_camera)
        video = node.settings[VideoSettings]
        self._video = (VideoSource(node, self._gate, self._flush) if video.source
                       else VideoTopic(node, self._gate))

    def restart(self):
        """Forget the stream; the camera stays."""
        self._video.restart()
        self._gate.clear()
        if self._camera.camera is not None:
            self._renew(self._camera.camera)

    def close(self):
        """Stop reading."""
        self._video.close()

    def _on_camera(self, camera: Camera):
        self._renew(camera)
        self._on_new_camera(camera)
        self._gate.drain()

    def _renew(self, camera: Camera):
        self._newest = 0
        self._decoder = CorrespondenceDecoder(self._node.settings[DecoderSettings], camera)

    def _feed(self, packet: Packet, frame: str):
        if packet.stamp < self._newest - BACKWARDS:
            self._node.get_logger().warning('the video went back in time: starting anew')
            self._node.restart()
        self._newest, self._frame = max(self._newest, packet.stamp), frame
        for record in self._decoder.feed(packet):
            self._hand_over(record)

    def _flush(self):
        if self._decoder is not None:
            for record in self._decoder.flush():
                self._hand_over(record)

    def _hand_over(self, record: Correspondences):
        check_size(self._camera.camera, record.width, record.height, 'video')
        health = self._node.health
        health.count('key frame pairs')
        if record.kind == SegmentKind.BROKEN:
            health.count('broken pairs')
            health.warning('broken', f'the last pair of key frames is broken: {record.reason}')
        else:
            health.solved('broken')
        self._sink(record, self._frame)
