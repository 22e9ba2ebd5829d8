"""The short clip on a topic, in whatever state it is."""

from dataclasses import replace

from ffmpeg_image_transport_msgs.msg import FFMPEGPacket
from mv_slapse.nodes.conversions import to_message
from mv_slapse.video_messages import packet_to_fields
from nodes import clips
from nodes.bench import LATCHED, messages_of, value_of
from nodes.conditions import note
import numpy as np
from sensor_msgs.msg import CameraInfo


class Video:
    """A publisher of the clip, in whatever state it is."""

    def __init__(self, bench, node_type, camera=True, **parameters):
        self.bench = bench
        self.node = bench.start(node_type, input_type='ffmpeg', tf_wait=0.0, **parameters)
        self.cameras = bench.peer.create_publisher(CameraInfo, 'camera_info', LATCHED)
        self.start = 0
        if camera:
            self.tell_camera()

    def tell_camera(self, info=None):
        self.cameras.publish(info or clips.camera_info())

    def connect(self, profile=10):
        self.publisher = self.bench.advertise(FFMPEGPacket, 'video', profile)

    def send(self, packets=None, **values):
        self.start += 20 * 10**9
        for i, packet in enumerate(packets or clips.packets('h264')):
            moved = replace(packet, stamp=packet.stamp + self.start)
            self.publisher.publish(to_message(FFMPEGPacket, {
                **packet_to_fields(moved, clips.SIZE, i, 'cam'), **values}))

    def junk(self, n=5, seed=0, **values):
        rng = np.random.default_rng(seed)
        packet = clips.packets('h264')[0]
        self.send([replace(packet, data=rng.bytes(400), stamp=i * 10**8) for i in range(n)],
                  **{'encoding': 'libx264', **values})

    def works(self):
        """Send the clip until the node does something with it."""
        def done():
            return 'waiting' not in value_of(self.node, 'state') and (
                value_of(self.node, 'state') != 'failed')
        for _ in range(5):
            self.send()
            if self.bench.spin(done, 3):
                note(self.node)
                return
        raise AssertionError(messages_of(self.node))
