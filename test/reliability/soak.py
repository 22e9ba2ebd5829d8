"""Does it stay the same for hours? Video through `mv_slapse run`, and through `all_in_one`.

A given clip of 640x480 is played over and over, as fast as it is taken, into a process: out of a
FIFO, or as messages over DDS. The process' memory, threads, open files and CPU time are noted on
the way; what the memory grows by in an hour of video is fitted to the second half.
"""

import argparse
from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace
from itertools import islice
import json
import os
from pathlib import Path
import signal
import subprocess
import sys
import tempfile
import time

from mv_slapse.codec.packet import Packet
from mv_slapse.codec.source import open_source
from mv_slapse.video_messages import in_band
import numpy as np
from reliability.clips import DATA

FOLDER = DATA / 'parking'
RATE, FRAMES = 30, 150  # pictures of five seconds
PERIOD = 1_000_000_000 // RATE
AHEAD = 30  # pictures that are sent before the map of the first is there
MEMORY = 0.5  # MB that may come in an hour
SLOWER = 1.2  # times a picture may take at the end
TICK, PAGE = os.sysconf('SC_CLK_TCK'), os.sysconf('SC_PAGE_SIZE')


def clip() -> list[Packet]:
    """Return five seconds of H.264 without B frames, as streams have it."""
    with open_source(FOLDER / 'h264_lowlatency.mp4') as source:
        packets = list(islice(source.packets(), FRAMES))
    return [replace(packet, data=in_band(packet), extradata=b'') for packet in packets]


class Watch:
    """A process, and what it holds after each clip."""

    def __init__(self, command: list[str], folder: Path):
        """Start the process."""
        self._log = (folder / 'log').open('wb')
        self.process = subprocess.Popen(command, cwd=folder, stdout=self._log, stderr=self._log)
        self._rows: list[tuple[float, ...]] = []

    def note(self):
        """Note what the process holds: hours of video, MB, CPU [s], threads, files."""
        folder = Path(f'/proc/{self.process.pid}')
        words = (folder / 'stat').read_text().rpartition(')')[2].split()
        hours = (len(self._rows) + 1) * FRAMES / RATE / 3600
        self._rows.append((hours, int((folder / 'statm').read_text().split()[1]) * PAGE / 1e6,
                           (int(words[11]) + int(words[12])) / TICK, int(words[17]),
                           len(os.listdir(folder / 'fd'))))

    def end(self) -> int:
        """Ask the process to end, and return its exit code."""
        if self.process.poll() is None:
            self.process.send_signal(signal.SIGINT)
        code = self.process.wait(120)
        self._log.close()
        return code

    def summary(self, said: str = '') -> dict[str, object]:
        """Return slopes over the second half of the rows, and the bounds they are held to."""
        rows = np.array(self._rows)
        late, third = rows[len(rows) // 2:], max(len(rows) // 3, 1)
        cost = 1000 * np.diff(rows[:, 2]) / FRAMES
        slope = float(np.polyfit(late[:, 0], late[:, 1], 1)[0])
        slower = float(np.mean(cost[-third:]) / max(np.mean(cost[third:2 * third]), 1e-3))
        return {'through': said, 'hours of video': round(float(rows[-1, 0]), 3),
                'memory [MB]': [round(float(row[1]), 1) for row in (rows[0], late[0], rows[-1])],
                'MB an hour': round(slope, 2), 'ms a picture': round(float(np.mean(cost)), 2),
                'slower by': round(slower, 3),
                'threads and files constant': bool(np.all(late[:, 3:] == late[0, 3:]))}


def through_run(rounds: int, folder: Path) -> dict[str, object]:
    """Play the clip out of a FIFO into the command line."""
    os.mkfifo(folder / 'video')
    watch = Watch([sys.executable, '-m', 'mv_slapse', 'run', str(folder / 'video'), '--camera',
                   str(FOLDER / 'camera.yaml'), '-o', str(folder / 'out'), '--quiet'], folder)
    data = b''.join(packet.data for packet in clip())
    with suppress(BrokenPipeError), (folder / 'video').open('wb') as video:
        for _ in range(rounds):
            video.write(data)
            watch.note()
    code = watch.process.wait(600)
    assert code in (0, 4), (folder / 'log').read_text()[-2000:]
    assert json.loads((folder / 'out' / 'summary.json').read_text())['frames'] >= (
        rounds * FRAMES - 1)
    return watch.summary('mv_slapse run')


def through_node(rounds: int, folder: Path) -> dict[str, object]:
    """Publish the clip for the node, no farther ahead than it works."""
    import rclpy
    rclpy.init()
    watch = Watch([sys.executable, '-m', 'mv_slapse.nodes.all_in_one', '--ros-args', '-p',
                   f'camera_info_url:={FOLDER / "camera.yaml"}', '-p', 'tf_wait:=0.0',
                   '-p', 'max_latency:=3600.0'], folder)
    try:
        _publish(rclpy, rounds, watch.note)
    finally:
        rclpy.shutdown()
        code = watch.end()
    assert code == 0, (folder / 'log').read_text()[-2000:]
    return watch.summary('all_in_one over DDS')


def _publish(rclpy, rounds: int, note: Callable[[], None]):
    from ffmpeg_image_transport_msgs.msg import FFMPEGPacket
    from mv_slapse.fields import stamp_from_message
    from mv_slapse.nodes.conversions import stamp_to_msg, to_message
    from mv_slapse.video_messages import packet_to_fields
    from mv_slapse_msgs.msg import PlaneMap
    node, done = rclpy.create_node('soak'), [0]
    node.create_subscription(PlaneMap, 'planes/map', lambda msg: done.__setitem__(
        0, stamp_from_message(msg.header.stamp)), 10)
    video = node.create_publisher(FFMPEGPacket, 'video', 100)
    spin(rclpy, node, lambda: video.get_subscription_count())
    messages = [to_message(FFMPEGPacket, packet_to_fields(packet, (640, 480), i, 'eye'))
                for i, packet in enumerate(clip())]
    first = 10**18
    for k in range(rounds):
        for i, message in enumerate(messages):
            stamp = first + (k * FRAMES + i) * PERIOD
            spin(rclpy, node, lambda stamp=stamp: not done[0] and stamp < first + AHEAD * PERIOD
                 or stamp - done[0] < AHEAD * PERIOD)
            message.header.stamp = stamp_to_msg(stamp)
            video.publish(message)
        note()
    spin(rclpy, node, lambda: done[0] > stamp - AHEAD * PERIOD)
    node.destroy_node()


def spin(rclpy, node, until: Callable[[], object], patience: float = 120.0):
    """Spin until something holds; raise where it does not."""
    end = time.monotonic() + patience
    while not until():
        assert time.monotonic() < end, 'the node says no more'
        rclpy.spin_once(node, timeout_sec=0.1)


WAYS = {'run': through_run, 'node': through_node}


def play(way: str, minutes: float, folder: Path) -> dict[str, object]:
    """Play so many minutes of video, and return what was measured."""
    return WAYS[way](max(round(minutes * 60 * RATE / FRAMES), 4), Path(folder))


def main() -> int:
    """Print what was measured; return 1 where an hour or more does not hold the bounds."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--minutes', type=float, default=1.0, help='of video (default: 1)')
    parser.add_argument('--only', choices=WAYS, help='default: both')
    args, bad = parser.parse_args(), False
    for way in [args.only] if args.only else WAYS:
        with tempfile.TemporaryDirectory() as folder:
            found = play(way, args.minutes, Path(folder))
        print(json.dumps(found), flush=True)
        bad |= not found['threads and files constant'] or found['slower by'] > SLOWER
        # Within minutes the allocator's own steps hide the slope.
        bad |= args.minutes >= 60 and found['MB an hour'] > MEMORY
    return int(bad)


if __name__ == '__main__':
    sys.exit(main())
