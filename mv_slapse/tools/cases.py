"""What ``make evaluate`` measures: sequences, the same re-encoded, rendered streets and flights.

Each family yields its cases one after another, rendered or encoded only when their turn comes.
"""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path
from typing import Any

from mv_slapse.codec.encoder import Encoding, leave_out, LOW_LATENCY, write_video
from mv_slapse.codec.pictures import pictures
from mv_slapse.geometry.camera import Camera
from mv_slapse.records import Speed
from mv_slapse.simulation.flight import FISHEYE, Flight, FlightSettings, WIDE
from mv_slapse.simulation.street import Street, StreetSettings
from mv_slapse.simulation.truth import film, film_flight
from mv_slapse.simulation.wheels import drawn_speeds
from mv_slapse.storage.camera_info import read_camera
from mv_slapse.storage.tum import read_trajectory
import numpy as np

HEIGHTS = {'kitti00': 1.65, 'tusimple': 1.8}  # m, camera above the road, from the data sets
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
FLIGHTS = {'flight, wide lens': (WIDE, FlightSettings(n_frames=250)),
           'flight, fisheye': (FISHEYE, FlightSettings(n_frames=250, seed=1)),
           'flight, fast': (WIDE, FlightSettings(n_frames=150, seed=2, speed=4.0))}
LOSSES = {'kitti00, 2 s lost': HEIGHTS['kitti00'], 'kitti00, 2 s lost, free scale': 0.0}
GIVEN, FREE = 'speed given, ', 'free scale, '
TOLD = ('kitti00/', 'kitti00, 2 s lost/', 'flight, wide lens/')  # rows with a speed, too
UNTOLD = ('kitti00/',)  # rows without their height, too
LOST = range(80, 100)  # packets of 10 Hz; the road turns meanwhile
GUESSED_FOCAL = 0.8  # of the width, where nobody knows the lens


@dataclass(frozen=True)
class Case:
    """One row: a video, its camera, and the truth there is."""

    name: str
    video: Path
    camera: Camera
    height: float = 0.0
    ground_truth: Path | None = None
    labels: Path | None = None
    boxes: Path | None = None
    annotation: Path | None = None
    speeds: tuple[Speed, ...] = ()


def sequences(data: Path) -> Iterator[Case]:
    """Yield every video below a folder that has a camera beside it."""
    for folder in sorted({path.parent for path in data.rglob('camera.yaml')}):
        camera = read_camera(folder / 'camera.yaml')
        truth = [folder / name if (folder / name).exists() else None for name in
                 ('ground_truth.tum', 'motion_labels.npz', 'boxes.csv', 'annotation.json')]
        for video in sorted([*folder.glob('*.mp4'), *folder.glob('*.mpg')]):
            yield Case(f'{folder.relative_to(data)}/{video.name}', video, camera,
                       HEIGHTS.get(folder.name, 0.0), *truth)


def cameraless(data: Path) -> Iterator[Case]:
    """Yield the videos that have no calibration, with a guessed one."""
    for video in sorted((data / 'original_codec').glob('*.mp4')):
        height, width = next(pictures(video)).shape
        focal = GUESSED_FOCAL * width
        K = np.array([[focal, 0, (width - 1) / 2], [0, focal, (height - 1) / 2], [0, 0, 1]])
        yield Case(f'original_codec/{video.name}', video, Camera(width, height, K))


def recoded(data: Path, folder: Path, only: str = '') -> Iterator[Case]:
    """Yield kitti00 at a low bit rate, and with every other picture left out."""
    source = data / 'kitti00'
    if not (source / 'h264_lowlatency.mp4').exists():
        return
    for kind, fps, step, encodings in (('kitti00 at 1 Mbit/s', 10.0, 1, LOW_RATE_ENCODINGS),
                                       ('kitti00 at 5 Hz', 5.0, 2, SLOW_ENCODINGS)):
        wanted = named(kind, encodings, only)
        if wanted:
            images = list(pictures(source / 'h264_lowlatency.mp4'))[::step]
            yield from encoded(wanted, folder, images, fps, Case(
                '', folder, read_camera(source / 'camera.yaml'), HEIGHTS['kitti00'],
                source / 'ground_truth.tum'))


def lossy(data: Path, folder: Path, only: str = '') -> Iterator[Case]:
    """Yield kitti00 with the packets of two seconds left out, as a radio link would."""
    source = data / 'kitti00'
    for kind, height in LOSSES.items():
        for name in named(kind, ENCODINGS, only):
            given, video = source / Path(name).name, folder / name
            if given.exists():
                video.parent.mkdir(parents=True, exist_ok=True)
                leave_out(given, video, LOST)
                yield Case(name, video, read_camera(source / 'camera.yaml'), height,
                           source / 'ground_truth.tum')


def otherwise_scaled(given: Iterable[Case], seed: int = 0) -> Iterator[Case]:
    """Yield cases, and some once more without their height, or with a speed in its place."""
    for case in given:
        yield case
        if case.name.startswith(UNTOLD):
            yield replace(case, name=FREE + case.name, height=0.0)
        if case.name.startswith(TOLD):
            truth = case.ground_truth
            truth = read_trajectory(truth / 'ground_truth.tum' if truth.is_dir() else truth)
            yield replace(case, name=GIVEN + case.name, height=0.0,
                          speeds=tuple(drawn_speeds(truth, seed)))


def streets(folder: Path, count: int, n_frames: int, only: str = '') -> Iterator[Case]:
    """Render streets of different seeds into a folder and yield them in every encoding.

    ``only``: those whose row's name holds this text.
    """
    for kind, seed in product(TRAFFIC, range(count)):
        movers = TRAFFIC[kind][seed % len(TRAFFIC[kind])]
        yield from _street(f'{kind} {seed}', folder, only,
                           StreetSettings(seed=seed, n_frames=n_frames, movers=movers))


def drives(folder: Path, only: str = '') -> Iterator[Case]:
    """Render the streets in which the camera does not simply drive ahead."""
    for seed, (kind, settings) in enumerate(DRIVES.items()):
        yield from _street(kind, folder, only, StreetSettings(seed=10 + seed, **settings))


def flights(folder: Path, only: str = '') -> Iterator[Case]:
    """Render flights through a room; the scale is free."""
    for kind, (lens, settings) in FLIGHTS.items():
        wanted = named(kind, ENCODINGS, only)
        if wanted:
            images = list(film_flight(Flight(lens, settings), folder / kind))
            yield from encoded(wanted, folder, images, settings.fps,
                                Case('', folder, lens, 0.0, folder / kind))


def _street(kind: str, folder: Path, only: str, settings: StreetSettings) -> Iterator[Case]:
    wanted = named(kind, ENCODINGS if settings.fps >= 24 else SLOW_ENCODINGS, only)
    if wanted:
        street = Street(settings)
        images = list(film(street, folder / kind))
        yield from encoded(wanted, folder, images, settings.fps, Case(
            '', folder, street.camera, settings.camera_height, folder / kind))


def named(kind: str, encodings: dict[str, Encoding], only: str) -> dict[str, Encoding]:
    """Return the encodings by the names of their rows, of those whose name holds ``only``."""
    return {f'{kind}/{file}': encoding for file, encoding in encodings.items()
            if only in f'{kind}/{file}'}


def encoded(wanted: dict[str, Encoding], folder: Path, images: Iterable[np.ndarray], fps: float,
            like: Case) -> Iterator[Case]:
    """Write pictures in each encoding into a folder and yield the cases, else as ``like``."""
    for name, encoding in wanted.items():
        video = folder / name
        video.parent.mkdir(parents=True, exist_ok=True)
        write_video(video, images, fps, encoding)
        yield replace(like, name=name, video=video)
