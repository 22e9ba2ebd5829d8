"""CPU time of each stage, as a share of plain decoding of the same video in the same run.

Milliseconds depend on the machine, ratios hardly. Each stage runs ``--repeat`` times and its
fastest run counts: what else the machine does only adds time.
"""

import argparse
from collections.abc import Callable
from dataclasses import asdict, dataclass
from itertools import islice
import json
from pathlib import Path
import tempfile
import time
from typing import Any

import av
from mv_slapse.codec.decoder import CorrespondenceDecoder
from mv_slapse.codec.encoder import Encoding, LOW_LATENCY, write_video
from mv_slapse.codec.frames import FrameDecoder
from mv_slapse.codec.packet import Packet
from mv_slapse.codec.source import open_source
from mv_slapse.config import Settings
from mv_slapse.extraction.extractor import PlaneExtractor
from mv_slapse.geometry.camera import Camera
from mv_slapse.obstacles.tracker import ObstacleTracker
from mv_slapse.records import Correspondences
from mv_slapse.scene.filter import SceneFilter
from mv_slapse.simulation.render import Renderer
from mv_slapse.simulation.street import Street, StreetSettings
from mv_slapse.storage.camera_info import read_camera, write_camera

DATA = Path(__file__).resolve().parents[2] / 'shared' / 'data'
REAL = ('kitti00/mpeg2.mpg', 'kitti00/h264_lowlatency.mp4', 'parking/mpeg2.mpg',
        'parking/h264_lowlatency.mp4')
RENDERED = {'mpeg2.mpg': Encoding(), 'h264_lowlatency.mp4': LOW_LATENCY}


@dataclass(frozen=True)
class Stage:
    """CPU time of one stage.

    Attributes
    ----------
    name : str
    ms_per_frame : float
        For each picture of the video [ms].
    ratio : float
        Over plain decoding.
    """

    name: str
    ms_per_frame: float
    ratio: float


@dataclass(frozen=True)
class Speed:
    """What was measured on one video: its name, size [px], frames, key frame pairs, stages."""

    video: str
    width: int
    height: int
    frames: int
    pairs: int
    stages: tuple[Stage, ...]


def plain_decoding(packets: list[Packet]) -> None:
    """Decode to pictures without motion vectors, in one thread, as a viewer would."""
    context = av.CodecContext.create(packets[0].codec, 'r')
    context.extradata = packets[0].extradata or None
    context.thread_type = 'NONE'
    for packet in packets:
        context.decode(av.Packet(packet.data))
    context.decode(None)


def with_vectors(packets: list[Packet], settings: Settings) -> None:
    """Decode as the decoder does, and read the vectors of every picture."""
    frames = FrameDecoder(with_luma=settings.decoder.bridge_intra)
    for packet in packets:
        frames.feed(packet)
    frames.flush()


def merged(packets: list[Packet], camera: Camera, settings: Settings) -> list[Correspondences]:
    """Decode, merge and chain: packets to correspondences."""
    decoder = CorrespondenceDecoder(settings.decoder, camera)
    pairs = [pair for packet in packets for pair in decoder.feed(packet)]
    return pairs + decoder.flush()


def seconds_of_pipeline(pairs: list[Correspondences], camera: Camera,
                        settings: Settings) -> dict[str, float]:
    """Return the CPU seconds of extraction, scene filter and tracker; steps as in pipeline.py."""
    extractor = PlaneExtractor(camera, settings.extraction, settings.scene.camera_height)
    scene_filter = SceneFilter(settings.scene)
    tracker, to_scene = ObstacleTracker(settings.obstacles), []
    total = {'extraction': 0.0, 'scene filter': 0.0, 'obstacle tracker': 0.0}
    for pair in pairs:
        spent, extraction = timed(extractor.extract, pair)
        total['extraction'] += spent
        spent, (scene, to_tracker) = timed(scene_filter.step, extraction, to_scene)
        total['scene filter'] += spent
        spent, (_, to_scene) = timed(tracker.step, extraction, scene, to_tracker)
        total['obstacle tracker'] += spent
    return total


def timed(function: Callable, *args: Any) -> tuple[float, Any]:
    """Return the CPU seconds that a call takes, and what it returns."""
    start = time.process_time()
    result = function(*args)
    return time.process_time() - start, result


def measure(video: Path, camera: Camera, max_frames: int, repeat: int) -> Speed:
    """Measure all stages on the first pictures of a video."""
    settings = Settings()
    with open_source(video) as source:
        packets = list(islice(source.packets(), max_frames))
    pairs = merged(packets, camera, settings)
    runs = [_run(packets, pairs, camera, settings) for _ in range(repeat)]
    best = {name: 1000 * min(run[name] for run in runs) / len(packets) for name in runs[0]}
    best['merging'] = max(best['correspondences'] - best['decoding with vectors'], 0.0)
    best['all'] = sum(best[name] for name in ('correspondences', 'extraction', 'scene filter',
                                              'obstacle tracker'))
    plain = best['plain decoding']
    names = ('plain decoding', 'decoding with vectors', 'merging', 'extraction', 'scene filter',
             'obstacle tracker', 'all')
    return Speed(f'{video.resolve().parent.name}/{video.name}', camera.width,
                 camera.height, len(packets), len(pairs),
                 tuple(Stage(name, best[name], best[name] / plain) for name in names))


def _run(packets: list[Packet], pairs: list[Correspondences], camera: Camera,
         settings: Settings) -> dict[str, float]:
    return {'plain decoding': timed(plain_decoding, packets)[0],
            'decoding with vectors': timed(with_vectors, packets, settings)[0],
            'correspondences': timed(merged, packets, camera, settings)[0],
            **seconds_of_pipeline(pairs, camera, settings)}


def render(folder: Path, n_frames: int) -> list[Path]:
    """Render a street in the encodings of RENDERED, with its camera file beside."""
    folder = folder / 'street'
    folder.mkdir()
    street = Street(StreetSettings(n_frames=n_frames))
    write_camera(folder / 'camera.yaml', street.camera)
    images = [frame.image for frame in Renderer(street).frames()]
    for name, encoding in RENDERED.items():
        write_video(folder / name, images, street.settings.fps, encoding)
    return [folder / name for name in RENDERED]


def text(speeds: list[Speed]) -> str:
    """Return the measurements as tables."""
    lines = []
    for speed in speeds:
        lines.append(f'{speed.video}: {speed.width}x{speed.height}, {speed.frames} frames, '
                     f'{speed.pairs} key frame pairs')
        lines += [f'  {stage.name:22} {stage.ms_per_frame:7.2f} ms a frame '
                  f'{stage.ratio:6.2f} x plain decoding' for stage in speed.stages]
    return '\n'.join(lines)


def main(arguments: list[str] | None = None) -> int:
    """Measure the given video, the real sequences, or where there are none a rendered street."""
    parser = argparse.ArgumentParser(prog='speed.py', description=__doc__)
    parser.add_argument('videos', nargs='*', type=Path, metavar='VIDEO',
                        help='with a camera.yaml beside it; without one: ../shared/data where it '
                             'is there, else a rendered street')
    parser.add_argument('--rendered', action='store_true', help='the rendered street in any case')
    parser.add_argument('--frames', type=int, default=120, help='(default: %(default)s)')
    parser.add_argument('--repeat', type=int, default=3, help='(default: %(default)s)')
    parser.add_argument('--json', action='store_true', help='print one JSON object')
    args = parser.parse_args(arguments)
    videos = args.videos or [DATA / name for name in REAL if (DATA / name).exists()]
    with tempfile.TemporaryDirectory() as folder:
        if args.rendered or not videos:
            videos = render(Path(folder), args.frames)
        speeds = [measure(video, read_camera(video.parent / 'camera.yaml'), args.frames,
                          args.repeat) for video in videos]
    print(json.dumps({'speeds': [asdict(speed) for speed in speeds]}) if args.json
          else text(speeds))
    return 0


if __name__ == '__main__':
    raise SystemExit(main())
