"""``mv_slapse demo``: a street with known truth, rendered, encoded, run, scored and drawn."""

import argparse
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
import json
from pathlib import Path
import sys
from typing import Any

from mv_slapse.codec.encoding.encoder import Encoding, write_video
from mv_slapse.config import SceneSettings, Settings
from mv_slapse.simulation.street import Street, StreetSettings
from mv_slapse.simulation.truth import film
from mv_slapse.storage.camera_info import write_camera
from mv_slapse.tools import eval as evaluation
from mv_slapse.tools import report
from mv_slapse.tools.plain import plain
from mv_slapse.tools.progress import progress_bar
from mv_slapse.tools.run import Options
from mv_slapse.tools.run import run as run_video
from mv_slapse.tools.run_summary import lost_message, Summary
from mv_slapse.tools.terminal import say
import numpy as np

LOST = 4
N_FRAMES, N_FRAMES_QUICK = 165, 60
ENCODING = Encoding('mpeg2video', b_frames=3, gop=12)   # the papers' codec

Progress = Callable[[int, int], None]


@dataclass(frozen=True)
class Demo:
    """What the demo gave.

    Attributes
    ----------
    output : Path
        Folder of the results; report.html and demo.png lie there as well.
    figures : dict
        As ``eval`` reports them.
    summary : Summary
    """

    output: Path
    figures: dict[str, Any]
    summary: Summary


def main(args: argparse.Namespace) -> int:
    """Run the demo as the command line asks and return the exit code."""
    with progress_bar(args.quiet or args.json) as progress:
        demo = run(Path(args.output), args.seed, args.quick, progress)
    if args.json:
        say(json.dumps(plain(demo.figures)))
    elif not args.quiet:
        say(text(demo))
    if demo.summary.is_lost:
        sys.stderr.write(f'mv_slapse: {lost_message(demo.summary)}\n')
    return LOST if demo.summary.is_lost else 0


def run(output: Path, seed: int = 0, quick: bool = False, progress: Progress | None = None,
        settings: StreetSettings | None = None) -> Demo:
    """Render a street into a folder, process its video there, score it and write the report.

    Parameters
    ----------
    output : Path
        Gets the files of a run, ``truth/``, ``video.mpg``, ``camera.yaml``, ``report.html``.
    seed : int
        Of the street.
    quick : bool
        A shorter street.
    progress : function of (pictures done, pictures in all), or None
    settings : StreetSettings or None
        Another street than the usual one; its seed and length are replaced.
    """
    n_frames = N_FRAMES_QUICK if quick else N_FRAMES
    street = Street(replace(settings or StreetSettings(), seed=seed, n_frames=n_frames))
    camera_file, video = output / 'camera.yaml', output / 'video.mpg'
    output.mkdir(parents=True, exist_ok=True)
    write_camera(camera_file, street.camera)
    kept: dict[int, np.ndarray] = {}
    images = _kept(film(street, output / 'truth'), kept)
    write_video(video, _reported(images, 2 * n_frames, progress), street.settings.fps, ENCODING)
    chosen = Settings(scene=SceneSettings(camera_height=street.settings.camera_height))
    command = f'mv_slapse demo -o {output} --seed {seed}' + ' --quick' * quick
    summary = run_video(video, street.camera, chosen, output, Options(command=command),
                        progress=_second_half(n_frames, progress))
    figures = evaluation.evaluate(output, output / 'truth')
    stamped = {street.stamp(i): image for i, image in kept.items()}
    report.write(output, output / 'truth', figures, summary.to_dict(), stamped)
    return Demo(output, figures, summary)


def text(demo: Demo) -> str:
    """Return what the demo reports on the terminal."""
    cells = [('', 'result', 'meaning'), *report.table(demo.figures, demo.summary.to_dict())]
    widths = [max(len(row[k]) for row in cells) for k in range(2)]
    lines = [f'{name:{widths[0]}}  {value:>{widths[1]}}  {meaning}'
             for name, value, meaning in cells]
    return '\n'.join([*lines, '', f'report: {demo.output / report.REPORT}, picture: '
                      f'{demo.output / report.PICTURE}, messages: {demo.output}/results.mcap'])


def _kept(images: Iterable[np.ndarray], kept: dict[int, np.ndarray]) -> Iterator[np.ndarray]:
    """Pass pictures on and keep those that become key frames."""
    for i, image in enumerate(images):
        if i % (ENCODING.b_frames + 1) == 0:
            kept[i] = image
        yield image


def _reported(images: Iterable[np.ndarray], total: int,
              progress: Progress | None) -> Iterator[np.ndarray]:
    for i, image in enumerate(images):
        if progress:
            progress(i + 1, total)
        yield image


def _second_half(n_frames: int, progress: Progress | None) -> Progress | None:
    if progress is None:
        return None
    return lambda done, _: progress(n_frames + done, 2 * n_frames)
