"""What ``make evaluate`` measures: sequences, the same re-encoded, rendered streets and flights.

A scene makes its cases in a folder of its own; a video that is there already is not made again.
"""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from itertools import islice, product
from pathlib import Path
from typing import Any, NamedTuple

from mv_slapse.codec.encoding.encoder import Encoding, leave_out, LOW_LATENCY, write_video
from mv_slapse.geometry.camera import Camera
from mv_slapse.records import Speed
from mv_slapse.simulation.flight import CUT_FISHEYE, FISHEYE, Flight, FlightSettings, WIDE
from mv_slapse.simulation.street import Street, StreetSettings
from mv_slapse.simulation.traffic import AHEAD
from mv_slapse.simulation.truth import film, film_flight
from mv_slapse.simulation.wheels import drawn_speeds
from mv_slapse.storage.camera_info import read_camera
from mv_slapse.storage.tum import read_trajectory
from mv_slapse.tools.inputs import pictures
import numpy as np

KITTI = 1.65  # m, its cameras above the road (Geiger et al., Vision meets Robotics, figure 3)
HEIGHTS = {'kitti00': KITTI, 'tusimple': 1.8}  # m, camera above the road, from the data sets
LABELLED = 'motion_labels.npz'  # of clips from KITTI, which are run with a free scale
ENCODINGS = {'mpeg2.mpg': Encoding('mpeg2video', b_frames=3, gop=12),
             'h264_lowlatency.mp4': LOW_LATENCY,
             'h264_bframes.mp4': Encoding('h264', b_frames=3, gop=30)}
# One B frame where pictures are far apart. MPEG-2 knows no rate below 24 Hz but FFmpeg writes it.
SLOW_ENCODINGS = {'mpeg2.mp4': Encoding('mpeg2video', 1, 12, {'strict': '-2'}),
                  'h264_lowlatency.mp4': LOW_LATENCY,
                  'h264_bframes.mp4': Encoding('h264', 1, 30)}
LOW_RATE_ENCODINGS = {
    'mpeg2.mp4': Encoding('mpeg2video', 1, 12, {'strict': '-2', 'flags': '0', 'b': '1000000'}),
    'h264_lowlatency.mp4': Encoding('h264', 0, 30, {'crf': '-1', 'b': '1000000'}),
    'h264_bframes.mp4': Encoding('h264', 1, 30, {'crf': '-1', 'b': '1000000'})}
REFERENCES = {  # several reference pictures: x264 as it comes, and without B frames
    'h264_default.mp4': Encoding('h264', 3, 250, {'crf': '23', 'x264-params': 'threads=1'}),
    'h264_lowlatency.mp4': Encoding('h264', 0, 250, {'x264-params': 'ref=3:threads=1'})}
TRAFFIC = {  # kind of street: which cars move, by turns from seed to seed
    'street': (('slower', 'faster', 'oncoming'),),
    'crossing': (('starting', 'crossing', 'oncoming'), ('stopping', 'crossing', 'faster')),
    'quiet': ((),),
    'busy': (('bus_ahead', 'bus_beside'),)}  # two fifths of the picture; the rest as in 'quiet'
CAR = {'width': 1240, 'height': 376, 'focal': 718.0, 'fps': 10.0}  # the camera of kitti00
DRIVES: dict[str, dict[str, Any]] = {  # how the camera drives, where it is not straight on
    'standstill': {'standstill': (2.0, 12.0), 'n_frames': 450},
    'spin': {'standstill': (2.0, 5.0), 'pan': 50.0, 'speed': 8.0, 'n_frames': 240},
    'turn': {'turn': 60.0, 'speed': 8.0, 'n_frames': 240},
    'backward': {'speed': -6.0}, 'sideways': {'speed': 6.0, 'view': 90.0},
    'fast 14 m/s': {'speed': 14.0, 'n_frames': 80, **CAR},
    'fast 20 m/s': {'speed': 20.0, 'n_frames': 60, **CAR},
    'bare road': {'houses': False, 'parked': 0, 'movers': ()}}
HAZARDS: dict[str, dict[str, Any]] = {  # what the camera would run into, and what is none
    **{kind.replace('_', ' '): {'movers': (kind,)} for kind in AHEAD},
    # These come late, or are small for long.
    **{kind.replace('_', ' '): {'movers': (kind,), 'n_frames': 126} for kind in (
        'cyclist', 'oncoming_ahead', 'pedestrian')},
    'crossing ahead': {'movers': ('crossing_ahead',), 'n_frames': 135},
    'leader 3, camera at 0.3 m': {'movers': ('leader_3',), 'camera_height': 0.3},
    'leader 3, camera at 0.8 m': {'movers': ('leader_3',), 'camera_height': 0.8},
    'leader 3, camera at 2.5 m': {'movers': ('leader_3',), 'camera_height': 2.5},
    'leader 3, 10 Hz': {'movers': ('leader_3',), **CAR, 'n_frames': 37},
    'leader 5, bare road': {'movers': ('leader_5',), 'houses': False, 'parked': 0},
    'shadows': {'movers': (), 'houses': False, 'parked': 0, 'shadows': 25},
    'parked close by': {'movers': (), 'parked': 6, 'parking': 3.0}}
HAZARD_FRAMES = 111
FLIGHTS = {'flight, wide lens': (WIDE, FlightSettings(n_frames=250)),
           'flight, fisheye': (FISHEYE, FlightSettings(n_frames=250, seed=1)),
           'flight, fast': (WIDE, FlightSettings(n_frames=150, seed=2, speed=4.0))}
HALL: dict[str, Any] = {'size': 2.0, 'furniture': 9, 'fps': 20.0, 'n_frames': 240}
QUICK = 1.6  # spin at which it yaws by up to 50 deg/s
HALLS: dict[str, tuple[Camera, dict[str, Any]]] = {  # flights that pause, in little light
    'hall, stops': (WIDE, {'stops': (3.0, 8.0), 'light': 0.5}),
    'hall, hover': (WIDE, {'hovers': (2.5, 7.5), 'spin': QUICK}),
    'hall, quick yaw': (CUT_FISHEYE, {'spin': QUICK, 'light': 0.4, 'shutter': 0.015}),
    'hall, take-off': (CUT_FISHEYE, {'take_off': 1.5, 'noise': 6.0, 'hovers': (8.0,)}),
    'hall, dim': (WIDE, {'light': 0.3, 'noise': 3.0, 'shutter': 0.01, 'stops': (5.0,),
                         'fps': 30.0, 'n_frames': 330}),
    'hall, all of it': (WIDE, {'take_off': 1.0, 'stops': (4.0,), 'hovers': (7.6,), 'noise': 2.5,
                               'spin': QUICK, 'light': 0.5, 'shutter': 0.012, 'fps': 30.0,
                               'n_frames': 360})}
LOSSES = {'kitti00, 2 s lost': HEIGHTS['kitti00'], 'kitti00, 2 s lost, free scale': 0.0}
GIVEN, FREE = 'speed given, ', 'free scale, '
TOLD = ('kitti00/', 'kitti00, 2 s lost/', 'flight, wide lens/')  # rows with a speed, too
UNTOLD = ('kitti00/',)  # rows without their height, too
LOST = range(80, 100)  # packets of 10 Hz; the road turns meanwhile
ORIGINAL = 'h264_lowlatency.mp4'  # of a sequence; the one that is encoded anew
GUESSED_FOCAL = 0.8  # of the width, where nobody knows the lens
GRAIN = 1.0  # standard deviation of the noise added to pictures [grey levels]
SEVERAL = 'several references, '  # names the rows of videos whose vectors mean several pictures
GRAINY = ', noise'  # names the rows of pictures with noise


@dataclass(frozen=True)
class Case:
    """One row: a video, its camera, and the truth there is.

    Attributes
    ----------
    height : float
        Of the camera above the ground, as the run is told it [m]; 0: it is not.
    true_height : float
        The same, as only the figures are told it.
    """

    name: str
    video: Path
    camera: Camera
    height: float = 0.0
    ground_truth: Path | None = None
    labels: Path | None = None
    boxes: Path | None = None
    annotation: Path | None = None
    speeds: tuple[Speed, ...] = ()
    true_height: float = 0.0


class Scene(NamedTuple):
    """A sequence, street or flight in all its encodings.

    Attributes
    ----------
    name : str
    make : functools.partial of a function of a folder and a text
        Yields the cases whose name holds the text; makes what they need and the folder lacks.
    """

    name: str
    make: partial

    @property
    def content(self) -> str:
        """What tells it from any other scene."""
        return f'{self.name} {self.make.func.__qualname__} {self.make.args}'


def given(data: Path) -> list[Scene]:
    """Return a scene for every folder below another that has a camera."""
    return [Scene(str(folder.relative_to(data)), partial(_given, data, folder))
            for folder in sorted({path.parent for path in data.rglob('camera.yaml')})]


def sequence(data: Path, folder: Path) -> Iterator[Case]:
    """Yield every video of a folder that has a camera."""
    camera = read_camera(folder / 'camera.yaml')
    truth = [folder / name if (folder / name).exists() else None for name in
             ('ground_truth.tum', LABELLED, 'boxes.csv', 'annotation.json')]
    true_height = KITTI if (folder / LABELLED).exists() else 0.0
    for video in sorted([*folder.glob('*.mp4'), *folder.glob('*.mpg')]):
        yield Case(f'{folder.relative_to(data)}/{video.name}', video, camera,
                   HEIGHTS.get(folder.name, 0.0), *truth, true_height=true_height)


def cameraless(data: Path) -> list[Scene]:
    """Return a scene of each video that has no calibration, with a guessed one."""
    return [Scene(f'original_codec/{video.name}', partial(_cameraless, video))
            for video in sorted((data / 'original_codec').glob('*.mp4'))]


def recoded(data: Path) -> list[Scene]:
    """Return kitti00 at a low bit rate, and with every other picture left out."""
    return _of_sequences(
        data, Anew('kitti00 at 1 Mbit/s', 'kitti00', 10.0, LOW_RATE_ENCODINGS),
        Anew('kitti00 at 5 Hz', 'kitti00', 5.0, SLOW_ENCODINGS, step=2))


def lossy(data: Path) -> list[Scene]:
    """Return kitti00 with the packets of two seconds left out, as a radio link would."""
    return [Scene(kind, partial(_lossy, data / 'kitti00', kind, height))
            for kind, height in LOSSES.items() if (data / 'kitti00' / ORIGINAL).exists()]


def streets(count: int, n_frames: int, first: int = 0) -> list[Scene]:
    """Return streets of different seeds, from the first on."""
    return [_street(f'{kind} {seed}', StreetSettings(
                seed=seed, n_frames=n_frames, movers=TRAFFIC[kind][seed % len(TRAFFIC[kind])]))
            for kind, seed in product(TRAFFIC, range(first, first + count))]


def references(count: int, n_frames: int, first: int = 0) -> list[Scene]:
    """Return the first streets with movers once more, coded with several reference pictures."""
    return [Scene(kind, partial(_filmed_with, REFERENCES, kind, scene.make.args[1]))
            for scene in streets(min(count, 2), n_frames, first)
            if not scene.name.startswith('quiet')
            for kind in [SEVERAL + scene.name]]


def drives(first: int = 0) -> list[Scene]:
    """Return the streets in which the camera does not simply drive ahead."""
    return [_street(kind, StreetSettings(seed=10 + seed, **settings))
            for seed, (kind, settings) in enumerate(DRIVES.items(), first)]


def hazards(count: int, first: int = 0) -> list[Scene]:
    """Return drives of different seeds toward what a planner must brake for, and what not."""
    return [_street(f'{kind} {seed}', StreetSettings(
                **{'seed': 30 + seed, 'n_frames': HAZARD_FRAMES, **settings}))
            for (kind, settings), seed in product(HAZARDS.items(), range(first, first + count))]


def flights(first: int = 0) -> list[Scene]:
    """Return flights through rooms and halls; the scale is free."""
    halls = {kind: (lens, FlightSettings(**{**HALL, 'seed': 20 + seed, **settings}))
             for seed, (kind, (lens, settings)) in enumerate(HALLS.items())}
    return [Scene(kind, partial(_flight, kind, lens, replace(settings, seed=settings.seed + first),
                                0.0))
            for kind, (lens, settings) in (FLIGHTS | halls).items()]


def grainy(data: Path, scenes: Iterable[Scene]) -> list[Scene]:
    """Return rendered scenes, and sequences whose way is known, with noise in their pictures.

    The same scene in other vectors, with the same truth: how far a figure carries.
    """
    again = [Scene(name, partial(scene.make.func, name, *scene.make.args[1:-1], GRAIN))
             for scene in scenes if scene.make.func in (_filmed, _flight)
             for name in [scene.name + GRAINY]]
    return again + _of_sequences(
        data, Anew('kitti00' + GRAINY, 'kitti00', 10.0, SLOW_ENCODINGS, grain=GRAIN),
        Anew('parking' + GRAINY, 'parking', 30.0, ENCODINGS, grain=GRAIN))


def otherwise_scaled(cases: Iterable[Case], seed: int = 0) -> Iterator[Case]:
    """Yield cases, and some once more without their height, or with a speed in its place."""
    for case in cases:
        yield case
        if case.name.startswith(UNTOLD):
            yield replace(case, name=FREE + case.name, height=0.0)
        if case.name.startswith(TOLD):
            truth = case.ground_truth
            truth = read_trajectory(truth / 'ground_truth.tum' if truth.is_dir() else truth)
            yield replace(case, name=GIVEN + case.name, height=0.0,
                          speeds=tuple(drawn_speeds(truth, seed)))


def named(kind: str, encodings: dict[str, Encoding], only: str) -> dict[str, Encoding]:
    """Return the encodings by the names of their rows, of those whose name holds ``only``."""
    return {f'{kind}/{file}': encoding for file, encoding in encodings.items()
            if only in f'{kind}/{file}'}


def encoded(wanted: dict[str, Encoding], folder: Path, fps: float,
            images: Callable[[], Iterable[np.ndarray]], like: Case) -> Iterator[Case]:
    """Write the pictures that a function gives in each encoding that a folder lacks.

    Yields the cases, else as ``like``. The function is not called where all videos are there; it
    may write the truth beside them.
    """
    videos = {name: folder / name.replace('/', ' - ') for name in wanted}
    missing = {name: video for name, video in videos.items() if not video.exists()}
    pictured = list(images()) if missing else []
    for name, video in missing.items():
        part = video.with_name(f'part {video.name}')  # a run may end in the midst of a video
        write_video(part, pictured, fps, wanted[name])
        part.replace(video)
    yield from (replace(like, name=name, video=video) for name, video in videos.items())


def with_grain(images: Iterable[np.ndarray], sigma: float, seed: int = 0) -> Iterator[np.ndarray]:
    """Yield pictures with noise added, which changes the vectors but not the scene."""
    rng = np.random.default_rng(seed)
    for image in images:
        noise = sigma * rng.standard_normal(image.shape, np.float32)
        yield np.clip(np.rint(image + noise), 0, 255).astype(np.uint8) if sigma else image


class Anew(NamedTuple):
    """How a sequence is encoded anew: every ``step``-th picture, with noise [grey levels]."""

    kind: str
    sequence: str
    fps: float
    encodings: dict[str, Encoding]
    step: int = 1
    grain: float = 0.0


def _of_sequences(data, *ways):
    return [Scene(way.kind, partial(_recoded, data / way.sequence, way)) for way in ways
            if (data / way.sequence / ORIGINAL).exists()]


def _given(data, folder, _, only):
    return (case for case in otherwise_scaled(sequence(data, folder)) if only in case.name)


def _cameraless(video, _, only):
    name = f'original_codec/{video.name}'
    if only in name:
        height, width = next(pictures(video)).shape
        focal = GUESSED_FOCAL * width
        K = np.array([[focal, 0, (width - 1) / 2], [0, focal, (height - 1) / 2], [0, 0, 1]])
        yield Case(name, video, Camera(width, height, K))


def _recoded(source, way, folder, only):
    def images():
        """Return every so many-th picture, with the grain of the way."""
        return with_grain(islice(pictures(source / ORIGINAL), 0, None, way.step), way.grain)

    yield from encoded(named(way.kind, way.encodings, only), folder, way.fps, images, Case(
        '', folder, read_camera(source / 'camera.yaml'), HEIGHTS.get(source.name, 0.0),
        source / 'ground_truth.tum'))


def _lossy(source, kind, height, folder, only):
    for name in named(kind, ENCODINGS, ''):
        whole, video = source / Path(name).name, folder / Path(name).name
        if whole.exists():
            if not video.exists():
                leave_out(whole, part := video.with_name(f'part {video.name}'), LOST)
                part.replace(video)
            case = Case(name, video, read_camera(source / 'camera.yaml'), height,
                        source / 'ground_truth.tum')
            yield from (row for row in otherwise_scaled([case]) if only in row.name)


def _street(kind, settings):
    return Scene(kind, partial(_filmed, kind, settings, 0.0))


def _filmed(kind, settings, grain, folder, only):
    encodings = ENCODINGS if settings.fps >= 24 else SLOW_ENCODINGS
    yield from _filmed_with(encodings, kind, settings, folder, only, grain)


def _filmed_with(encodings, kind, settings, folder, only, grain=0.0):
    if wanted := named(kind, encodings, only):
        street, truth = Street(settings), folder / 'truth'
        yield from encoded(wanted, folder, settings.fps,
                           lambda: with_grain(film(street, truth), grain),
                           Case('', folder, street.camera, settings.camera_height, truth))


def _flight(kind, lens, settings, grain, folder, only):
    given_anyway = only.removeprefix(GIVEN)
    truth = folder / 'truth'
    cases = encoded(named(kind, ENCODINGS, given_anyway), folder, settings.fps,
                    lambda: with_grain(film_flight(Flight(lens, settings), truth), grain),
                    Case('', folder, lens, 0.0, truth))
    yield from (case for case in otherwise_scaled(cases) if only in case.name)
