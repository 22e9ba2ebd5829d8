"""``mv_slapse run``: a video in, the folder of results out."""

from array import array
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, ExitStack
from dataclasses import asdict, dataclass
from importlib import metadata
from itertools import islice
from pathlib import Path
import platform
import time
from typing import Any, NamedTuple

from mv_slapse import heap
from mv_slapse.calibration import fitted
from mv_slapse.codec.decoder import CorrespondenceDecoder
from mv_slapse.codec.segments import NOT_STAMPED
from mv_slapse.config import Settings
from mv_slapse.errors import UnusableInput, UsageError
from mv_slapse.geometry.camera import Camera
from mv_slapse.pipeline import Slapse, Step
from mv_slapse.records import (
    Correspondences,
    ObstacleState,
    ScaleStatus,
    SegmentKind,
    Speed,
    WITH_POSE,
)
from mv_slapse.storage.results import RESULTS, ResultsWriter
from mv_slapse.tools.history import History
from mv_slapse.tools.inputs import open_input, VideoInput
from mv_slapse.tools.placing import Placing
from mv_slapse.tools.run_summary import Summary
from mv_slapse.tools.tallies import Numbers, Texts
import numpy as np

STAGES = ('decode', 'extract', 'filter', 'obstacles', 'write')
LIBRARIES = ('mv_slapse', 'av', 'numpy', 'scipy', 'opencv-python-headless', 'rosbags')
ENOUGH_STAMPS = 10_000  # that tell the mean rate: five minutes
PICTURES = 1800  # after which free memory is given back: a minute of video, for some 2 ms

Progress = Callable[[int, int], None]


class CpuClock:
    """Adds up the CPU seconds of each stage."""

    def __init__(self):
        """Start at zero."""
        self.seconds = dict.fromkeys(STAGES, 0.0)

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Charge what runs within to a stage."""
        start = time.process_time()
        try:
            yield
        finally:
            self.seconds[name] += time.process_time() - start

    def charge(self, function: Callable, name: str) -> Callable:
        """Return a function that runs another and charges it to a stage."""
        def charged(*args: Any, **kwargs: Any) -> Any:
            """Run the function within the stage."""
            with self.stage(name):
                return function(*args, **kwargs)

        return charged


class Decoded(NamedTuple):
    """A video's correspondences, the stamps of its packets [ns], and the CPU time it took [s]."""

    input: str
    pairs: list[Correspondences]
    stamps: list[int]
    cpu_seconds: float


@dataclass(frozen=True)
class Options:
    """What a run may be told beside its settings."""

    max_frames: int | None = None  # stop after so many pictures
    topic: str | None = None  # of the video, in a bag that has several
    command: str = ''  # for the record
    speeds: Iterable[Speed] = ()  # of the vehicle, by the video's clock: the scale is metric then
    history: History | None = None  # is told of each key frame
    # map.json of an earlier run, in whose frame the results are where it is found again
    known_map: str | Path | None = None
    with_packets: bool = False  # put the packets of the video into results.mcap, too
    warnings: Iterable[str] = ()  # of what was read before the run, for the summary
    read: Iterable[str | None] = ()  # files of the user, such as camera and settings
    held: ExitStack | None = None  # keeps other runs out of the folder until it is closed


def run(input: str | Path, camera: Camera | None, settings: Settings, output: str | Path,
        options: Options = Options(), progress: Progress | None = None) -> Summary:
    """Run everything on a video file, a URL or a bag and write the folder of results.

    Parameters
    ----------
    camera : Camera or None
        None takes the calibration that comes with a bag.
    progress : function of (pictures done, pictures in all or 0), or None

    Raises
    ------
    UnusableInput
        Where the input has no motion vectors to work with, its pictures change their size, or it
        cannot be decoded any further; the results up to there are written.
    UsageError
        Where arguments contradict one another, or the output cannot be written.
    """
    files = (name for name in options.read if name and Path(name).is_file())  # or a topic
    _spare((str(input), options.known_map, *files), Path(output))
    with open_input(str(input), options.topic, settings.encoder) as source:
        camera = _camera(camera, source, str(input))
        session = _Session(source, str(input), camera, settings, options)
        with ResultsWriter(output, camera=camera, held=options.held) as writer:
            try:
                session.play(writer, progress)
            except KeyboardInterrupt:
                session.release(writer)
                session.summary.interrupted = True
                session.summary.warnings.append('interrupted; the results end there')
            except UnusableInput as error:
                session.release(writer)
                if session.summary.key_frames:
                    session.summary.warnings.append(f'{error}; the results end there')
                    writer.close(session.finish())
                raise
            writer.close(session.finish())
    return _checked(session.summary)


def _spare(inputs: Iterable[str | Path | None], output: Path):
    """Raise UsageError where what is read is one of the results, which would replace it."""
    results = {path.resolve() for path in (output, *(output / name for name in RESULTS))}
    for given in filter(None, inputs):
        if '://' not in str(given) and Path(given).resolve() in results:
            raise UsageError(f'{given} is where the results of this run go, and would be lost; '
                             'choose another output folder with -o')


def decode(input: str | Path, camera: Camera, settings: Settings) -> Decoded:
    """Decode a whole video to correspondences, to be played as often as one likes."""
    clock, pairs, stamps = CpuClock(), [], []
    decoder = CorrespondenceDecoder(settings.decoder, camera)
    with open_input(str(input), None, settings.encoder) as source, clock.stage('decode'):
        for packet in source.packets:
            pairs += decoder.feed(packet)
            stamps.append(packet.stamp)
        pairs += decoder.flush()
    return Decoded(str(input), pairs, stamps, clock.seconds['decode'])


def replay(decoded: Decoded, camera: Camera, settings: Settings, output: str | Path,
           speeds: Iterable[Speed] = ()) -> Summary:
    """Run everything on correspondences and write the folder of results, as ``run`` would."""
    session = _Session(VideoInput(iter(())), decoded.input, camera, settings,
                       Options(speeds=speeds))
    with ResultsWriter(output, camera=camera) as writer:
        session.replay(decoded, writer)
        writer.close(session.finish())
    return _checked(session.summary)


class _Session:
    """A run in progress."""

    def __init__(self, source: VideoInput, name: str, camera: Camera, settings: Settings,
                 options: Options):
        self._options = options
        self._speeds = deque(sorted(options.speeds, key=lambda speed: speed.stamp))
        self._told_of = [speed.stamp / 1e9 for speed in self._speeds]
        self._source, self._camera, self._settings = source, camera, settings
        self._clock = CpuClock()
        self._decoder = CorrespondenceDecoder(settings.decoder, camera)
        self._slapse = Slapse(camera, settings)
        self._charge_stages()
        self._counts = {name: Texts() for name in ('statuses', 'reasons', 'broken_reasons')}
        self._planes, self._obstacles = Numbers(), Numbers()
        self._stamps = array('q')
        self._placing = Placing(options.known_map)
        self.summary = Summary(name, command=options.command, warnings=[*options.warnings])

    def play(self, writer: ResultsWriter, progress: Progress | None):
        """Take the packets one after another, as a robot would."""
        max_frames = self._options.max_frames
        total = min(filter(None, (self._source.n_frames, max_frames)), default=0)
        packets = islice(self._source.packets, max_frames)
        # reading is charged to decoding: it may be a decoder and an encoder of their own
        while (packet := self._decode(next, packets, None)) is not None:
            if self._options.with_packets:
                with self._clock.stage('write'):
                    writer.write_packet(packet)
            self._take(self._decode(self._decoder.feed, packet), writer)
            if len(self._stamps) < ENOUGH_STAMPS:
                self._stamps.append(packet.stamp)
            self.summary.frames += 1
            if self.summary.frames % PICTURES == 0:
                heap.give_back_free_pages()
            if progress:
                progress(self.summary.frames, total)
        self._take(self._decode(self._decoder.flush), writer)
        self.release(writer)

    def release(self, writer: ResultsWriter):
        """Write what is held back until a known map is found: nothing more will come."""
        self._write(self._placing.rest(), writer)

    def replay(self, decoded: Decoded, writer: ResultsWriter):
        """Take correspondences that were decoded before."""
        self._clock.seconds['decode'] = decoded.cpu_seconds
        self._stamps = list(decoded.stamps)
        self.summary.frames = len(self._stamps)
        self._take(decoded.pairs, writer)

    def finish(self) -> dict[str, Any]:
        """Complete the summary and return its content."""
        summary, camera = self.summary, self._camera
        summary.fps = _rate(np.sort(self._stamps))
        summary.planes, summary.obstacles_confirmed = len(self._planes), len(self._obstacles)
        summary.known_map = self._placing.content()
        summary.warnings = [*self._source.warnings, *summary.warnings, *self._placing.warnings()]
        self._check_clocks()
        for name, counter in self._counts.items():
            setattr(summary, name, dict(counter.most_common()))
        seconds = self._clock.seconds
        summary.cpu_seconds = {**seconds, 'total': sum(seconds.values())}
        summary.camera = {'width': camera.width, 'height': camera.height, 'lens': camera.lens,
                          'K': camera.K.tolist(), 'distortion': camera.distortion.tolist()}
        summary.settings, summary.versions = asdict(self._settings), _versions()
        return summary.to_dict()

    def _check_clocks(self):
        """Warn where no speed lies between the key frames."""
        summary, told = self.summary, self._told_of
        if told and not any(summary.first_stamp <= stamp <= summary.last_stamp for stamp in told):
            summary.warnings.append(
                f'the speeds, {told[0]:.3f} to {told[-1]:.3f} s, have no stamp between the key '
                f'frames, {summary.first_stamp:.3f} to {summary.last_stamp:.3f} s, and were not '
                'used; both must be of one clock')

    def _charge_stages(self):
        for part, verb, stage in (('extractor', 'extract', 'extract'), ('scene', 'step', 'filter'),
                                  ('tracker', 'step', 'obstacles')):
            part = getattr(self._slapse, f'_{part}')
            setattr(part, verb, self._clock.charge(getattr(part, verb), stage))

    def _decode(self, function: Callable, *args: Any) -> Any:
        with self._clock.stage('decode'):
            return function(*args)

    def _take(self, pairs: list[Correspondences], writer: ResultsWriter):
        for pair in pairs:
            self._check_size(pair)
            step = self._slapse.step(pair, self._told(pair.stamp))
            self._write(self._placing.add(step), writer)

    def _write(self, steps: list[Step], writer: ResultsWriter):
        for step in steps:
            with self._clock.stage('write'):
                writer.origin = self._placing.origin
                writer.write(step)
            self._count(step)
            if self._options.history:
                self._options.history.add(step)

    def _check_size(self, pair: Correspondences):
        """Refuse pictures that the calibration is not of, from the first or a later one on."""
        if not self.summary.key_frames:
            self._camera = fitted(self._camera, pair.width, pair.height, self.summary.input)
        elif (pair.width, pair.height) != (self._camera.width, self._camera.height):
            raise UnusableInput(
                f'{self.summary.input}: the pictures are {pair.width}x{pair.height} from '
                f'{pair.stamp / 1e9:.3f} s on; cut the video there, and give each part its own '
                'calibration')

    def _told(self, stamp: int) -> list[Speed]:
        """Return the speeds that were told since the pair before."""
        told = []
        while self._speeds and self._speeds[0].stamp <= stamp:
            told.append(self._speeds.popleft())
        return told

    def _count(self, step: Step):
        summary, scene, pair = self.summary, step.scene, step.correspondences
        if not summary.key_frames:
            summary.key_frames, summary.first_stamp = 1, pair.previous_stamp / 1e9
        summary.key_frames += 1
        summary.last_stamp = pair.stamp / 1e9
        if scene.status in WITH_POSE:
            summary.poses += 1 if summary.poses else 2  # the first key frame is the origin
        self._counts['statuses'].take(scene.status.name.lower())
        if scene.reason:
            self._counts['reasons'].take(scene.reason)
        if pair.kind is SegmentKind.BROKEN:
            summary.broken_segments += 1
            self._counts['broken_reasons'].take(pair.reason)
        is_metric = scene.scale_status is ScaleStatus.METRIC
        summary.scale_status = 'metric' if is_metric else 'unknown'
        summary.scale_source = scene.scale_source
        for plane in scene.planes:
            self._planes.add(plane.id)
        for obstacle in step.obstacles:
            if obstacle.state is ObstacleState.CONFIRMED:
                self._obstacles.add(obstacle.id)


def _camera(camera: Camera | None, source: VideoInput, name: str) -> Camera:
    camera = camera or source.camera
    if camera is None:
        raise UsageError(f'{name} brings no calibration along; give one with --camera '
                         'camera.yaml (a camera_info file)')
    return fitted(camera, *source.size, name) if source.size else camera


def _checked(summary: Summary) -> Summary:
    """Return the summary of a run that had something to work with."""
    if summary.interrupted:
        return summary
    n_pairs = max(summary.key_frames - 1, 0)
    if not n_pairs:
        raise UnusableInput(f'{summary.input} has {summary.frames} pictures that can be decoded, '
                            'and no two key frames (I or P) among them; give a longer video')
    if summary.broken_segments == n_pairs:
        reason = next(iter(summary.broken_reasons), 'unknown')
        if reason == NOT_STAMPED:
            raise UnusableInput(f'{summary.input}: none of {n_pairs} key frame pairs can be used: '
                                f'{reason}')
        raise UnusableInput(f'{summary.input}: none of {n_pairs} key frame pairs has motion '
                            f'vectors ({reason}); re-encode the video with P frames, for instance '
                            'ffmpeg -i INPUT -c:v libx264 -refs 1 -bf 0 -g 30 OUTPUT.mp4')
    return summary


def _rate(stamps: np.ndarray) -> float:
    """Return the frame rate [1/s] of sorted stamps [ns], some of which may be missing."""
    steps = np.diff(stamps)
    if not np.any(steps > 0):
        return 0.0
    span = stamps[-1] - stamps[0]
    return float(np.round(span / np.median(steps[steps > 0])) / span * 1e9)


def _versions() -> dict[str, str]:
    versions = {'python': platform.python_version()}
    for name in LIBRARIES:
        try:
            versions[name] = metadata.version(name)
        except metadata.PackageNotFoundError:
            versions[name] = 'unknown'
    return versions
