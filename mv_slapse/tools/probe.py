"""What a video offers: its coding, its vectors, and whether they can be used."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import islice

from mv_slapse.codec.bridging import is_untrue
from mv_slapse.codec.frames import FrameDecoder
from mv_slapse.codec.motion_vectors import FrameVectors
from mv_slapse.codec.segments import NOT_STAMPED, SegmentBuilder
from mv_slapse.codec.source import Source
from mv_slapse.records import FrameType

MIN_VECTORS = 100  # per picture, below which no plane can be found
FOR_INSTANCE = 'for instance: ffmpeg -i INPUT -c:v libx264 -refs 1 -bf 0'
USABLE, WITH_CARE, UNUSABLE = 'usable', 'usable with care', 'unusable'


@dataclass(frozen=True)
class Probe:
    """Findings about a video."""

    codec: str  # FFmpeg's name of the decoder
    width: int  # of the pictures [px]
    height: int  # the same [px]
    fps: float  # pictures a second; 0 where the container does not tell it
    n_frames: int  # pictures read
    references: int  # most pictures that a direction may mean, as the slices use them
    b_frames: int  # most B frames between two key frames
    gop: int  # longest distance of two I frames; the pictures read where there is but one
    vectors_per_frame: float  # mean over the P and B frames that have any
    share_with_vectors: float  # share of P and B frames that have any
    interlaced: bool  # whether fields may be coded
    verdict: str  # USABLE, WITH_CARE or UNUSABLE
    reasons: tuple[str, ...]  # why not simply usable
    advice: tuple[str, ...]  # what to do about it


def probe(source: Source, max_frames: int = 300) -> Probe:
    """Decode the first pictures of a source and say what they are good for."""
    decoder = FrameDecoder(with_luma=True)
    segments, frames, untrue, unstamped = SegmentBuilder(), [], 0, 0
    for frame in _read(source, decoder, max_frames):
        segment = segments.add(frame)
        untrue += segment is not None and not segment.reason and is_untrue(segment)
        unstamped += segment is not None and segment.reason == NOT_STAMPED
        frames.append(replace(frame, luma=None))
    coded = [len(frame) for frame in frames if frame.frame_type is not FrameType.I]
    filled = [n for n in coded if n]
    vectors, share = sum(filled) / max(len(filled), 1), len(filled) / max(len(coded), 1)
    runs = _runs(frames)
    references = max((frame.references for frame in frames), default=1)
    findings = _findings(frames, vectors, references, runs, decoder.interlaced, untrue)
    if unstamped:
        findings.append((unstamped == len(runs) - 1,
                         f'of {unstamped} pairs of key frames the time stamps do not increase',
                         'have what publishes or records the pictures stamp each with its time'))
    verdict = UNUSABLE if any(item[0] for item in findings) else (
        WITH_CARE if findings else USABLE)
    width, height = ((frames[0].width, frames[0].height) if frames
                     else (source.width, source.height))
    return Probe(source.codec, width, height, source.fps, len(frames),
                 max(references, 1), max(runs, default=0), _gop(frames), vectors, share,
                 decoder.interlaced, verdict, tuple(item[1] for item in findings),
                 tuple(item[2] for item in findings))


def _read(source: Source, decoder: FrameDecoder, max_frames: int) -> Iterator[FrameVectors]:
    for packet in islice(source.packets(), max_frames):
        yield from decoder.feed(packet)
    yield from decoder.flush()


def _runs(frames: list[FrameVectors]) -> list[int]:
    """Return the number of B frames before each key frame."""
    runs, count = [], 0
    for frame in frames:
        if frame.frame_type is FrameType.B:
            count += 1
        else:
            runs.append(count)
            count = 0
    return runs


def _gop(frames: list[FrameVectors]) -> int:
    at = [i for i, frame in enumerate(frames) if frame.frame_type is FrameType.I]
    return max((b - a for a, b in zip(at, at[1:], strict=False)), default=len(frames))


def _findings(frames: list[FrameVectors], vectors: float, references: int, runs: list[int],
              interlaced: bool, untrue: int) -> list[tuple[bool, str, str]]:
    """Return what is wrong: whether it forbids use, why, and what to do."""
    damaged = sum(bool(frame.damage) for frame in frames)
    few = bool(frames) and 0 < vectors < MIN_VECTORS
    blind = any(runs) and not any(len(f) for f in frames if f.frame_type is FrameType.B)
    short = bool(frames) and len(runs) < 2
    first, *others = dict.fromkeys(f'{f.width}x{f.height}' for f in frames) or ['']
    no_b_and_i_frames = not any(runs) and sum(f.frame_type is FrameType.I for f in frames) > 1
    return [finding for applies, *finding in (
        (not frames, True, 'no picture could be decoded', 'check that the file is complete'),
        (short, True, f'{len(frames)} pictures can be decoded, and no two key frames (I or P) '
         'among them', 'give a longer video'),
        (bool(others), True,
         f'the pictures change their size from {first} to {", ".join(others)}',
         'cut the video there, and give each part its own calibration'),
        (not short and bool(frames) and not vectors, False, 'no picture has motion vectors; '
         'motion is searched in the pictures instead',
         f'encode with P frames, {FOR_INSTANCE} -g 30 OUTPUT.mp4'),
        (untrue, False, f'the vectors of {untrue} pictures are all zero though the pictures '
         'change; motion is searched in these instead',
         f'set the encoder to search for motion, {FOR_INSTANCE} OUTPUT.mp4'),
        (blind, False, 'FFmpeg tells no vectors of the B frames of this codec; they go unused',
         f'encode without B frames (-bf 0), {FOR_INSTANCE} OUTPUT.mp4'),
        (few, True, f'{vectors:.0f} motion vectors a picture are too few to find planes',
         'use a larger picture or a higher bit rate'),
        (interlaced, True, 'the video is interlaced: its vectors join fields',
         'deinterlace it: ffmpeg -i INPUT -vf bwdif -c:v libx264 -refs 1 -bf 0 OUTPUT.mp4'),
        (references > 1, False, f'vectors may point to any of {references} pictures, which FFmpeg '
         'does not tell apart; doubtful ones are dropped', 'encode with one reference: -refs 1'),
        (no_b_and_i_frames, False, 'no vector joins an I frame to the past; that gap is bridged '
         'from the pictures or predicted', 'encode with fewer I frames (-g 300) or with B frames'),
        (damaged, False, f'{damaged} pictures are damaged or follow a lost one',
         'use a reliable transport (rtsp_transport tcp, reliable QoS)')) if applies]
