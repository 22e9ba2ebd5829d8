"""The command line: ``mv_slapse run``, ``batch``, ``eval``, ``inspect``, ``bag``, ``demo`` ...

What a command needs is imported when it runs, so that ``doctor`` works where a library is
missing. Exit codes: 0 done, 1 a fault of this program, 2 usage, 3 unusable input, 4 tracking lost
for most of the input, 5 some recordings of a batch failed, 130 interrupted.
"""

import argparse
from collections.abc import Sequence
from contextlib import ExitStack, suppress
from functools import partial
from io import TextIOWrapper
import json
import os
import shlex
import signal
import sys
from typing import Any

from mv_slapse.errors import MvSlapseError
from mv_slapse.tools.plain import plain
from mv_slapse.tools.terminal import say

FAULT, LOST, INTERRUPTED = 1, 4, 130
MOST = 10**9  # pictures, or processes
LAST_START = 2_000_000_000  # [s]: ROS counts seconds in 31 bits, and a bag goes on from there


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line and return its exit code."""
    arguments = list(sys.argv[1:] if argv is None else argv)
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, TextIOWrapper):  # names need not be of the terminal's letters
            stream.reconfigure(errors='backslashreplace')
    made = parser()
    if '_ARGCOMPLETE' in os.environ:  # the shell asks what may follow, and nothing else is done
        import argcomplete
        argcomplete.autocomplete(made)
    args = _parsed(made, arguments)
    args.command_line = shlex.join(['mv_slapse', *arguments])
    try:
        code = args.function(args)
        if args.content is not None:
            say(json.dumps(plain(args.content)))
        return code
    except MvSlapseError as error:
        return _fail(args, str(error), error.exit_code)
    except KeyboardInterrupt:
        return _fail(args, 'interrupted', INTERRUPTED)
    except BrokenPipeError:
        sys.stderr.close()  # whoever read our output has gone; there is nobody to tell
        return 0
    except Exception as error:
        if args.debug:
            raise
        return _fail(args, f'this is a fault of mv_slapse: {type(error).__name__}: {error}; run '
                     'again with --debug and report what it prints', FAULT)


def _parsed(made: argparse.ArgumentParser, arguments: list[str]) -> argparse.Namespace:
    """Return what the arguments say; ``content`` is the object to print at the end, if any."""
    try:
        return made.parse_args(arguments, argparse.Namespace(content=None))
    except SystemExit as end:
        if end.code and '--json' in arguments:
            _say_failure('wrong usage, as standard error says', end.code)
        raise


def parser() -> argparse.ArgumentParser:
    """Return the parser of all commands."""
    top = argparse.ArgumentParser(
        prog='mv_slapse', description='Pose, planes and moving obstacles from the motion vectors '
        'of encoded video.')
    top.add_argument('--version', action=_Version, help='print the version and exit')
    commands = top.add_subparsers(dest='command', required=True, metavar='COMMAND')
    for add in (_add_run, _add_batch, _add_eval, _add_inspect, _add_bag, _add_demo, _add_doctor):
        command = add(commands)
        command.add_argument('--debug', action='store_true', help='show where an error arose')
    return top


class _Version(argparse.Action):
    """Print the version when it is asked for: looking it up takes a while."""

    def __init__(self, option_strings: Sequence[str], dest: str, help: str):
        """Take no value."""
        super().__init__(option_strings, dest, nargs=0, help=help)

    def __call__(self, parser: argparse.ArgumentParser, *_: Any):
        """Print and end."""
        from importlib.metadata import PackageNotFoundError, version
        try:
            parser.exit(message=f'mv_slapse {version("mv_slapse")}\n')
        except PackageNotFoundError:
            parser.exit(1, 'mv_slapse is not installed; its version is not known\n')


def _add_run(commands: Any) -> argparse.ArgumentParser:
    command = commands.add_parser('run', help='process a video and write the folder of results')
    command.set_defaults(function=_run)
    command.add_argument('input', metavar='INPUT',
                         help='video file, URL (rtsp, udp, http ...), folder of pictures, or bag '
                         'with a video topic')
    command.add_argument('--camera', metavar='YAML',
                         help='camera_info file; a bag may bring its own calibration')
    command.add_argument('--camera-height', type=_height, metavar='M',
                         help='height of the camera above the ground; makes the scale metric')
    command.add_argument('--speed', metavar='CSV|TOPIC',
                         help='speed of the vehicle, which makes the scale metric: table of stamp '
                         '[s] and speed [m/s], or topic of wheel odometry in the bag')
    command.add_argument('-o', '--output', type=_folder, default='out', metavar='OUT',
                         help='folder of the results (default: %(default)s)')
    command.add_argument('--map', metavar='JSON',
                         help='map.json of an earlier run: give the results in its frame, where '
                         'its planes are found again')
    command.add_argument('--topic', help='video topic of a bag that has several')
    command.add_argument('--max-frames', type=_count, metavar='N', help='stop after N pictures')
    command.add_argument('--overlay', metavar='MP4',
                         help='also write a video with coloured blocks and obstacles')
    command.add_argument('--no-report', action='store_true', help='leave report.html out')
    command.add_argument('--packets', action='store_true',
                         help='put the packets of the video into results.mcap, too: a bag that '
                         'can be run and played again')
    _add_settings(command)
    _add_output_style(command)
    return command


def _add_batch(commands: Any) -> argparse.ArgumentParser:
    command = commands.add_parser('batch', help='run many recordings, here or on a Dask cluster')
    command.set_defaults(function=_batch)
    command.add_argument('input', metavar='INPUT', nargs='+',
                         help='video, bag, folder of these, pattern, or table (CSV: input, '
                         'camera, camera_height, speed, ground_truth, ...), a row for each run')
    command.add_argument('--camera', metavar='YAML',
                         help='camera_info file of all that name none; bags may bring their own')
    command.add_argument('--camera-height', type=_height, metavar='M',
                         help='height of the camera above the ground; makes the scale metric')
    command.add_argument('--speed', metavar='TOPIC', help='topic of wheel odometry in the bags')
    command.add_argument('-o', '--output', type=_folder, default='out', metavar='OUT',
                         help='folder of the runs, a folder each (default: %(default)s)')
    command.add_argument('--topic', help='video topic of bags that have several')
    command.add_argument('--max-frames', type=_count, metavar='N',
                         help='stop each after N pictures')
    command.add_argument('--no-report', action='store_true',
                         help='leave the report.html of each run out')
    _add_settings(command)
    command.add_argument('--sweep', action='append', default=[], metavar='SECTION.NAME=V1,V2',
                         help='run each recording with each value; several multiply')
    command.add_argument('--workers', type=_count, metavar='N',
                         help='processes of this machine (default: one a core)')
    command.add_argument('--memory-limit', metavar='SIZE',
                         help='of each process, such as 2GiB (default: an equal share)')
    command.add_argument('--scheduler', metavar='ADDRESS',
                         help='running Dask scheduler, such as tcp://host:8786, in place of '
                         'processes of this machine')
    _add_output_style(command)
    return command


def _add_eval(commands: Any) -> argparse.ArgumentParser:
    command = commands.add_parser('eval', help='compare results with the truth')
    command.set_defaults(function=_eval)
    command.add_argument('results', metavar='OUT', help='folder of results')
    command.add_argument('--ground-truth', metavar='TRUTH',
                         help='trajectory (TUM), or folder as the simulator writes it')
    command.add_argument('--labels', metavar='NPZ', help='labelled points (motion_labels.npz)')
    command.add_argument('--boxes', metavar='CSV', help='boxes of one obstacle (boxes.csv)')
    command.add_argument('--annotation', metavar='JSON',
                         help='vehicles in the last frame (annotation.json)')
    command.add_argument('--fps', type=_rate, metavar='HZ',
                         help='rate of the frames in --labels and --boxes')
    command.add_argument('--camera-height', type=_height, default=0.0, metavar='M',
                         help='above the ground: metres for a run of free scale')
    command.add_argument('--stamp-offset', type=_offset, default=0.0, metavar='S',
                         help="taken off the results' stamps first (default: 0)")
    command.add_argument('--plot', metavar='PNG',
                         help='draw the way over the true one, and the error over time')
    command.add_argument('--json', action='store_true', help='print one JSON object')
    return command


def _add_inspect(commands: Any) -> argparse.ArgumentParser:
    command = commands.add_parser('inspect', help='tell whether a video can be used')
    command.set_defaults(function=_inspect, camera_height=None)
    command.add_argument('input', metavar='INPUT',
                         help='video file, URL, folder of pictures or bag')
    command.add_argument('--topic', help='video topic of a bag that has several')
    command.add_argument('--max-frames', type=_count, default=300, metavar='N',
                         help='look at N pictures (default: %(default)s)')
    _add_settings(command)
    command.add_argument('--json', action='store_true', help='print one JSON object')
    return command


def _add_bag(commands: Any) -> argparse.ArgumentParser:
    command = commands.add_parser('bag', help='make a rosbag2 MCAP of a video')
    command.set_defaults(function=_bag)
    command.add_argument('input', metavar='VIDEO', help='video file')
    command.add_argument('--camera', required=True, metavar='YAML', help='camera_info file')
    command.add_argument('--ground-truth', metavar='TUM', help='true trajectory')
    command.add_argument('-o', '--output', type=_folder, required=True, metavar='BAG',
                         help='folder to make')
    command.add_argument('--start', type=_start, default=1.0, metavar='S',
                         help='stamp of the first picture (default: 1, as 0 is no time to ROS)')
    command.add_argument('--max-frames', type=_count, metavar='N', help='stop after N pictures')
    command.add_argument('--json', action='store_true', help='print one JSON object')
    return command


def _add_demo(commands: Any) -> argparse.ArgumentParser:
    command = commands.add_parser('demo', help='render a street, run everything, write a report')
    command.set_defaults(function=_demo)
    command.add_argument('-o', '--output', type=_folder, default='out/demo',
                         metavar='OUT', help='folder of the results (default: %(default)s)')
    command.add_argument('--seed', type=int, default=0, help='of the street (default: 0)')
    command.add_argument('--quick', action='store_true', help='a shorter street')
    _add_output_style(command)
    return command


def _add_doctor(commands: Any) -> argparse.ArgumentParser:
    command = commands.add_parser('doctor', help='tell whether this installation can run')
    command.set_defaults(function=_doctor)
    return command


def _add_settings(command: argparse.ArgumentParser):
    command.add_argument('--settings', metavar='YAML', help='file of settings')
    command.add_argument('--set', action='append', default=[], metavar='SECTION.NAME=VALUE',
                         help='change a setting; may be repeated')


def _add_output_style(command: argparse.ArgumentParser):
    command.add_argument('--quiet', action='store_true', help='print nothing but errors')
    command.add_argument('--json', action='store_true', help='print one JSON object')


def _run(args: argparse.Namespace) -> int:
    from mv_slapse.heap import give_back_large_blocks
    from mv_slapse.storage.camera_info import read_camera
    from mv_slapse.tools import run, run_summary
    from mv_slapse.tools.history import History
    from mv_slapse.tools.inputs import read_speeds
    from mv_slapse.tools.progress import progress_bar
    give_back_large_blocks()
    settings = _settings(args)
    if args.overlay:
        from mv_slapse.tools import overlay
        overlay.check(args.overlay, args.input)
    camera = read_camera(args.camera) if args.camera else None
    speeds, warnings = read_speeds(args.speed, args.input) if args.speed else ([], [])
    signal.signal(signal.SIGTERM, signal.default_int_handler)  # ends like Ctrl-C: files closed
    history = History()
    with ExitStack() as held:
        options = run.Options(args.max_frames, args.topic, args.command_line, speeds, history,
                              args.map, args.packets, warnings,
                              (args.camera, args.speed, args.settings), held)
        with progress_bar(args.quiet or args.json) as progress:
            summary = run.run(args.input, camera, settings, args.output, options, progress)
        _print(args, summary.to_dict(), run_summary.text(summary, args.output))
        if not args.no_report:
            from mv_slapse.tools import run_report
            run_report.write(args.output, summary.to_dict(), history)
        if args.overlay and not summary.interrupted:
            overlay.write(args.overlay, args.input, args.output, args.topic, settings.encoder)
    if summary.interrupted:
        return INTERRUPTED
    if summary.is_lost:
        sys.stderr.write(f'mv_slapse: {run_summary.lost_message(summary)}\n')
        return LOST
    return 0


def _batch(args: argparse.Namespace) -> int:
    from mv_slapse.tools import batch_command
    return batch_command.main(args, _settings(args))


def _eval(args: argparse.Namespace) -> int:
    from mv_slapse.tools import eval as evaluation
    marks = evaluation.Marks(args.labels, args.boxes, args.annotation, args.fps,
                             args.camera_height)
    figures = evaluation.evaluate(args.results, args.ground_truth, marks, args.stamp_offset)
    _print(args, figures, evaluation.text(figures))
    if args.plot:
        evaluation.plot(args.plot, args.results, args.ground_truth, args.stamp_offset)
    return 0


def _inspect(args: argparse.Namespace) -> int:
    from mv_slapse.tools import inspect
    report = inspect.inspect(args.input, args.topic, args.max_frames,
                             _settings(args).encoder)
    _print(args, report, inspect.text(report))
    return 0 if inspect.is_usable(report) else 3


def _bag(args: argparse.Namespace) -> int:
    from dataclasses import asdict

    from mv_slapse.storage.camera_info import read_camera
    from mv_slapse.storage.tum import read_trajectory
    from mv_slapse.tools.bag import make_bag
    truth = read_trajectory(args.ground_truth) if args.ground_truth else None
    content = make_bag(args.input, read_camera(args.camera), truth, args.output,
                       round(args.start * 1e9), args.max_frames)
    _print(args, asdict(content),
           f'{content.path}: {content.packets} packets, {content.camera_infos} camera_info, '
           f'{content.true_poses} true poses, from {args.start:g} s on (eval: --stamp-offset '
           f'{args.start:g})\nplay it with: ros2 bag play {content.path} --clock')
    return 0


def _demo(args: argparse.Namespace) -> int:
    from mv_slapse.tools import demo
    return demo.main(args)


def _doctor(args: argparse.Namespace) -> int:
    from mv_slapse.tools import doctor
    return doctor.main([])


def _settings(args: argparse.Namespace) -> Any:
    from mv_slapse.config import Settings
    from mv_slapse.tools import settings_arguments
    settings = Settings()
    if args.settings:
        settings = settings_arguments.read_settings(args.settings, settings)
    if args.camera_height is not None:
        settings = settings_arguments.change(settings, 'scene.camera_height', args.camera_height)
    return settings_arguments.override(settings, args.set)


def _print(args: argparse.Namespace, content: dict[str, Any], text: str):
    if args.json:
        args.content = content  # printed at the end: what follows may fail
    elif not getattr(args, 'quiet', False):
        say(text)


def _fail(args: argparse.Namespace, message: str, code: int) -> int:
    sys.stderr.write(f'mv_slapse {args.command}: {message}\n')
    if getattr(args, 'json', False):
        _say_failure(message, code)
    return code


def _say_failure(message: str, code: int):
    with suppress(OSError, MvSlapseError):  # standard error and the exit code tell it, too
        say(json.dumps({'error': message, 'exit_code': code}))


def _count(text: str) -> int:
    value = int(text) if text.isdecimal() and len(text) < 100 else 0
    if not 1 <= value <= MOST:
        raise argparse.ArgumentTypeError(f'{text[:40]!r} is not a whole number from 1 to {MOST}')
    return value


def _start(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = -1.0
    if not 0 <= value <= LAST_START:
        raise argparse.ArgumentTypeError(f'{text!r} is not a time in seconds from 0 to '
                                         f'{LAST_START}, as ROS counts them')
    return value


def _folder(text: str) -> str:
    if not text:
        raise argparse.ArgumentTypeError('the name is empty; give a folder (. is this one), and '
                                         'look whether a variable of the shell is not set')
    return text


def _within(low: float, high: float, what: str, text: str) -> float:
    """Return a number between two bounds; what else there should be stands in the error."""
    try:
        value = float(text)
    except ValueError:
        value = low
    if not low < value < high:
        raise argparse.ArgumentTypeError(f'{text!r} is not {what}')
    return value


_height = partial(_within, 0.0, 1e3, 'a height in metres above 0')
_rate = partial(_within, 0.0, 1e6, 'a rate in Hz above 0')
_offset = partial(_within, -1e10, 1e10, 'a time in seconds, of less than 300 years')


if __name__ == '__main__':
    sys.exit(main())
