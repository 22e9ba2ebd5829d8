"""One bit flipped a second in a real drive: how far off is the way, and does it say so?

Each encoding of kitti00, with a bit of a packet flipped once in every second of the stream,
several times; the position's error and how often it is within three standard deviations, beside
those of the clean stream.
"""

import argparse
from dataclasses import replace
import json
import statistics
import sys
import tempfile

from mv_slapse.codec.decoder import CorrespondenceDecoder
from mv_slapse.codec.packet import Packet
from mv_slapse.codec.source import open_source
from mv_slapse.config import SceneSettings, Settings
from mv_slapse.storage.camera_info import read_camera
from mv_slapse.tools.eval import evaluate
from mv_slapse.tools.run import Decoded, replay
import numpy as np
from reliability.clips import DATA

FOLDER = DATA / 'kitti00'
SETTINGS = Settings(scene=SceneSettings(camera_height=1.65))
KEPT = 'ate_rigid_mean_percent', 'position_covered_percent'
MOST, LEAST = 2.0, 95.0  # times the clean error; per cent of the positions within 3 sigma


def flipped(packets: list[Packet], rng: np.random.Generator, period: float = 1.0) -> list[Packet]:
    """Return the packets with one bit flipped in each period [s]."""
    damaged = list(packets)
    seconds = np.array([packet.stamp for packet in packets]) // round(period * 1e9)
    for second in np.unique(seconds):
        i = int(rng.choice(np.flatnonzero(seconds == second)))
        data = bytearray(packets[i].data)
        at = int(rng.integers(len(data) * 8))
        data[at // 8] ^= 1 << at % 8
        damaged[i] = replace(packets[i], data=bytes(data))
    return damaged


def figures(name: str, packets: list[Packet], folder: str) -> dict[str, float]:
    """Run packets of a video, and return its errors."""
    camera = read_camera(FOLDER / 'camera.yaml')
    decoder = CorrespondenceDecoder(SETTINGS.decoder, camera)
    pairs = [pair for packet in packets for pair in decoder.feed(packet)] + decoder.flush()
    replay(Decoded(name, pairs, [packet.stamp for packet in packets], 0.0), camera, SETTINGS,
           folder)
    found = evaluate(folder, FOLDER / 'ground_truth.tum')
    broken = sum(not len(pair) for pair in pairs)
    return {key: found[key] for key in KEPT} | {'broken': broken, 'pairs': len(pairs)}


def main() -> int:
    """Print a row for each encoding; return 1 where one does not hold the bounds."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--seeds', type=int, default=10, help='of each encoding (default: 10)')
    parser.add_argument('--only', default='', help='encodings whose name holds this')
    args = parser.parse_args()
    bad = 0
    for video in sorted(p for p in FOLDER.iterdir() if p.suffix in ('.mp4', '.mpg')):
        if args.only not in video.name:
            continue
        with open_source(video) as source:
            packets = list(source.packets())
        with tempfile.TemporaryDirectory() as folder:
            clean = figures(video.name, packets, folder)
            found = [figures(video.name, flipped(packets, np.random.default_rng(seed)), folder)
                     for seed in range(args.seeds)]
        error = [row[KEPT[0]] for row in found]
        covered = [row[KEPT[1]] for row in found]
        broken, pairs = (sum(row[key] for row in found) for key in ('broken', 'pairs'))
        row = {'video': video.name, 'clean [%]': round(clean[KEPT[0]], 3),
               'median [%]': round(statistics.median(error), 3), 'worst [%]': round(max(error), 3),
               'clean covered [%]': round(clean[KEPT[1]], 1),
               'covered [%]': round(statistics.mean(covered), 1), 'least': round(min(covered), 1),
               'broken': f'{broken} of {pairs} pairs'}
        print(json.dumps(row), flush=True)
        bad += (statistics.median(error) > MOST * clean[KEPT[0]]
                or statistics.mean(covered) < LEAST)
    return int(bool(bad))


if __name__ == '__main__':
    sys.exit(main())
