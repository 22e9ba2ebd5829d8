"""``mv_slapse doctor``: is this installation able to run, and if not what to install."""

import argparse
from dataclasses import dataclass, replace
import importlib
import importlib.util
import os
import subprocess  # to ask programs for their versions  # nosec B404
import sys

from mv_slapse.errors import MissingKernels, MvSlapseError, UnusableInput
from mv_slapse.tools.terminal import say

PYTHONS = ((3, 11), (3, 12))
#: module, distribution, oldest version that works
LIBRARIES = (('numpy', 'numpy', '1.26'), ('scipy', 'scipy', '1.11'),
             ('cv2', '"opencv-python-headless<5"', '4.6'), ('av', 'av', '10'),
             ('rosbags', 'rosbags', '0.10'), ('mcap', 'mcap', '1.0'),
             ('matplotlib', 'matplotlib', '3.6'), ('tqdm', 'tqdm', '4.0'),
             ('yaml', 'pyyaml', '6.0'))
EXTRAS = (('dask', "'dask>=2024.8'", '2024.8'), ('distributed', "'distributed>=2024.8'", '2024.8'))
SHIFT = 3  # px that the picture moves in each frame of the test clip
RATE = 10.0  # Hz, of that clip
GET_ROS = 'source /opt/ros/jazzy/setup.sh, or run `make setup` (x86-64)'
GET_MESSAGES = ('source install/setup.sh of the workspace that colcon built, or run '
                '`make messages`')


@dataclass(frozen=True)
class Finding:
    """One thing that was looked at.

    Attributes
    ----------
    name : str
    ok : bool
    detail : str
        Version, or what is wrong.
    cure : str
        What to do where it is not ok.
    needed : bool
        The command line cannot run without it; else only the nodes cannot.
    extra : str
        The one command that alone needs it; nothing else does.
    """

    name: str
    ok: bool
    detail: str
    cure: str = ''
    needed: bool = True
    extra: str = ''


def examine() -> list[Finding]:
    """Look at all that the command line and the nodes need."""
    libraries = [*(library(*names) for names in LIBRARIES), kernels()]
    vectors = motion_vectors() if all(item.ok for item in (*libraries[:4], libraries[-1])) \
        else Finding('motion vectors', False, 'not tried', 'install the libraries above')
    extras = [replace(library(*names), needed=False, extra='mv_slapse batch') for names in EXTRAS]
    return [python(), *libraries, definitions(), vectors, *ros(), *extras]


def exit_code(findings: list[Finding]) -> int:
    """Return 0 where the command line can run, else 3."""
    return 0 if all(item.ok for item in findings if item.needed) else UnusableInput.exit_code


def table(findings: list[Finding]) -> str:
    """Return the findings as text, a line for each, and a verdict."""
    width = max(len(item.name) for item in findings)
    lines = [f'{item.name:{width}}  {"ok" if item.ok else "absent" if item.extra else "MISSING":7}'
             f'  {item.detail}' + ('' if item.ok else f'\n{"":{width}}           -> {item.cure}'
                                   + (f' (for {item.extra})' if item.extra else ''))
             for item in findings]
    able = {True: 'can run', False: 'can NOT run'}
    command_line = all(item.ok for item in findings if item.needed)
    nodes = all(item.ok for item in findings if not item.extra)
    return '\n'.join([*lines, '', f'command line: {able[command_line]}',
                      f'ROS nodes:    {able[nodes]}'])


def python() -> Finding:
    """Check the interpreter's version."""
    version = '.'.join(map(str, sys.version_info[:3]))
    return Finding('python', sys.version_info[:2] in PYTHONS, version,
                   'use Python 3.11 or 3.12')


def library(module: str, distribution: str, oldest: str) -> Finding:
    """Import a library and compare its version with the oldest that works."""
    cure = f'pip install {distribution}, or run `make setup`'
    try:
        found = importlib.import_module(module)
    except Exception as error:  # a broken binary raises anything
        return Finding(module, False, f'{type(error).__name__}: {error}', cure)
    version = getattr(found, '__version__', None)
    if version is None:
        return Finding(module, True, 'version unknown')
    ok = numbers(version) >= numbers(oldest)
    return Finding(module, ok, version if ok else f'{version} is older than {oldest}', cure)


def kernels() -> Finding:
    """Load the compiled kernels."""
    name = 'compiled kernels'
    try:
        from mv_slapse.kernels import binding
    except MissingKernels as error:
        return Finding(name, False, str(error.__cause__), error.cure)
    return Finding(name, True, binding.compiled.__file__)


def definitions() -> Finding:
    """Look for the message definitions, by which results are written as a bag."""
    name = 'message definitions'
    try:
        from mv_slapse.storage.messages import definition_folder
        return Finding(name, True, str(definition_folder()))
    except Exception as error:  # of a library that is not there, too
        return Finding(name, False, f'{type(error).__name__}: {error}', 'install mv_slapse anew')


def numbers(version: str) -> tuple[int, ...]:
    """Return the leading numbers of a version."""
    parts = version.split('.')
    return tuple(int(part) for part in parts[:2] if part.isdigit())


def motion_vectors() -> Finding:
    """Encode a picture that moves, and compare the vectors read back with its motion."""
    cure = 'install a PyAV with its own FFmpeg: pip install --only-binary av av'
    try:
        measured, count = measure_shift()
    except (MvSlapseError, ImportError, OSError, ValueError) as error:
        return Finding('motion vectors', False, f'{type(error).__name__}: {error}', cure)
    ok = abs(measured - SHIFT) < 0.5
    return Finding('motion vectors', ok, f'{count} vectors; the picture moved {SHIFT} px, '
                   f'they say {measured:.2f} px', cure)


def measure_shift() -> tuple[float, int]:
    """Return the motion [px/frame] that a small clip's vectors show, and their number."""
    from mv_slapse.codec.decoder import CorrespondenceDecoder
    from mv_slapse.codec.encoding.encoder import encode, Encoding
    from mv_slapse.config import DecoderSettings
    import numpy as np
    scene = np.random.default_rng(0).integers(0, 256, (12, 20)).astype(np.uint8)
    scene = np.kron(scene, np.ones((8, 8), np.uint8))
    images = [scene[:, SHIFT * i:SHIFT * i + 128] for i in range(9)]
    decoder = CorrespondenceDecoder(DecoderSettings())
    packets = encode(images, RATE, Encoding(b_frames=1, gop=12))
    pairs = [pair for packet in packets for pair in decoder.feed(packet)] + decoder.flush()
    per_frame = [(pair.x_prev - pair.x_cur)[:, 0] / (pair.stamp - pair.previous_stamp)
                 * 1e9 / RATE for pair in pairs]
    vectors = np.concatenate(per_frame) if per_frame else np.zeros(0)
    if not len(vectors):
        raise UnusableInput('the decoder exports no motion vectors')
    return float(np.median(vectors)), len(vectors)


def ros() -> list[Finding]:
    """Check ROS, the messages, and that a message passes through DDS."""
    found = {name: importlib.util.find_spec(name) for name in ('rclpy', 'mv_slapse_msgs')}
    cures = {'rclpy': GET_ROS, 'mv_slapse_msgs': GET_MESSAGES}
    findings = [Finding(name, spec is not None, spec.origin if spec else 'not installed',
                        cures[name], needed=False) for name, spec in found.items()]
    if not all(found.values()):
        return [*findings, Finding('DDS', False, 'not tried', 'install the two above',
                                   needed=False)]
    return [*findings, dds()]


def dds() -> Finding:
    """Send a message round in a process of its own, so that a hang or a crash is a finding."""
    cure = 'check RMW_IMPLEMENTATION, LD_LIBRARY_PATH and that the loopback device is up'
    environment = {**os.environ, 'ROS_AUTOMATIC_DISCOVERY_RANGE': 'LOCALHOST'}
    command = [sys.executable, '-m', 'mv_slapse.nodes.self_test']
    try:
        done = subprocess.run(command, env=environment, capture_output=True, text=True,
                              timeout=30)  # our own module  # nosec B603
    except subprocess.TimeoutExpired:
        return Finding('DDS', False, 'no answer within 30 s', cure, needed=False)
    lines = (done.stdout + done.stderr).strip().splitlines()
    return Finding('DDS', done.returncode == 0, lines[-1] if lines else 'no output', cure,
                   needed=False)


def main(arguments: list[str] | None = None) -> int:
    """Print the table and return the exit code."""
    argparse.ArgumentParser(prog='mv_slapse doctor', description=__doc__).parse_args(arguments)
    findings = examine()
    say(table(findings))
    return exit_code(findings)


if __name__ == '__main__':
    sys.exit(main())
