"""What the nodes cost: a bag in real time into `all_in_one`, and into the four nodes, over DDS.

For each picture size a rendered street at 30 Hz in low-latency H.264 is played at its own rate.
Reported: the share of a core while it plays (start-up excluded), the 50th and 95th percentile of
the time from a packet's publication to the odometry of its picture, how many odometries came, and
the CPU of the four processes divided by that of an offline run. Latency asks for an idle machine.
"""

import argparse
from contextlib import ExitStack
import os
from pathlib import Path
import subprocess
import sys
import tempfile
import time

from ffmpeg_image_transport_msgs.msg import FFMPEGPacket
from mv_slapse.codec.encoding.encoder import LOW_LATENCY, write_video
from mv_slapse.config import SceneSettings, Settings
from mv_slapse.fields import stamp_from_message
from mv_slapse.simulation.render import Renderer
from mv_slapse.simulation.street import Street, StreetSettings
from mv_slapse.storage.bag_reader import BagReader
from mv_slapse.tools.bag import CAMERA_TOPIC, make_bag, VIDEO_TOPIC
from mv_slapse.tools.run import run
from nav_msgs.msg import Odometry
import numpy as np
import rclpy
from rclpy.qos import DurabilityPolicy, QoSProfile
from sensor_msgs.msg import CameraInfo

SIZES = {'640×480': {}, '720p': {'width': 1280, 'height': 720, 'focal': 1000.0}}
ALL, FOUR = ('all_in_one',), ('decoder', 'plane_extraction', 'slam', 'obstacle_tracker')
WAIT = 60.0  # [s] for nodes to start, and for the last odometry


def cpu_of(process: subprocess.Popen) -> float:
    """Return the CPU time of a process so far [s]."""
    parts = Path(f'/proc/{process.pid}/stat').read_text().rpartition(')')[2].split()
    return (int(parts[11]) + int(parts[12])) / os.sysconf('SC_CLK_TCK')


def started(stack: ExitStack, names, height: float, folder: Path) -> list[subprocess.Popen]:
    """Start nodes as processes, which end with the stack."""
    options = ['--ros-args', '-p', f'scene.camera_height:={height}', '-r',
               f'video:={VIDEO_TOPIC}', '-r', f'camera_info:={CAMERA_TOPIC}']
    nodes = []
    for name in names:
        log = stack.enter_context((folder / f'{name}.log').open('wb'))
        nodes.append(subprocess.Popen([sys.executable, '-m', f'mv_slapse.nodes.{name}', *options],
                                      stdout=log, stderr=log))
        stack.callback(nodes[-1].wait)
        stack.callback(nodes[-1].terminate)
    return nodes


def spin(node, until, seconds: float):
    """Spin until something holds, or so long."""
    end = time.monotonic() + seconds
    while not until() and time.monotonic() < end:
        rclpy.spin_once(node, timeout_sec=0.01)


def play(bag: Path, names, height: float, folder: Path) -> tuple[float, float, list[float], int]:
    """Play a bag into nodes: their CPU and the time it took [s], latencies [s], packets."""
    node, came, sent = rclpy.create_node('player'), {}, {}
    video = node.create_publisher(FFMPEGPacket, VIDEO_TOPIC, QoSProfile(depth=100))
    camera = node.create_publisher(CameraInfo, CAMERA_TOPIC, QoSProfile(
        depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL))
    node.create_subscription(
        Odometry, 'odometry', lambda message: came.setdefault(
            stamp_from_message(message.header.stamp), time.monotonic()), QoSProfile(depth=100))
    with ExitStack() as stack:
        nodes = started(stack, names, height, folder)
        spin(node, lambda: video.get_subscription_count() and camera.get_subscription_count()
             and node.count_publishers('odometry'), WAIT)
        time.sleep(3.0)  # the nodes among themselves
        before, first, begin = sum(map(cpu_of, nodes)), None, time.monotonic()
        for raw, message in BagReader(bag).messages([VIDEO_TOPIC, CAMERA_TOPIC]):
            first = raw.stamp if first is None else first
            spin(node, lambda: False, begin + 1e-9 * (raw.stamp - first) - time.monotonic())
            if raw.topic == VIDEO_TOPIC:
                sent[stamp_from_message(message.header.stamp)] = time.monotonic()
            (video if raw.topic == VIDEO_TOPIC else camera).publish(bytes(raw.data))
        spin(node, lambda: False, 0.1)  # what the last pictures cost
        took, spent = time.monotonic() - begin, sum(map(cpu_of, nodes)) - before
        spin(node, lambda: came and max(came) >= max(sent), 5.0)
    node.destroy_node()
    return spent, took, [came[stamp] - sent[stamp] for stamp in came if stamp in sent], len(sent)


def measure(name: str, frames: int, folder: Path) -> list[str]:
    """Measure one picture size; return the rows of the page."""
    street = Street(StreetSettings(n_frames=frames, movers=('slower', 'faster', 'oncoming'),
                                   **SIZES[name]))
    height, bag = street.settings.camera_height, folder / 'bag'
    write_video(folder / 'street.mp4', [frame.image for frame in Renderer(street).frames()],
                street.settings.fps, LOW_LATENCY)
    make_bag(str(folder / 'street.mp4'), street.camera, None, bag, 10**11)
    settings, spent = Settings(scene=SceneSettings(camera_height=height)), []
    for turn in ('first', 'second'):  # the first loads what is loaded once
        result = run(folder / 'street.mp4', street.camera, settings, folder / turn)
        spent.append(result.cpu_seconds['total'])
    rows = []
    for names in (ALL, FOUR):
        cpu, took, late, packets = play(bag, names, height, folder)
        at = [f'{1e3 * np.percentile(late, share):.0f}' for share in (50, 95)] if late else '--'
        rows.append(f'| {name}, {"all_in_one" if names is ALL else "four nodes"} | '
                    f'{cpu / took:.2f} | {at[0]} | {at[1]} | {len(late)} of {packets} | '
                    f'{cpu / spent[-1]:.2f} |')
    return rows


def main(arguments: list[str] | None = None) -> int:
    """Measure each size and print the table."""
    parser = argparse.ArgumentParser(prog='over_dds.py', description=__doc__,
                                     formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument('--frames', type=int, default=300, help='(default: %(default)s)')
    parser.add_argument('--only', default='', help='only sizes whose name holds this text')
    options = parser.parse_args(arguments)
    rclpy.init()
    print('| played at 30 Hz | share of a core | latency, median [ms] | latency, 95 % [ms] | '
          'odometries of packets | CPU ÷ offline run |\n|' + ' --- |' * 6)
    for name in SIZES:
        if options.only in name:
            with tempfile.TemporaryDirectory() as folder:
                print('\n'.join(measure(name, options.frames, Path(folder))), flush=True)
    rclpy.shutdown()
    return 0


if __name__ == '__main__':
    sys.exit(main())
