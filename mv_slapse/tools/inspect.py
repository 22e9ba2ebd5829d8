"""``mv_slapse inspect``: what a video offers, and whether that is enough."""

from collections.abc import Iterator
from dataclasses import asdict, dataclass, replace
from itertools import islice
from typing import Any

from mv_slapse.codec.packet import Packet
from mv_slapse.config import EncoderSettings
from mv_slapse.errors import UnusableInput
from mv_slapse.tools.inputs import is_from_bag, open_input, RECODED
from mv_slapse.tools.probe import Probe, probe, UNUSABLE, USABLE, WITH_CARE

LABELS = {'codec': 'codec', 'size': 'picture [px]', 'fps': 'rate [1/s]', 'n_frames': 'frames read',
          'references': 'reference frames', 'b_frames': 'B frames in a row',
          'gop': 'frames between I frames', 'vectors_per_frame': 'vectors a frame',
          'share_with_vectors': 'P and B frames with vectors', 'interlaced': 'interlaced'}


@dataclass(frozen=True)
class _Stream:
    """Packets that have been read, as ``probe`` wants them."""

    codec: str
    width: int
    height: int
    fps: float
    coded: list[Packet]

    def packets(self) -> Iterator[Packet]:
        """Return the packets in the order of decoding."""
        return iter(self.coded)


def inspect(name: str, topic: str | None = None, max_frames: int = 300,
            encoder: EncoderSettings | None = None) -> dict[str, Any]:
    """Return the findings about a video file, a URL, a folder of pictures or a bag's video topic.

    Raises
    ------
    UnusableInput, UsageError
        Where there is no such input, or no video with motion vectors in it.
    """
    with open_input(name, topic, encoder) as source:
        packets = list(islice(source.packets, max_frames))
        if not packets and is_from_bag(name, topic):
            raise UnusableInput(f'{name}: the video topic has no messages')
        codec = packets[0].codec if packets else ''
        found = probe(_Stream(codec, *(source.size or (0, 0)), source.fps or _rate(packets),
                              packets), max_frames)
        if recoded := source.recoder.recoded:
            found = _with_care(replace(found, codec=recoded), RECODED,
                               'set the camera to H.264 without B frames')
        for skipped in source.skipped():
            found = _with_care(found, skipped, 'look into the log of its publisher')
        return {'input': name, **asdict(found)}


def is_usable(report: dict[str, Any]) -> bool:
    """Return whether a run on this video makes sense."""
    return report['verdict'] != UNUSABLE


def text(report: dict[str, Any]) -> str:
    """Return findings as lines: facts, verdict, reasons and what to do."""
    shown = {**report, 'size': f'{report["width"]}x{report["height"]}',
             'fps': f'{report["fps"]:g}' if report['fps'] else 'not told',
             'vectors_per_frame': f'{report["vectors_per_frame"]:.0f}',
             'share_with_vectors': f'{100 * report["share_with_vectors"]:.0f} %',
             'interlaced': 'yes' if report['interlaced'] else 'no'}
    width = max(map(len, LABELS.values()))
    facts = [f'{label:{width}}  {shown[name]}' for name, label in LABELS.items()]
    findings = [line for reason, advice in zip(report['reasons'], report['advice'], strict=True)
                for line in (f'  because: {reason}', f'  do this: {advice}')]
    return '\n'.join([report['input'], *facts, f'verdict: {report["verdict"]}', *findings])


def _with_care(found: Probe, reason: str, advice: str) -> Probe:
    """Return findings with one more reason why the video is not simply usable."""
    verdict = max(found.verdict, WITH_CARE, key=(USABLE, WITH_CARE, UNUSABLE).index)
    return replace(found, verdict=verdict, reasons=(*found.reasons, reason),
                   advice=(*found.advice, advice))


def _rate(packets: list[Packet]) -> float:
    stamps = [packet.stamp for packet in packets]
    span = max(stamps) - min(stamps)
    return (len(stamps) - 1) * 1e9 / span if span else 0.0
