"""What a frame costs: each stage, the whole, and what others do with the same pictures.

CPU time of one thread. All that is measured on a clip takes turns, several times, so that what
else the machine does falls on all alike; the ratios of each turn are what counts, with their
minimum, median and maximum. Milliseconds depend on the machine. ORB is
``cv2.ORB_create(2000).detectAndCompute`` alone; odometries are those of ``odometry.py``.
"""

import os

THREADS = ('OMP_NUM_THREADS', 'OPENBLAS_NUM_THREADS', 'MKL_NUM_THREADS')
os.environ.update(dict.fromkeys(THREADS, '1'))  # before numpy is loaded

import argparse  # noqa: E402
from collections.abc import Callable, Iterator, Sequence  # noqa: E402
from contextlib import ExitStack  # noqa: E402
from dataclasses import asdict, dataclass  # noqa: E402
from importlib import import_module  # noqa: E402
from itertools import islice  # noqa: E402
import json  # noqa: E402
from pathlib import Path  # noqa: E402
import platform  # noqa: E402
from statistics import median  # noqa: E402
import subprocess  # noqa: E402
import sys  # noqa: E402
import tempfile  # noqa: E402
import time  # noqa: E402
from typing import Any, NamedTuple  # noqa: E402
from unittest import mock  # noqa: E402

import av  # noqa: E402
import cv2  # noqa: E402
from mv_slapse.codec.decoder import CorrespondenceDecoder  # noqa: E402
from mv_slapse.codec.encoding.encoder import Encoding, LOW_LATENCY, write_video  # noqa: E402
from mv_slapse.codec.encoding.recoder import Recoder  # noqa: E402
from mv_slapse.codec.packet import Packet  # noqa: E402
from mv_slapse.codec.source import open_source  # noqa: E402
from mv_slapse.config import EncoderSettings, SceneSettings, Settings  # noqa: E402
from mv_slapse.errors import MvSlapseError  # noqa: E402
from mv_slapse.evaluation import trajectory  # noqa: E402
from mv_slapse.geometry.camera import Camera  # noqa: E402
from mv_slapse.pipeline import Slapse, Step  # noqa: E402
from mv_slapse.records import WITH_POSE  # noqa: E402
from mv_slapse.simulation.render import Renderer  # noqa: E402
from mv_slapse.simulation.street import Street, StreetSettings  # noqa: E402
from mv_slapse.storage.camera_info import read_camera, write_camera  # noqa: E402
from mv_slapse.storage.results import ResultsWriter  # noqa: E402
from mv_slapse.storage.tum import read_trajectory, Trajectory, write_poses  # noqa: E402
from mv_slapse.tools.evaluate import commit_of  # noqa: E402
from mv_slapse.tools.inputs import pictures  # noqa: E402
import numpy as np  # noqa: E402
import odometry  # noqa: E402

DATA = Path(__file__).resolve().parents[2] / 'shared' / 'data'
ENCODINGS = {'mpeg2.mpg': Encoding('mpeg2video', 3, 12), 'h264_lowlatency.mp4': LOW_LATENCY,
             'h264_bframes.mp4': Encoding('h264', 3, 30)}
NAMES = {'mpeg2.mpg': 'MPEG-2, B', 'h264_lowlatency.mp4': 'H.264, no B',
         'h264_bframes.mp4': 'H.264, B'}
SIZES = {'street, 640×480': (60, {}),  # frames measured, settings of the street
         'street, KITTI size': (30, {'width': 1240, 'height': 376, 'focal': 718.0}),
         'street, 720p': (30, {'width': 1280, 'height': 720, 'focal': 1000.0}),
         'street, 1080p': (20, {'width': 1920, 'height': 1080, 'focal': 1500.0})}
REAL = {'kitti00': (40, 1.65), 'parking': (60, 0.0)}  # frames measured, height of the camera [m]
# Parts of the pipeline: methods and functions by the module in which they are looked up.
PARTS = {
    'first motion': 'mv_slapse.extraction.extractor:PlaneExtractor._first_motion',
    'evidence': 'mv_slapse.extraction.extractor:PlaneExtractor._observed',
    'motion by the map': 'mv_slapse.surfaces.block_map:BlockMap.measured',
    'map': 'mv_slapse.extraction.extractor:PlaneExtractor._remember_map',
    'ground': 'mv_slapse.extraction.extractor:PlaneExtractor._survey',
    'planes': 'mv_slapse.surfaces.plane_search:stationary_planes',
    'movers': 'mv_slapse.movers.regions:with_moving_planes',
    'joint refinement': 'mv_slapse.surfaces.joint:reestimate'}
WARM = 8  # frames
DECODING = 'decoding, vectors'
STAGES = (DECODING, 'merging', 'extraction', 'scene filter', 'tracker')
OURS, WRITING = 'ours, all', 'ours, with results'
BARE, ORB = 'bare decoding', 'ORB alone'
CORNERS, FEATURES = 'corner odometry', 'ORB odometry'
BEYOND = 'ours, beyond decoding'
AGAIN = 'encoding again'  # what streams and pictures without vectors cost more


@dataclass(frozen=True)
class Clip:
    """A video of which the first frames are measured, and how high its camera is [m]."""

    name: str
    video: Path
    frames: int
    height: float


@dataclass(frozen=True)
class Measured:
    """What was measured on one clip.

    Attributes
    ----------
    clip, encoding : str
    width, height, frames, pairs, blocks : int
        Blocks: median of a pair.
    way : float
        Length of the true way [m].
    turns : list of dict
        CPU time of a frame [ms] by name, for each turn.
    ate : dict
        Mean position error [% of the way] by name, where there are poses enough.
    """

    clip: str
    encoding: str
    width: int
    height: int
    frames: int
    pairs: int
    blocks: int
    way: float
    turns: list[dict[str, float]]
    ate: dict[str, float]

    def ms(self, name: str) -> float:
        """Return the median time of a frame [ms]."""
        return median(turn[name] for turn in self.turns)

    def ratios(self, name: str, other: str) -> list[float]:
        """Return the least, the median and the greatest ratio of two times of one turn."""
        found = sorted(turn[name] / turn[other] for turn in self.turns)
        return [found[0], median(found), found[-1]]


class Clock:
    """Adds up CPU time [s] by name."""

    def __init__(self):
        """Start at zero."""
        self.seconds: dict[str, float] = {}

    def run(self, name: str, function: Callable, *args: Any, **kwargs: Any) -> Any:
        """Call a function and charge its time to a name."""
        start = time.process_time()
        try:
            return function(*args, **kwargs)
        finally:
            self.seconds[name] = self.seconds.get(name, 0.0) + time.process_time() - start

    def charged(self, name: str, function: Callable) -> Callable:
        """Return a function whose time is charged to a name whenever it is called."""
        def charged(*args: Any, **kwargs: Any) -> Any:
            """Call the function on the clock."""
            return self.run(name, function, *args, **kwargs)

        return charged


def place(path: str) -> tuple[Any, str]:
    """Return the module or class that holds a function, and its name there."""
    module, _, name = path.partition(':')
    *holders, name = name.split('.')
    holder = import_module(module)
    for part in holders:
        holder = getattr(holder, part)
    return holder, name


class Inputs(NamedTuple):
    """A clip in memory."""

    packets: list[Packet]
    images: list[np.ndarray]
    camera: Camera
    truth: Trajectory
    settings: Settings


def read(clip: Clip) -> Inputs:
    """Read the first frames of a clip, with its camera and its truth beside it."""
    with open_source(clip.video) as source:
        packets = list(islice(source.packets(), clip.frames))
    return Inputs(packets, list(islice(pictures(clip.video), clip.frames)),
                  read_camera(clip.video.parent / 'camera.yaml'),
                  read_trajectory(clip.video.parent / 'ground_truth.tum'),
                  Settings(scene=SceneSettings(camera_height=clip.height)))


def bare_decoding(packets: list[Packet]) -> None:
    """Decode to pictures without motion vectors, in one thread, as a viewer would."""
    context = av.CodecContext.create(packets[0].codec, 'r')
    context.extradata = packets[0].extradata or None
    context.thread_type, context.thread_count = 'NONE', 1
    for packet in packets:
        context.decode(av.Packet(packet.data))
    context.decode(None)


def encoded_again(packets: list[Packet]) -> None:
    """Decode every picture and encode it again, as where a decoder gives no vectors."""
    recoder = Recoder(EncoderSettings(recode='always'))
    for packet in packets:
        recoder.feed(packet)
    recoder.flush()


def orb_alone(images: list[np.ndarray]) -> None:
    """Extract the features of every picture."""
    orb = cv2.ORB_create(odometry.FEATURES)
    for image in images:
        orb.detectAndCompute(image, None)


def ours(inputs: Inputs, clock: Clock, writer: ResultsWriter | None = None) -> list[Step]:
    """Run everything, and charge each stage to its name.

    With a writer results are written after each step, and each part is charged to its name, too.
    """
    packets, camera, settings = inputs.packets, inputs.camera, inputs.settings
    decoder, steps = CorrespondenceDecoder(settings.decoder, camera), []
    slapse = Slapse(camera, settings)
    with ExitStack() as stack:
        for name, path in PARTS.items() if writer else ():
            holder, attribute = place(path)
            stack.enter_context(mock.patch.object(
                holder, attribute, clock.charged(name, getattr(holder, attribute))))
        for stage, part, verb in ((DECODING, decoder._frames, 'feed'),
                                  (DECODING, decoder._frames, 'flush'),
                                  ('extraction', slapse._extractor, 'extract'),
                                  ('scene filter', slapse._scene, 'step'),
                                  ('tracker', slapse._tracker, 'step')):
            setattr(part, verb, clock.charged(stage, getattr(part, verb)))
        for feed in [*(lambda p=p: decoder.feed(p) for p in packets), decoder.flush]:
            for pair in clock.run('correspondences', feed):
                steps.append(clock.run('steps', slapse.step, pair))
                if writer:
                    clock.run('writing', writer.write, steps[-1])
    return steps


def turn(inputs: Inputs, length: odometry.Length, folder: Path):
    """Run everything once; return the times of a frame [ms], our steps and the others' poses."""
    clock, written, images, K = Clock(), Clock(), inputs.images, inputs.camera.K
    clock.run(BARE, bare_decoding, inputs.packets)
    clock.run(ORB, orb_alone, images)
    clock.run(AGAIN, encoded_again, inputs.packets)
    ours(inputs, clock)
    with ResultsWriter(folder) as writer:
        steps = ours(inputs, written, writer)
    poses = {CORNERS: clock.run(CORNERS, odometry.corner_tracking, images, K, length),
             FEATURES: clock.run(FEATURES, odometry.orb_matching, images, K, length)}
    spent, more = ({name: 1e3 * seconds / len(images) for name, seconds in of.seconds.items()}
                   for of in (clock, written))
    spent |= {name: more.get(name, 0.0) for name in (*PARTS, 'writing')}
    spent['merging'] = spent['correspondences'] - spent[DECODING]
    spent[OURS] = spent['correspondences'] + spent['steps']
    spent[WRITING] = more['correspondences'] + more['steps'] + spent['writing']
    spent[BEYOND] = spent[OURS] - spent[DECODING]
    return spent, steps, poses


def measure(clip: Clip, repeats: int) -> Measured:
    """Measure a clip in so many turns."""
    inputs = read(clip)
    stamps = sorted(packet.stamp for packet in inputs.packets)
    known = dict(zip(*trajectory.associate(np.array(stamps), inputs.truth.stamps), strict=True))
    where = np.array([inputs.truth.positions[known[i]] for i in range(len(stamps))])

    def length(i: int, j: int) -> float:
        """Return the true way between two pictures [m]."""
        return float(np.linalg.norm(where[j] - where[i]))

    turns = []
    with tempfile.TemporaryDirectory() as folder:
        # Once untimed: what is loaded at its first use is no cost of a frame.
        turn(inputs._replace(packets=inputs.packets[:WARM], images=inputs.images[:WARM]),
             length, Path(folder))
        for _ in range(repeats):
            spent, steps, poses = turn(inputs, length, Path(folder))
            turns.append(spent)
    paths = {OURS: [(step.scene.stamp, step.scene.R_world_from_cam, step.scene.t_world_from_cam)
                    for step in steps if step.scene.status in WITH_POSE]}
    paths |= {name: [(stamps[pose.index], pose.R, pose.t) for pose in found]
              for name, found in poses.items()}
    ate = {name: error for name, path in paths.items()
           if (error := ate_percent(path, inputs.truth)) is not None}
    blocks = [len(step.correspondences) for step in steps]
    return Measured(clip.name, clip.video.name, inputs.camera.width, inputs.camera.height,
                    len(inputs.images), len(steps), int(np.median(blocks)),
                    trajectory.path_length(where), turns, ate)


def ate_percent(poses: Sequence[tuple], truth: Trajectory) -> float | None:
    """Return the mean position error after similarity alignment [%]; None: too few poses."""
    with tempfile.NamedTemporaryFile('w', suffix='.tum') as file:
        write_poses(file.name, poses)
        try:
            score = trajectory.evaluate(read_trajectory(file.name), truth)
        except MvSlapseError:
            return None
    return trajectory.figures(score)['ate_mean_percent']


def real_clips(names: Sequence[str] = tuple(REAL)) -> Iterator[Clip]:
    """Yield the sequences that are there, in each encoding."""
    for name in names:
        frames, height = REAL[name]
        for file in ENCODINGS:
            if (DATA / name / file).exists():
                yield Clip(name, DATA / name / file, frames, height)


def rendered(folder: Path, sizes: dict[str, tuple[int, dict[str, Any]]]) -> Iterator[Clip]:
    """Render a street in each size and yield it in each encoding."""
    for name, (frames, settings) in sizes.items():
        place = folder / name
        place.mkdir()
        street = Street(StreetSettings(n_frames=frames, **settings))
        write_camera(place / 'camera.yaml', street.camera)
        write_poses(place / 'ground_truth.tum', (
            (street.stamp(i), *street.pose(i)) for i in range(frames)))
        images = [frame.image for frame in Renderer(street).frames()]
        for file, encoding in ENCODINGS.items():
            write_video(place / file, images, street.settings.fps, encoding)
            yield Clip(name, place / file, frames, street.settings.camera_height)


FIRST = """
import sys
from pathlib import Path
from mv_slapse.codec.decoder import CorrespondenceDecoder
from mv_slapse.codec.source import open_source
from mv_slapse.config import Settings
from mv_slapse.storage.camera_info import read_camera
video = Path(sys.argv[1])
decoder = CorrespondenceDecoder(Settings().decoder, read_camera(video.parent / 'camera.yaml'))
with open_source(video) as source:
    next(packet for packet in source.packets() if decoder.feed(packet))
"""
WHOLE = """
import sys, tempfile
from pathlib import Path
from mv_slapse.config import Settings
from mv_slapse.storage.camera_info import read_camera
from mv_slapse.tools.run import run
video = Path(sys.argv[1])
with tempfile.TemporaryDirectory() as folder:
    run(video, read_camera(video.parent / 'camera.yaml'), Settings(), folder)
# Not ru_maxrss: that begins with what the process that started this one had.
status = Path('/proc/self/status').read_text()
print(int(status.partition('VmHWM:')[2].split()[0]) / 1024)
"""
STARTS = {  # name: code of a process of its own
    'Python alone': '',
    'libraries alone (numpy, scipy, cv2, av)': 'import numpy, scipy.optimize, cv2, av',
    'start-up of `mv_slapse run` (imports)': 'import mv_slapse.tools.main, mv_slapse.tools.run',
    'second start to the first correspondences': FIRST}


def starts(video: Path, repeats: int) -> dict[str, list[float]]:
    """Return the CPU times [s] of processes from their start, and the memory of a run [MB]."""
    found: dict[str, list[float]] = {name: [] for name in STARTS}
    for i in range(repeats + 1):
        for name, code in STARTS.items():
            before = os.times()
            subprocess.run([sys.executable, '-c', code, str(video)], check=True)
            after = os.times()
            if i:  # the first start fills the caches of the disk and of Python
                found[name].append(after.children_user - before.children_user
                                   + after.children_system - before.children_system)
    memory = subprocess.run([sys.executable, '-c', WHOLE, str(video)], check=True,
                            capture_output=True, text=True).stdout
    return found | {'resident memory of an offline run [MB]': [float(memory)]}


def required(measured: Sequence[Measured]) -> list[tuple[str, list[float]]]:
    """Return what is asked of the package: ratios, least, median and greatest."""
    by = {(one.clip, one.encoding): one for one in measured}
    asked = [(f'{clip}, {NAMES[file]}: {name} ÷ ORB', (clip, file), name)
             for clip, file, name in (
                 ('street, 640×480', 'mpeg2.mpg', OURS),
                 ('street, 640×480', 'h264_lowlatency.mp4', OURS),
                 ('kitti00', 'mpeg2.mpg', OURS),
                 ('kitti00', 'h264_lowlatency.mp4', BEYOND))]
    rows = [(text, by[key].ratios(name, ORB)) for text, key, name in asked if key in by]
    for file in ENCODINGS:
        small, large = (by.get((f'street, {size}', file)) for size in ('640×480', '1080p'))
        if small and large:
            every = sorted(a[BEYOND] / b[BEYOND] for a in large.turns for b in small.turns)
            # Larger pictures have longer vectors, so that more segments are split into two pairs.
            more = large.pairs / large.frames / (small.pairs / small.frames)
            name = f'street, 1080p ÷ 640×480, {NAMES[file]}: {BEYOND}'
            rows += [(name + of, [every[0] / times, median(every) / times, every[-1] / times])
                     for of, times in (('', 1), (', of a pair', more))]
    return rows


def page(measured: Sequence[Measured], started: dict[str, list[float]], command: str) -> str:
    """Return the whole page."""
    lines = [
        '# Speed', '', *__doc__.splitlines()[2:], '',
        f'Made by `{command}` at commit {commit_of(Path.cwd())} on {machine()}.',
        'ORB and the odometries are given decoded pictures; ours begins with packets. The '
        'odometries take the length of each step from the truth, ours does not.', '',
        *_table('What is asked', ('ratio', 'min', 'median', 'max'), (
            (name, *map('{:.2f}'.format, values)) for name, values in required(measured)))]
    if started:
        lines += _table('Starting', ('in a process of its own, CPU', 'min', 'median', 'max'), (
            (name, *map('{:.2f}'.format, (min(values), median(values), max(values))))
            for name, values in started.items()))
    lines += _table(
        'The whole, ÷ ORB alone: minimum, median, maximum', (
            'clip', 'frames, pairs', 'blocks', 'ORB [ms]', OURS, WRITING, BEYOND, BARE,
            CORNERS, FEATURES), (
            (_named(one), f'{one.frames}, {one.pairs}', str(one.blocks), f'{one.ms(ORB):.2f}',
             *(_range(one, name, ORB)
               for name in (OURS, WRITING, BEYOND, BARE, CORNERS, FEATURES)))
            for one in measured))
    lines += _table('Mean position error [% of the way]',
                    ('clip', 'way [m]', 'ours', CORNERS, FEATURES), (
                        (_named(one), f'{one.way:.1f}', *(
                            f'{one.ate[name]:.3f}' if name in one.ate else ''
                            for name in (OURS, CORNERS, FEATURES))) for one in measured))
    lines += _table('Stages, CPU of a frame [ms], median',
                    ('clip', *STAGES, 'writing', OURS, AGAIN),
                    ((_named(one), *(f'{one.ms(name):.2f}'
                                     for name in (*STAGES, 'writing', OURS, AGAIN)))
                     for one in measured))
    lines += _table('Parts of the extraction, CPU of a frame [ms], median', ('clip', *PARTS), (
        (_named(one), *(f'{one.ms(name):.2f}' for name in PARTS)) for one in measured))
    return '\n'.join(lines)


def machine() -> str:
    """Return what kind of machine this is."""
    file = Path('/proc/cpuinfo')
    model = next((line.partition(': ')[2] for line in file.read_text().splitlines()
                  if line.startswith('model name')), '') if file.exists() else ''
    return (f'{model or platform.machine()}, {os.cpu_count()} cores, Python '
            f'{platform.python_version()}, OpenCV {cv2.__version__}, numpy {np.__version__}')


def _named(one: Measured) -> str:
    return f'{one.clip}, {NAMES[one.encoding]}'


def _range(one: Measured, name: str, other: str) -> str:
    return ' '.join(f'{value:.2f}' for value in one.ratios(name, other))


def _table(title: str, head: Sequence[str], rows: Iterator[Sequence[str]]) -> list[str]:
    return [f'## {title}', '', f'| {" | ".join(head)} |', '|' + ' --- |' * len(head),
            *(f'| {" | ".join(row)} |' for row in rows), '']


def main(arguments: list[str] | None = None) -> int:
    """Measure the sequences that are there and rendered streets, and write the page."""
    parser = argparse.ArgumentParser(prog='speed.py', description=__doc__,
                                     formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument('--quick', action='store_true',
                        help='one small street and a few frames, once: does it run?')
    parser.add_argument('--only', default='', help='only clips whose name holds this text')
    parser.add_argument('--repeat', type=int, default=3, help='turns (default: %(default)s)')
    parser.add_argument('--json', type=Path, help='also write all times to this file')
    parser.add_argument('-o', '--output', type=Path, default=Path('docs/benchmarks.md'))
    options = parser.parse_args(arguments)
    cv2.setNumThreads(1)
    sizes = {name: size for name, size in SIZES.items() if options.only in name}
    if options.quick:
        sizes = {'street, 640×480': (26, {'width': 320, 'height': 240, 'focal': 250.0})}
    names = [] if options.quick else [name for name in REAL if options.only in name]
    started, measured = {}, []
    with tempfile.TemporaryDirectory() as folder:
        clips = [*real_clips(names), *rendered(Path(folder), sizes)]
        for clip in clips:
            print(f'{clip.name}, {clip.video.name}', file=sys.stderr, flush=True)
            measured.append(measure(clip, 1 if options.quick else options.repeat))
        if not options.quick and clips:
            started = starts(next((clip.video for clip in clips if clip.name.startswith('street')),
                                  clips[0].video), options.repeat)
    command = ' '.join(['python benchmarks/speed.py', *(arguments or sys.argv[1:])])
    options.output.parent.mkdir(parents=True, exist_ok=True)
    options.output.write_text(page(measured, started, command))
    if options.json:
        options.json.write_text(json.dumps({'clips': [asdict(one) for one in measured],
                                            'starts': started}, indent=1))
    return 0


if __name__ == '__main__':
    sys.exit(main())
