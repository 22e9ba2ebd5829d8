"""From video messages to correspondences: what the nodes ``decoder`` and ``all_in_one`` share."""

from collections.abc import Callable
import time

from mv_slapse.calibration import check_size
from mv_slapse.codec.decoder import CorrespondenceDecoder
from mv_slapse.codec.encoding.recoder import Recoder
from mv_slapse.codec.packet import Packet, Picture
from mv_slapse.config import DecoderSettings, EncoderSettings
from mv_slapse.geometry.camera import Camera
from mv_slapse.nodes.camera_input import CameraInput
from mv_slapse.nodes.gate import Gate
from mv_slapse.nodes.health import SILENCE
from mv_slapse.nodes.image_overlay import ImageOverlay
from mv_slapse.nodes.overload import OVERLOAD
from mv_slapse.nodes.settings import VideoSettings
from mv_slapse.nodes.shell import BACKWARDS, Shell
from mv_slapse.nodes.video_source import VideoSource
from mv_slapse.nodes.video_topic import VideoTopic
from mv_slapse.records import Correspondences, SegmentKind

HELD = 600  # packets kept until the camera is known
PART = 'video'


class Decoding:
    """Camera, video and decoder; calls ``sink`` with each record and the camera's frame.

    ``overlay`` has the pictures for the topic ``image_overlay``.

    Where even decoding is too slow, packets are dropped up to a key picture that is in time, and
    a BROKEN pair stands for them.
    """

    def __init__(self, node: Shell, sink: Callable[[Correspondences, str], None],
                 on_camera: Callable[[Camera], None] = lambda _: None):
        """Connect to the topics or the source that the parameters name."""
        self._node, self._sink, self._on_new_camera = node, sink, on_camera
        self._camera: Camera | None = None
        self.overlay = ImageOverlay(node)
        self._decoder: CorrespondenceDecoder | None = None
        self._frame = ''
        self._begin()
        self._renew()
        self._gate = Gate(lambda *_: self._decoder is not None, self._feed, HELD)
        CameraInput(node, self._on_camera)
        video = node.settings[VideoSettings]
        self._video = (VideoSource(node, self._deliver, self._flush, self._interrupt)
                       if video.source else VideoTopic(node, self._deliver))

    def restart(self):
        """Forget the stream; the camera stays."""
        self._video.restart()
        self._gate.clear()
        self._begin()
        self._renew()

    def close(self):
        """Stop reading."""
        self._video.close()

    def _begin(self):
        """Know nothing of the stream."""
        self._newest, self._last = 0, 0
        self._seen_key = self._is_dropping = False
        self._gap = ''  # why what comes next does not join what was handed over last
        self._fruitless = float('inf')

    def _on_camera(self, camera: Camera):
        self._camera = camera
        self._renew()
        self._on_new_camera(camera)
        self._gate.drain()

    def _renew(self):
        self._recoder = Recoder(self._node.settings[EncoderSettings])
        if self._camera is not None:
            self._decoder = CorrespondenceDecoder(
                self._node.settings[DecoderSettings], self._camera, self.overlay.add_picture)

    def _deliver(self, packet: Packet | Picture, frame: str):
        """Take a packet as it comes; without a camera it waits."""
        self._gate(packet, frame, self._node.latency.came)

    def _feed(self, packet: Packet | Picture, frame: str, came: float):
        if packet.stamp < self._newest - BACKWARDS:
            self._node.begin_anew('the video went back in time')
        self._newest, self._frame = max(self._newest, packet.stamp), frame
        if self._is_late(packet, came):
            return
        self._seen_key |= packet.is_key
        records = self._node.attempt(PART, self._decode, self._recoder.feed, packet,
                                     recover=self._renew)
        self._look_for_fruit(records)
        for record in records or ():
            self._hand_over(record)

    def _decode(self, recode: Callable[..., list[Packet]], *item: Packet | Picture
                ) -> list[Correspondences]:
        """Return the records of what a picture, or the end, completes."""
        known = self._recoder.recoded
        packets = recode(*item)
        if self._recoder.recoded != known:
            self._node.get_logger().info(
                f'{self._recoder.recoded} has no motion vectors: each picture is decoded and '
                'encoded again here, which costs more than all else; H.264 would spare it')
            self._node.health.value('encoded again', self._recoder.recoded)
        return [record for packet in packets for record in self._decoder.feed(packet)]

    def _is_late(self, packet: Packet | Picture, came: float) -> bool:
        """Return whether the packet is dropped to catch up; a key picture in time ends that."""
        latency = self._node.latency
        waited = latency.waited(came)
        self._is_dropping = (waited > latency.most
                             or self._is_dropping and not packet.is_key)
        if self._is_dropping:
            self._gap = OVERLOAD
            latency.report(waited, 'packets dropped')
        elif self._gap == OVERLOAD and packet.is_key:
            self._renew()
        return self._is_dropping

    def _interrupt(self, reason: str):
        """Begin a new stream, for a reason that the pair over the gap will tell."""
        self._flush()
        self._gap = reason
        self._renew()

    def _look_for_fruit(self, records: list[Correspondences] | None):
        """Say why where packets come and no pictures of them: there is an error at most once."""
        health, now = self._node.health, time.monotonic()
        if records:
            self._fruitless = float('inf')
            health.leave('no_key_frame', 'undecodable')
            return
        self._fruitless = min(self._fruitless, now)
        if not self._seen_key:
            health.enter('no_key_frame')
        elif now - self._fruitless > SILENCE:
            health.enter('undecodable')
        else:
            health.leave('no_key_frame')

    def _flush(self):
        if self._decoder is not None:
            for record in self._node.attempt(PART, self._end, recover=self._renew) or ():
                self._hand_over(record)

    def _end(self) -> list[Correspondences]:
        return self._decode(self._recoder.flush) + self._decoder.flush()

    def _hand_over(self, record: Correspondences):
        check_size(self._camera, record.width, record.height, PART)
        if self._gap:
            reason, self._gap = self._gap, ''
            if self._last:
                self._pass_on(Correspondences(
                    record.previous_stamp, self._last, record.width, record.height,
                    SegmentKind.BROKEN, reason=reason))
        self._pass_on(record)

    def _pass_on(self, record: Correspondences):
        health = self._node.health
        health.count('key frame pairs')
        self._last = record.stamp
        if record.kind == SegmentKind.BROKEN:
            health.count('broken pairs')
            health.enter('broken', f'the last pair of key frames is broken: {record.reason}')
        else:
            health.leave('broken')
        self._sink(record, self._frame)
