"""Coded clips of every codec and B-frame pattern, drawn, and the given ones."""

from bisect import bisect_right
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from fractions import Fraction
from pathlib import Path

import av
from mv_slapse.codec.packet import Packet
from mv_slapse.codec.source import open_source
import numpy as np
import pictures

DATA = Path(__file__).resolve().parents[2].parent / 'shared' / 'data'
X264 = 'scenecut=0:rc-lookahead=0:sync-lookahead=0:threads=1:sliced-threads=0'


@dataclass(frozen=True)
class Kind:
    """How a clip is coded: FFmpeg's encoder, B frames, pictures in a group, its options."""

    name: str
    encoder: str
    b_frames: int
    gop: int
    options: str = ''
    fps: int = 25

    def codec(self) -> str:
        """Return FFmpeg's name of the decoder."""
        return {'libx264': 'h264', 'flv': 'flv1'}.get(self.encoder, self.encoder)


KINDS = (
    *(Kind(f'mpeg2-b{b}', 'mpeg2video', b, 12) for b in (0, 1, 2, 3)),
    Kind('mpeg2-10hz', 'mpeg2video', 1, 12, fps=10), Kind('mpeg2-b2-g15', 'mpeg2video', 2, 15),
    *(Kind(f'mpeg1-b{b}', 'mpeg1video', b, 12) for b in (0, 2)),
    *(Kind(f'mpeg4-b{b}', 'mpeg4', b, 12) for b in (0, 1, 2)),
    Kind('h263', 'h263', 0, 12), Kind('flv1', 'flv', 0, 12),
    Kind('h264-b0', 'libx264', 0, 30, 'ref=1:b-adapt=0'),
    *(Kind(f'h264-b{b}', 'libx264', b, 24, 'ref=1:b-adapt=0:b-pyramid=none')
      for b in (1, 2, 3)),
    Kind('h264-pyramid', 'libx264', 3, 30, 'ref=3:b-adapt=1:b-pyramid=normal'),
    Kind('h264-open', 'libx264', 3, 12, 'ref=1:b-adapt=0:b-pyramid=none:open-gop=1'),
    Kind('h264-refs', 'libx264', 0, 250, 'ref=4'),
    Kind('h264-refresh', 'libx264', 0, 30, 'ref=1:intra-refresh=1'))


def drawn(kind: Kind, n: int = 150, seed: int = 0) -> list[Packet]:
    """Return the packets of a clip of n pictures, in the order of decoding, with true stamps."""
    size = (176, 144) if kind.encoder == 'h263' else (192, 160)
    images = pictures.sliding(np.random.default_rng(seed), n, (2, 1), size)
    context = av.CodecContext.create(kind.encoder, 'w')
    context.width, context.height, context.pix_fmt = *size, 'yuv420p'
    context.time_base, context.framerate = Fraction(1, kind.fps), Fraction(kind.fps)
    context.gop_size, context.max_b_frames, context.thread_count = kind.gop, kind.b_frames, 1
    context.options = ({'crf': '20', 'x264-params': f'{kind.options}:{X264}'}
                       if kind.encoder == 'libx264'
                       else {'flags': '+qscale', 'sc_threshold': '1000000000',
                             'b_strategy': '0'})
    coded = []
    for i, image in enumerate(images):
        picture = av.VideoFrame.from_ndarray(image, 'gray').reformat(format='yuv420p')
        picture.pts, picture.time_base = i, context.time_base
        coded += context.encode(picture)
    step = 1_000_000_000 // kind.fps
    return [Packet(bytes(packet), packet.pts * step, bool(packet.is_keyframe), kind.codec(), b'')
            for packet in coded + context.encode(None)]


def uneven(packets: list[Packet], seed: int = 0, spread: float = 0.6) -> list[Packet]:
    """Return the packets with stamps of a variable rate, still in the order of showing."""
    order = sorted(packet.stamp for packet in packets)
    steps = np.random.default_rng(seed).uniform(1 - spread, 1 + spread, len(order)) * 40e6
    new = dict(zip(order, np.cumsum(steps).astype(int).tolist(), strict=True))
    return [replace(packet, stamp=new[packet.stamp]) for packet in packets]


def paused(packets: list[Packet], at: Iterable[int], pause: int = 3) -> list[Packet]:
    """Return the packets of a camera that took no picture for some periods before some of them."""
    step, late = 40_000_000, sorted(at)
    shown = {stamp: stamp + (pause - 1) * step * bisect_right(late, i)
             for i, stamp in enumerate(sorted(packet.stamp for packet in packets))}
    return [replace(packet, stamp=shown[packet.stamp]) for packet in packets]


def given() -> Iterator[tuple[str, list[Packet]]]:
    """Yield the given clips, as far as they are there."""
    for path in sorted(DATA.glob('**/*')):
        if path.suffix in ('.mp4', '.mpg'):
            with open_source(path) as source:
                yield str(path.relative_to(DATA)), list(source.packets())
