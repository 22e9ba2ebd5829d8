"""What comes of it where a node is killed? SIGKILL of each of the four while a street is driven.

A real clip is published in real time; the nodes run as the launch file starts them.
Told are the seconds until a tracked pose (or obstacles) of a later key frame comes again, what the
position then misses, and whether map and trajectory are the same.
"""

import argparse
from dataclasses import dataclass, field, replace
import json
import os
from pathlib import Path
import random
import signal
import statistics
import subprocess
import sys
import time

from diagnostic_msgs.msg import DiagnosticArray
from ffmpeg_image_transport_msgs.msg import FFMPEGPacket
from mv_slapse.codec.encoding.encoder import encode, LOW_LATENCY
from mv_slapse.codec.packet import Packet
from mv_slapse.codec.source import open_source
from mv_slapse.fields import stamp_from_message
from mv_slapse.geometry.plane import WELL_SEEN
from mv_slapse.nodes.conversions import to_message
from mv_slapse.records import TrackingStatus
from mv_slapse.storage.tum import read_trajectory
from mv_slapse.tools.inputs import pictures
from mv_slapse.video_messages import packet_to_fields
from mv_slapse_msgs.msg import ObstacleArray, PlaneMap
from nav_msgs.msg import Odometry
import numpy as np
import rclpy
from rclpy.qos import DurabilityPolicy, QoSProfile

ROOT = Path(__file__).resolve().parents[2]
CLIP = ROOT.parent / 'shared' / 'data' / 'kitti00'
VIDEO, SIZE = CLIP / 'mpeg2.mpg', (1240, 376)
ROBOT = replace(LOW_LATENCY, gop=10)  # a key picture each second, a pair each picture
FOUR = ('decoder', 'plane_extraction', 'slam', 'obstacle_tracker')
NEEDED = {'decoder': 'video', 'plane_extraction': 'correspondences',  # topic of each
          'slam': 'planes/observations', 'obstacle_tracker': 'planes/observations'}
PERIOD = 0.1  # [s] between two pictures
UNSEEN = 3  # pictures that come while a node starts: they end one pair of the clip at most
QUIET = 2.0  # [s] without an output after which all that was published has been worked off
PATIENCE = 20.0  # [s]


@dataclass(frozen=True)
class Outcome:
    """What came of killing a node."""

    node: str
    seconds: float  # until it works again
    missed: float  # [m] of the way since before the kill, against the truth
    same: bool  # whether the trajectory goes on in the same local map
    kept: bool  # whether the walls that were seen well are still in the map
    where: tuple[float, float, float] = field(default=(0.0, 0.0, 0.0))  # of the first pose after


class Line:
    """The four nodes, each a process."""

    def __init__(self, folder: Path):
        self._folder, self._processes = folder, {}
        for name in FOUR:
            self._start(name)

    def _start(self, name: str):
        command = [sys.executable, '-m', f'mv_slapse.nodes.{name}', '--standby', '--ros-args',
                   '-p', 'scene.camera_height:=1.65', '-p', 'tf_wait:=0.0']
        if name in FOUR[:2]:
            command += ['-p', f'camera_info_url:={CLIP / "camera.yaml"}']
        with (self._folder / f'{name}.log').open('ab') as log:
            self._processes[name] = subprocess.Popen(
                command, env={**os.environ, 'PYTHONPATH': str(ROOT)}, cwd=self._folder,
                stdout=log, stderr=subprocess.STDOUT)

    def kill(self, name: str):
        """Kill the node; the process that starts it again is its parent."""
        parent = self._processes[name].pid
        node, *_ = Path(f'/proc/{parent}/task/{parent}/children').read_text().split()
        os.kill(int(node), signal.SIGKILL)  # the first; the other one waits to follow it

    def stop(self) -> list[int]:
        for process in self._processes.values():
            process.send_signal(signal.SIGINT)
        return [process.wait(20) for process in self._processes.values()]


class Drive:
    """Publishes the clip in real time, and keeps what comes back."""

    def __init__(self, low_latency: bool = False):
        self.node = rclpy.create_node('drive')
        self._packets = _packets(low_latency)
        self._truth = read_trajectory(CLIP / 'ground_truth.tum')
        self._video = self.node.create_publisher(FFMPEGPacket, 'video', 100)
        self.poses, self.maps, self.obstacles = {}, {}, {}
        latched = QoSProfile(depth=100, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        for kind, topic, kept, profile in (
                (Odometry, 'odometry', self.poses, QoSProfile(depth=100)),
                (PlaneMap, 'planes/map', self.maps, latched),
                (ObstacleArray, 'obstacles', self.obstacles, QoSProfile(depth=100))):
            self.node.create_subscription(kind, topic, self._keep(kept), profile)
        self.heard = {}  # name of a node -> when it last said that what it needs is connected
        self.said = {}  # the same -> what it said last of itself
        self.node.create_subscription(DiagnosticArray, '/diagnostics', self._hear, 100)
        self._begin, self._due, self._next = 0, 0.0, 0
        self.sent = 0  # stamp of the latest picture that was published [ns]

    def _hear(self, msg: DiagnosticArray):
        for one in msg.status:
            values = {item.key: item.value for item in one.values}
            self.said[one.name] = one.message, values
            if values.get(f'publishers of /{NEEDED.get(one.name)}', '0') != '0':
                self.heard[one.name] = time.monotonic()

    @staticmethod
    def _keep(kept):
        return lambda msg: kept.__setitem__(stamp_from_message(msg.header.stamp), msg)

    def begin(self):
        """Drive until there are poses, from the clip's beginning where it does not last."""
        if not 0 < self._next < len(self._packets) // 3:
            self.rewind()
        n = len(self.tracked()) + 6
        assert self.spin(lambda: len(self.tracked()) >= n), 'there are no poses'

    def rewind(self):
        """Begin the clip again, long after."""
        for kept in (self.poses, self.maps, self.obstacles):
            kept.clear()
        self._begin += 1000 * 10**9
        self._due, self._next = time.monotonic(), 0

    def settle(self):
        """Stand until all that was published has been worked off, which takes long if busy."""
        newest = None
        while newest != (newest := max(self.maps)):
            self.wait(QUIET, False)

    def pictures(self, n: int):
        """Drive on for so many pictures."""
        last = min(self._next + n, len(self._packets))
        assert self.spin(lambda: self._next >= last)

    def ready(self, drive: bool = True) -> bool:
        """Wait for all nodes; two read the map, and the tracker the poses.

        One that was killed counts until DDS takes it for gone, some 20 s later.
        """
        count = self.node.count_subscribers
        return self.spin(lambda: count('video') == 1 and count('correspondences') == 1
                         and count('planes/observations') == 2 and count('odometry') == 2
                         and count('obstacles') == 1, 60, drive and self._next > 0)

    def connected(self) -> bool:
        """Stand until each node says that what it needs is connected, from now on."""
        began = time.monotonic()
        return self.spin(lambda: all(self.heard.get(name, 0.0) > began for name in FOUR), 60,
                         False)

    def spin(self, until, timeout: float = PATIENCE, drive: bool = True) -> bool:
        """Drive on until a condition holds; return whether it did in time."""
        end = time.monotonic() + timeout
        while not until() and time.monotonic() < end:
            rclpy.spin_once(self.node, timeout_sec=0.05)
            if drive and time.monotonic() >= self._due and self._next < len(self._packets):
                packet = self._packets[self._next]
                moved = type(packet)(packet.data, packet.stamp + self._begin, packet.is_key,
                                     packet.codec, packet.extradata)
                self._video.publish(to_message(FFMPEGPacket, packet_to_fields(
                    moved, SIZE, self._next, 'cam')))
                self.sent = max(self.sent, moved.stamp)
                self._next += 1
                self._due = max(self._due + PERIOD, time.monotonic() - PERIOD)
        return bool(until())

    def wait(self, seconds: float, drive: bool = True):
        """Drive on, or stand, for so long."""
        end = time.monotonic() + seconds
        self.spin(lambda: time.monotonic() >= end, seconds + 1, drive)

    def tracked(self) -> list[int]:
        """Return the stamps of this run that have a tracked pose."""
        return [stamp for stamp in sorted(self.maps) if stamp > self._begin and stamp in self.poses
                and self.maps[stamp].tracking == TrackingStatus.OK]

    def position(self, stamp: int) -> np.ndarray:
        p = self.poses[stamp].pose.pose.position
        return np.array([p.x, p.y, p.z])

    def missed(self, before: int, after: int) -> float:
        """Return the length by which a way differs from the true one [m]."""
        at = [int(np.abs(self._truth.stamps + self._begin - s).argmin()) for s in (before, after)]
        true = np.linalg.norm(np.subtract(*self._truth.positions[at]))
        return float(abs(np.linalg.norm(self.position(after) - self.position(before)) - true))


def _packets(low_latency: bool) -> list[Packet]:
    if low_latency:
        return list(encode(pictures(VIDEO), 1 / PERIOD, ROBOT))
    with open_source(VIDEO) as source:
        return list(source.packets())


def killed(drive: Drive, line: Line, name: str, stands: bool = False) -> Outcome:
    """Kill a node, and wait until what it is needed for comes again.

    ``stands``: but for one pair no picture comes until it is back and all that was killed is gone
    for the others, which takes long on a busy machine.
    """
    if stands:
        drive.settle()
    before = drive.tracked()[-1]
    sent, result = drive.sent, drive.obstacles if name == 'obstacle_tracker' else drive.maps
    line.kill(name)
    begin = time.monotonic()
    if stands:
        drive.pictures(UNSEEN)
        assert drive.ready(False), name
        assert drive.connected(), name
    # what was on its way when the process ended may still come, the later the busier it is
    earliest = max(sent, max(result, default=0))

    def works():
        if name == 'obstacle_tracker':
            return max(drive.obstacles, default=0) > earliest
        return drive.tracked()[-1] > earliest

    assert drive.spin(works), f'{name} does not work again: {drive.said}'
    seconds, after = time.monotonic() - begin, drive.tracked()[-1]
    same = drive.maps[after].began == drive.maps[before].began
    walls = {(p.id, p.first_seen.sec) for p in drive.maps[before].planes
             if p.n_observations >= WELL_SEEN and not p.is_ground}
    kept = walls <= {(p.id, p.first_seen.sec) for p in drive.maps[after].planes}
    first = next((s for s in drive.tracked() if s > earliest), after)
    return Outcome(name, seconds, drive.missed(before, after), same, kept,
                   tuple(drive.position(first).tolist()))


def main() -> int:
    """Kill nodes at random moments; print what came of it."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--moments', type=int, default=8, help='in all (default: 8)')
    parser.add_argument('--low-latency', action='store_true', help='H.264 with a pair each 0.1 s '
                        'and a key picture each second, for MPEG-2 with one each 0.4 and 1.2 s')
    parser.add_argument('--often', action='store_true', help='kill the next one as soon as there '
                        'are poses again; DDS holds those before for alive some 20 s')
    parser.add_argument('--log', type=Path, default=Path('/tmp'), help='folder of the logs')
    args = parser.parse_args()
    rclpy.init()
    drive, line, found = Drive(args.low_latency), Line(args.log), []
    rng = random.Random(0)
    try:
        for i in range(args.moments):
            assert i and args.often or drive.ready(), 'the nodes do not find one another'
            drive.begin()
            drive.wait(rng.uniform(0, 4))
            found.append(killed(drive, line, FOUR[i % 4]))
            print(found[-1], file=sys.stderr, flush=True)
    finally:
        line.stop()
    print(json.dumps({name: _summary([o for o in found if o.node == name])
                      for name in FOUR[:len(found)]}))
    rclpy.shutdown()
    return 0


def _summary(outcomes: list[Outcome]) -> dict[str, object]:
    seconds = [o.seconds for o in outcomes]
    return {'kills': len(outcomes), 'median [s]': round(statistics.median(seconds), 2),
            'worst [s]': round(max(seconds), 2),
            'worst miss [m]': round(max(o.missed for o in outcomes), 2),
            'same local map': sum(o.same for o in outcomes),
            'walls kept': sum(o.kept for o in outcomes)}


if __name__ == '__main__':
    sys.exit(main())
