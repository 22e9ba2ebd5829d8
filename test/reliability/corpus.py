"""Damaged streams that are kept, one of each coding: another FFmpeg would make others of a seed.

python reliability/corpus.py    writes them anew
"""

from pathlib import Path
import sys

from mv_slapse.codec.packet import Packet
import numpy as np
from reliability import clips, mutations

FOLDER = Path(__file__).parent / 'corpus'
PICTURES = 8


def write(folder: Path):
    """Damage a clip of each kind, in turn in each way, and keep it."""
    folder.mkdir(exist_ok=True)
    for i, kind in enumerate(clips.KINDS):
        packets = mutations.damaged(clips.drawn(kind, PICTURES), i % len(mutations.MUTATIONS),
                                    np.random.default_rng(i))
        np.savez_compressed(
            folder / f'{kind.name}.npz', data=np.frombuffer(b''.join(
                packet.data for packet in packets), np.uint8),
            sizes=[len(packet.data) for packet in packets],
            stamps=np.array([packet.stamp for packet in packets]),
            keys=[packet.is_key for packet in packets], codec=kind.codec())


def read(path: Path) -> list[Packet]:
    """Return the packets of a stream that was kept."""
    with np.load(path) as kept:
        parts = np.split(kept['data'], np.cumsum(kept['sizes'])[:-1])
        return [Packet(part.tobytes(), int(stamp), bool(is_key), str(kept['codec']))
                for part, stamp, is_key in zip(parts, kept['stamps'], kept['keys'], strict=True)]


if __name__ == '__main__':
    sys.exit(write(FOLDER))
