"""Does it stay the same for hours? Video through decoder, core and results, again and again.

A drawn clip of 640x480 is played over and over, each time later by its length, as fast as it goes.
Memory, threads and open files are noted on the way, and the CPU time of a pair; what they grow by
in an hour of video is fitted to the second half.
"""

import argparse
from dataclasses import replace
import json
import os
from pathlib import Path
import sys
import tempfile
import threading
import time

from mv_slapse.codec.decoder import CorrespondenceDecoder
from mv_slapse.codec.encoding.encoder import encode, LOW_LATENCY
from mv_slapse.config import Settings
from mv_slapse.geometry.camera import Camera
from mv_slapse.pipeline import Slapse
from mv_slapse.storage.results import ResultsWriter
import numpy as np
import pictures

SIZE, RATE, FRAMES = (640, 480), 30, 90
MEMORY = 0.5  # MB that may come in an hour
SLOWER = 1.2  # times a pair may take at the end


def memory() -> float:
    """Return what the process holds [MB]."""
    pages = int(Path('/proc/self/statm').read_text().split()[1])
    return pages * os.sysconf('SC_PAGE_SIZE') / 1e6


def play(minutes: float, folder: str) -> dict[str, object]:
    """Play so many minutes of video, and return what was measured."""
    camera = Camera(*SIZE, np.array([[500.0, 0, 320], [0, 500, 240], [0, 0, 1]]))
    clip = list(encode(pictures.sliding(np.random.default_rng(0), FRAMES, (3, 1), SIZE), RATE,
                       LOW_LATENCY))
    decoder, core = CorrespondenceDecoder(Settings().decoder, camera), Slapse(camera, Settings())
    rounds, rows, pairs = max(round(minutes * 60 * RATE / FRAMES), 4), [], 0
    with ResultsWriter(folder) as writer:
        for k in range(rounds):
            begin, before = time.process_time(), pairs
            late = k * FRAMES * 1_000_000_000 // RATE
            for packet in clip:
                for pair in decoder.feed(replace(packet, stamp=packet.stamp + late)):
                    writer.write(core.step(pair))
                    pairs += 1
            cost = 1000 * (time.process_time() - begin) / max(pairs - before, 1)
            rows.append((k * FRAMES / RATE / 3600, memory(), cost, threading.active_count(),
                         len(os.listdir('/proc/self/fd'))))
    return summary(np.array(rows), pairs)


def summary(rows: np.ndarray, pairs: int) -> dict[str, object]:
    """Return slopes over the second half of the rows, and the bounds they are held to."""
    late = rows[len(rows) // 2:]
    slope = float(np.polyfit(late[:, 0], late[:, 1], 1)[0])
    third = max(len(rows) // 3, 1)
    slower = float(np.median(rows[-third:, 2]) / np.median(rows[third:2 * third, 2]))
    steady = bool(np.all(late[:, 3:] == late[0, 3:]))
    return {'hours of video': round(float(rows[-1, 0]), 3), 'pairs': pairs,
            'memory [MB]': round(float(rows[-1, 1]), 1), 'MB an hour': round(slope, 2),
            'ms a pair': round(float(np.median(rows[:, 2])), 2), 'slower by': round(slower, 3),
            'threads and files constant': steady}


def main() -> int:
    """Print what was measured; return 1 where an hour or more does not hold the bounds."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--minutes', type=float, default=1.0, help='of video (default: 1)')
    args = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        found = play(args.minutes, folder)
    print(json.dumps(found))
    bad = not found['threads and files constant'] or found['slower by'] > SLOWER
    # Within minutes the allocator's own steps hide the slope.
    return int(bad or (args.minutes >= 60 and found['MB an hour'] > MEMORY))


if __name__ == '__main__':
    sys.exit(main())
