"""Are lost packets noticed? Every clip with 1 to 15 packets left out, at many places.

A pair over a loss is one between whose key frames a picture was lost. It must be torn; no pair
of a clean clip may be.
"""

import argparse
from collections import Counter
import json
import sys

from mv_slapse.codec.decoder import CorrespondenceDecoder
from mv_slapse.codec.frames import FrameDecoder
from mv_slapse.codec.packet import Packet
from mv_slapse.codec.segments import Segment, SegmentBuilder
from mv_slapse.config import SceneSettings, Settings
from mv_slapse.pipeline import Slapse
from mv_slapse.records import SceneEstimate, SegmentKind, TrackingStatus
from mv_slapse.storage.camera_info import read_camera
from mv_slapse.storage.tum import read_trajectory, Trajectory
import numpy as np
from reliability import clips

DRIVE = clips.DATA / 'kitti00'
INTRA = 'an I frame without B frames'
LEAD, TAIL = 40, 40  # packets before and after a loss that are decoded


def segments(packets: list[Packet]) -> list[Segment]:
    """Return the segments between the key frames of packets."""
    decoder, builder = FrameDecoder(with_luma=False), SegmentBuilder()
    frames = [frame for packet in packets for frame in decoder.feed(packet)] + decoder.flush()
    return [segment for frame in frames if (segment := builder.add(frame))]


def is_broken(segment: Segment) -> bool:
    """Return whether a pair is broken by damage, not only for want of vectors."""
    return segment.is_torn or (segment.kind is SegmentKind.BROKEN
                               and not segment.reason.startswith(INTRA))


def over_loss(found: list[Segment], lost: list[int]) -> list[Segment]:
    """Return the segments between whose key frames lies a stamp that was lost."""
    return [s for s in found if any(s.previous.stamp < t < s.current.stamp for t in lost)]


def without(packets: list[Packet], first: int, n: int) -> tuple[list[Packet], list[int]]:
    """Return the packets around a loss, and the stamps lost."""
    start = max((i for i in range(first) if packets[i].is_key and i <= first - LEAD), default=0)
    kept = [*packets[start:first], *packets[first + n:first + n + TAIL]]
    return kept, [packet.stamp for packet in packets[first:first + n]]


def measure(packets: list[Packet], places: list[tuple[int, int]]) -> dict[str, object]:
    """Leave out packets at (first, number) and count the pairs over losses that are broken."""
    counts, missed = Counter(), []
    for first, n in places:
        kept, lost = without(packets, first, n)
        found = segments(kept)
        over = over_loss(found, lost)
        torn = [s for s in over if is_broken(s)]
        counts.update(places=1, over=len(over), broken=len(torn),
                      beside=sum(map(is_broken, found)) - len(torn))
        if len(torn) < len(over):
            missed.append((first, n))
    return {**counts, 'missed': missed}


def false_alarms(packets: list[Packet]) -> tuple[int, int]:
    """Return how many pairs of a clean clip are torn, and how many pairs there are."""
    found = segments(packets)
    return sum(map(is_broken, found)), len(found)


def places_in(packets: list[Packet], n: int, seed: int = 0) -> list[tuple[int, int]]:
    """Return n places, each with 1 to 15 packets to leave out."""
    rng = np.random.default_rng(seed)
    begin = min(8, len(packets) // 2)
    end = max(len(packets) - 20, begin + 1)
    return [(int(rng.integers(begin, end)), 1 + i % 15) for i in range(n)]


def lengths(packets: list[Packet], places: list[tuple[int, int]]) -> Counter:
    """Return how many pairs over losses in kitti00 are not broken, and how many are too long.

    Too long, or short, is one that the filter calls OK and whose way differs from the true one by
    more than three standard deviations.
    """
    camera, found = read_camera(DRIVE / 'camera.yaml'), Counter()
    truth = read_trajectory(DRIVE / 'ground_truth.tum')
    settings = Settings(scene=SceneSettings(camera_height=1.65))
    for first, n in places:
        decoder, core = CorrespondenceDecoder(settings.decoder, camera), Slapse(camera, settings)
        kept, lost = without(packets, first, n)
        pairs = [pair for packet in kept for pair in decoder.feed(packet)] + decoder.flush()
        scenes = [core.step(pair).scene for pair in pairs]
        for pair, before, scene in zip(pairs[1:], scenes, scenes[1:], strict=False):
            if any(pair.previous_stamp < stamp < pair.stamp for stamp in lost):
                joined = pair.kind is not SegmentKind.BROKEN and (
                    scene.status is TrackingStatus.OK is before.status)
                found.update(pairs=1, joined=joined, wrong=joined and _is_wrong(
                    before, scene, truth))
    return found


def _is_wrong(before: SceneEstimate, scene: SceneEstimate, truth: Trajectory) -> bool:
    at = np.searchsorted(truth.stamps, (before.stamp, scene.stamp)).clip(max=len(truth) - 1)
    way = scene.t_world_from_cam - before.t_world_from_cam
    length = np.linalg.norm(way)
    along = way / max(length, 1e-9)
    variance = sum(along @ s.pose_covariance[:3, :3] @ along for s in (before, scene))
    return bool(abs(length - np.linalg.norm(np.subtract(*truth.positions[at])))
                > 3 * np.sqrt(variance))


def main() -> int:
    """Print a line for each clip, and return 1 where a bound is not held."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--places', type=int, default=60, help='of each drawn clip')
    parser.add_argument('--given', type=int, default=0, help='places of each given clip')
    parser.add_argument('--clean', type=int, default=0, help='more clips of each kind, whole')
    parser.add_argument('--lengths', type=int, default=0,
                        help='places of each encoding of kitti00 at which lengths are compared')
    parser.add_argument('--json', action='store_true')
    args = parser.parse_args()
    total, alarms, rows = Counter(), np.zeros(2, int), []
    known = [(kind.name, clips.drawn(kind), args.places) for kind in clips.KINDS]
    known += [(name, packets, args.given) for name, packets in clips.given() if args.given]
    for name, packets, n in known:
        found = measure(packets, places_in(packets, n))
        clean = false_alarms(packets)
        uneven = false_alarms(clips.uneven(packets))
        alarms += np.add(clean, uneven)
        missed = found.pop('missed')
        total.update(found)
        rows.append({'clip': name, **found, 'clean': clean, 'uneven': uneven,
                     'missed': missed[:12]})
        if not args.json:
            print(rows[-1], flush=True)
    for kind in clips.KINDS:
        for seed in range(1, args.clean + 1):
            packets = clips.drawn(kind, seed=seed)
            total.update({'clean pictures': len(packets)})
            alarms += false_alarms(packets)
    if args.lengths:
        for name, packets in clips.given():
            if name.startswith(DRIVE.name):
                of_one = lengths(packets, places_in(packets, args.lengths))
                print({'clip': name, **of_one}, flush=True)
                total.update({f'lengths: {key}': n for key, n in of_one.items()})
    share = total['broken'] / max(total['over'], 1)
    print(json.dumps({**total, 'share': round(share, 5), 'false alarms': int(alarms[0]),
                      'clean pairs': int(alarms[1]), **({'clips': rows} if args.json else {})}))
    return int(bool(total['over']) and share < 0.99 or alarms[0] > 0
                    or total['lengths: wrong'] > 0)


if __name__ == '__main__':
    sys.exit(main())
