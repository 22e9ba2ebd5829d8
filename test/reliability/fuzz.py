"""Damaged streams, messages, bags, camera and settings files: own errors or values, no more.

Each target runs in child processes, so that a crash of native code or a hang is a finding and
not the end. The seeds are fixed: case i is the same on every machine.
"""

import argparse
from collections.abc import Callable, Iterable
from dataclasses import dataclass
import faulthandler
import json
from pathlib import Path
import shutil
import signal
import subprocess
import sys
import tempfile
import time
import traceback
from typing import Any

import made_up
from mv_slapse import fields
from mv_slapse.codec.decoder import CorrespondenceDecoder
from mv_slapse.codec.encoding.encoder import write_video
from mv_slapse.codec.source import open_source
from mv_slapse.config import Settings
from mv_slapse.errors import MvSlapseError
from mv_slapse.geometry.camera import Camera
from mv_slapse.pipeline import Slapse
from mv_slapse.storage import messages
from mv_slapse.storage.bag_reader import BagReader
from mv_slapse.storage.bag_writer import BagWriter
from mv_slapse.storage.camera_info import read_camera, write_camera
from mv_slapse.tools.settings_arguments import override, read_settings
from mv_slapse.video_messages import FFMPEG_PACKET, from_message, packet_to_fields
import numpy as np
import pictures
from reliability import clips, mutations

LONGEST = 2.0  # s of CPU for one case; above, it counts as a hang
STUCK = 60  # s after which a case is ended, on a machine that does other things, too
COUNTS = {'streams': 20_000, 'messages': 100_000, 'bags': 5_000, 'files': 5_000}
CHILDREN = 20  # processes that share the cases of a target
ODD_NUMBERS = (float('nan'), float('inf'), -float('inf'), 0.0, -1.0, 1e300, 1e-300)
SPACE = '/dev/shm' if Path('/dev/shm').is_dir() else None


@dataclass
class Finding:
    """What went wrong in a case: its number, and how."""

    target: str
    case: int
    text: str


def streams(folder: Path) -> Callable[[int], None]:
    """Every codec through decoder and pipeline, and every fourth through a container."""
    coded = {kind.name: clips.drawn(kind, 14) for kind in clips.KINDS}
    size = {kind.name: (176, 144) if kind.encoder == 'h263' else (192, 160)
            for kind in clips.KINDS}
    containers = [folder / name for name in ('a.mp4', 'a.mpg', 'a.mkv', 'a.ts')]
    for path in containers:
        write_video(path, pictures.sliding(np.random.default_rng(0), 8, (2, 1), (192, 160)), 25)
    names = list(coded)

    def run(case: int):
        rng, kind = np.random.default_rng(case), case % len(mutations.MUTATIONS)
        name = names[case // len(mutations.MUTATIONS) % len(names)]
        packets = mutations.damaged(coded[name], kind, rng)
        if case % 4 == 3:
            path = containers[case // 4 % len(containers)]
            target = folder / f'case{path.suffix}'
            target.write_bytes(mutations.MUTATIONS[kind](path.read_bytes(), rng))
            with open_source(target) as source:
                packets = list(source.packets())
        play(packets, size[name])

    return run


def play(packets: list, size: tuple[int, int]):
    """Take packets through the core, and check what comes out."""
    camera = Camera(*size, np.array([[200.0, 0, size[0] / 2], [0, 200, size[1] / 2], [0, 0, 1]]))
    decoder, core = CorrespondenceDecoder(Settings().decoder, camera), Slapse(camera, Settings())
    for packet in [*packets, None]:
        try:
            pairs = decoder.flush() if packet is None else decoder.feed(packet)
        except MvSlapseError:
            continue  # the node reports it and goes on
        for pair in pairs:
            check_columns(pair.x_cur, pair.x_prev, pair.sigma, pair.probability)
            if (pair.width, pair.height) == size:
                check_scene(core.step(pair).scene)


def check_columns(*columns: np.ndarray):
    """Refuse what is not finite."""
    for column in columns:
        if not np.all(np.isfinite(column)):
            raise AssertionError('something is not finite')


def check_scene(scene):
    """Refuse a pose that is not finite, or covariances that are no covariances."""
    check_columns(scene.R_world_from_cam, scene.t_world_from_cam, scene.pose_covariance)
    for covariance in (scene.pose_covariance, *(plane.covariance for plane in scene.planes)):
        values = np.linalg.eigvalsh((covariance + covariance.T) / 2)
        if values[0] < -1e-9 * max(values[-1], 1):
            raise AssertionError(f'a covariance has the eigenvalue {values[0]:g}')


def records(rng: np.random.Generator) -> dict[str, tuple[dict, Callable]]:
    """Return the fields of each message that nodes take, and what reads it."""
    frames = fields.RosFrames()
    return {
        'mv_slapse_msgs/msg/Correspondences': (fields.correspondences_to_fields(
            made_up.correspondences(rng), frames), fields.correspondences_from_message),
        'mv_slapse_msgs/msg/PlaneObservations': (fields.extraction_to_fields(
            made_up.extraction(rng), frames), fields.extraction_from_message),
        'sensor_msgs/msg/CameraInfo': (fields.camera_to_fields(Camera(64, 48, np.array(
            [[50.0, 0, 32], [0, 50, 24], [0, 0, 1]])), 0, 'eye'), fields.camera_from_message),
        FFMPEG_PACKET: (packet_to_fields(clips.drawn(clips.KINDS[0], 2)[0], (192, 160), 0, 'eye'),
                        lambda msg: from_message(FFMPEG_PACKET, msg))}


def message_cases(folder: Path) -> Callable[[int], None]:
    """Serialised messages with damage; bytes that are no message are the middleware's matter."""
    store = messages.typestore()
    known = {name: (messages.serialize(name, values), read)
             for name, (values, read) in records(np.random.default_rng(0)).items()}
    names = list(known)

    def run(case: int):
        rng, name = np.random.default_rng(case), names[case % len(names)]
        data, read = known[name]
        if case // len(names) % 2:
            msg = store.deserialize_cdr(data, name)
            for _ in range(int(rng.integers(1, 4))):
                alter(msg, rng)
            check_record(read(msg))
            return
        data = mutations.MUTATIONS[case // len(names) % len(mutations.MUTATIONS)](data, rng)
        try:
            msg = store.deserialize_cdr(data, name)
        except Exception:  # noqa: BLE001 (rosbags' own; no node sees it)
            return
        check_record(read(msg))

    return run


def alter(msg: Any, rng: np.random.Generator):
    """Give a field of a message, or of one within, a value that its type allows."""
    names = [name for name in vars(msg) if not name.startswith('__')]
    name = names[int(rng.integers(len(names)))]
    value = getattr(msg, name)
    if isinstance(value, np.ndarray):
        how = int(rng.integers(4))
        if how == 0:
            value = value[:int(rng.integers(0, len(value) + 1))]
        elif how == 1:
            value = np.concatenate([value, value, value[:1]])
        elif len(value):
            value = value.copy()
            odd = ODD_NUMBERS if value.dtype.kind == 'f' else (0, 1, np.iinfo(value.dtype).max)
            value[int(rng.integers(len(value)))] = odd[int(rng.integers(len(odd)))]
        setattr(msg, name, value)
    elif isinstance(value, int | float) and not isinstance(value, bool):
        odd = ODD_NUMBERS if isinstance(value, float) else (0, 1, 99, 255, 2**31 - 1)
        setattr(msg, name, odd[int(rng.integers(len(odd)))])
    elif isinstance(value, list) and value:
        alter(value[int(rng.integers(len(value)))], rng)
    elif hasattr(value, '__dataclass_fields__'):
        alter(value, rng)


def check_record(record: Any):
    """Refuse a record of which a column is not finite, or as long as the others."""
    if hasattr(record, 'x_cur'):
        columns = record.x_cur, record.x_prev, record.sigma, record.block
        check_columns(*columns)
        if len({len(column) for column in columns}) > 1:
            raise AssertionError('columns differ in length')


def bags(folder: Path) -> Callable[[int], None]:
    """Bags with damage in a file."""
    made = []
    for compressed in (False, True):
        path = folder / f'bag{compressed}'
        with BagWriter(path, compressed) as writer:
            for k, packet in enumerate(clips.drawn(clips.KINDS[0], 6)):
                writer.write('/video', FFMPEG_PACKET,
                             packet_to_fields(packet, (192, 160), k, 'eye'), packet.stamp)
        made.append(path)

    def run(case: int):
        rng, source = np.random.default_rng(case), made[case % 2]
        target = folder / 'case'
        shutil.rmtree(target, ignore_errors=True)
        shutil.copytree(source, target)
        files = sorted(target.iterdir())
        path = files[0] if case % 8 else files[-1]
        path.write_bytes(mutations.MUTATIONS[case // 8 % len(mutations.MUTATIONS)](
            path.read_bytes(), rng))
        reader = BagReader(target if case % 3 else path)
        sum(1 for _ in reader.packets(reader.video_topic()))

    return run


def files(folder: Path) -> Callable[[int], None]:
    """Camera files, settings files and assignments with damage."""
    write_camera(folder / 'camera.yaml', Camera(640, 480, np.array(
        [[500.0, 0, 320], [0, 500, 240], [0, 0, 1]])))
    settings = Path(__file__).resolve().parents[2] / 'config'
    sources = [folder / 'camera.yaml', *sorted(settings.glob('*.yaml'))]

    def run(case: int):
        rng, source = np.random.default_rng(case), sources[case % len(sources)]
        data = source.read_bytes()
        for _ in range(int(rng.integers(1, 4))):
            data = mutations.MUTATIONS[int(rng.integers(len(mutations.MUTATIONS)))](data, rng)
        target = folder / 'case.yaml'
        target.write_bytes(data)
        (read_camera if case % len(sources) == 0 else read_settings)(target)
        override(Settings(), [data[:60].decode(errors='replace')])

    return run


TARGETS = {'streams': streams, 'messages': message_cases, 'bags': bags, 'files': files}


def batch(target: str, cases: Iterable[int], patience: int = STUCK) -> list[Finding]:
    """Run cases in this process, telling the number of each before it begins."""
    found = []
    with tempfile.TemporaryDirectory(dir=SPACE) as name:
        run = TARGETS[target](Path(name))
        for case in cases:
            sys.stderr.write(f'case {case}\n')
            signal.alarm(patience)
            begin = time.process_time()
            try:
                run(case)
            except MvSlapseError:
                pass
            except Exception as error:  # noqa: BLE001 (the findings)
                where = traceback.extract_tb(error.__traceback__)[-1]
                found.append(Finding(target, case, f'{type(error).__name__}: {error} '
                                     f'({Path(where.filename).name}:{where.lineno})'))
            seconds = time.process_time() - begin
            if seconds > LONGEST:
                found.append(Finding(target, case, f'took {seconds:.1f} s'))
    return found


def child(target: str, first: int, n: int) -> list[Finding]:
    """Run cases in a process of its own, and begin anew behind one that ends it."""
    found = []
    while n > 0:
        done = subprocess.run([sys.executable, __file__, '--child', target, str(first), str(n)],
                              capture_output=True, text=True)
        if done.returncode == 0:
            return [*found, *(Finding(**item) for item in json.loads(done.stdout))]
        cases = [line for line in done.stderr.splitlines() if line.startswith('case ')]
        last = int(cases[-1].split()[1]) if cases else first
        tail = ' / '.join(done.stderr.splitlines()[-3:])
        found.append(Finding(target, last, f'ended the process: {done.returncode} {tail}'))
        n, first = n - (last - first) - 1, last + 1
    return found


def main() -> int:
    """Print findings as they come and a line for each target; return 1 where there are any."""
    if sys.argv[1:2] == ['--child']:
        faulthandler.enable()
        first, n = map(int, sys.argv[3:])
        found = batch(sys.argv[2], range(first, first + n))
        print(json.dumps([item.__dict__ for item in found]))
        return 0
    parser = argparse.ArgumentParser(description=__doc__)
    for name, count in COUNTS.items():
        parser.add_argument(f'--{name}', type=int, default=count)
    parser.add_argument('--first', type=int, default=0, help='case to begin with (default: 0)')
    args, bad = parser.parse_args(), 0
    for name in TARGETS:
        found, n = [], getattr(args, name)
        size = max(n // CHILDREN, 1)
        for first in range(args.first, n, size):
            for item in child(name, first, min(size, n - first)):
                found.append(item)
                print(f'{item.target} {item.case}: {item.text}', flush=True)
            print(f'{name}: {min(first + size, n)} done', file=sys.stderr, flush=True)
        bad += len(found)
        print(f'{name}: {n} cases, {len(found)} findings', flush=True)
    return int(bad > 0)


if __name__ == '__main__':
    sys.exit(main())
