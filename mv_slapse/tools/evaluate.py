"""``make evaluate``: every sequence in every encoding and what is rendered, in two tables.

Sequences are read where they lie, ``../shared/data`` beside the checkout; rendered streets need
nothing. The page names the commit and the commands, so that anybody can repeat a row. A run that
was interrupted goes on where it ended.
"""

import argparse
from collections.abc import Callable
from pathlib import Path
import subprocess
import sys
from typing import Any

from mv_slapse.batch.workers import Workers
from mv_slapse.tools import cases
from mv_slapse.tools.altered import altered
from mv_slapse.tools.cases import Scene
from mv_slapse.tools.rows import Cache, Figures, measure_all, state_of_code

DATA = Path('../shared/data')
CACHE = Path('out/cache')
STREETS = 5
STREET_FRAMES = 150
COLUMNS = {
    'poses': ('n_poses', '{:d}'), 'ATE [%]': ('ate_mean_percent', '{:.3f}'),
    'rigid [%]': ('ate_rigid_mean_percent', '{:.3f}'),
    'ε_D [%]': ('epsilon_d_percent', '{:.2f}'), 'step': ('unexplained_step', '{:.3f}'),
    'covered [%]': ('position_covered_percent', '{:.0f}'), 'NEES': ('pose_nees', '{:.1f}'),
    'standstill [m]': ('standstill_drift_m', '{:.3f}'),
    'planes': ('n_planes', '{:d}'), 'depth [m]': ('plane_depth_error_m', '{:.2f}'),
    'normal [deg]': ('plane_normal_error_deg', '{:.1f}'),
    'on one [%]': ('plane_observations_on_one_plane_percent', '{:.0f}'),
    'called moving': ('movers_found', '{:d}'), 'of': ('movers_total', '{:d}'),
    'still so [%]': ('stationary_called_moving_percent', '{:.2f}'),
    'CPU [ms]': ('cpu_ms', '{:.1f}')}
OBSTACLE_COLUMNS = {
    'in time': ('movers_confirmed_in_time', '{:d}'), 'of': ('movers_due', '{:d}'),
    'position [%]': ('obstacle_position_error_percent', '{:.1f}'),
    'velocity [m/s]': ('obstacle_velocity_error_m_s', '{:.2f}'),
    'contact [%]': ('obstacle_ttc_error_percent', '{:.1f}'),
    'relabelled': ('relabelled_in_time', '{:d}'), 'of ': ('relabels', '{:d}'),
    'id switches': ('identity_switches', '{:d}'), 'NEES': ('obstacle_nees', '{:.1f}'),
    'false / frame': ('false_obstacles_per_frame', '{:.3f}'),
    'confirmed / frame': ('confirmed_obstacles_per_frame', '{:.3f}'),
    'boxes met [%]': ('boxes_met_percent', '{:.0f}'),
    'annotated, met': ('annotated_vehicles_met', '{:d}'),
    'its position [%]': ('annotated_position_error_percent', '{:.1f}'),
    'its velocity [m/s]': ('annotated_velocity_error_m_s', '{:.2f}')}


def row(name: str, figures: dict[str, Any], columns: dict[str, tuple[str, str]] = COLUMNS) -> str:
    """Return one row of a table."""
    if 'error' in figures:
        return f'| {name} | {figures["error"]} |' + ' |' * (len(columns) - 1)
    cells = [pattern.format(figures[key]) if figures.get(key) is not None else ''
             for key, pattern in columns.values()]
    return f'| {name} | ' + ' | '.join(cells) + ' |'


def page(measured: dict[str, dict[str, Any]], commit: str) -> str:
    """Return the whole page, given the figures of each row."""
    seen = {name: figures for name, figures in measured.items()
            if any(figures.get(key) is not None for key, _ in OBSTACLE_COLUMNS.values())}
    return (
        '# Results\n\n'
        f'Made by `make evaluate` at commit {commit}, default settings, '
        '`--camera-height` where the data set tells it.\n'
        'A row is `mv_slapse run VIDEO --camera camera.yaml [--camera-height H] -o OUT`, then '
        '`mv_slapse eval OUT --ground-truth …`.\n'
        'ATE: mean position error after similarity alignment, rigid: after rigid alignment, in '
        'per cent of the way; ε_D: mean error of the way from the first pose as a share of it, '
        'without alignment, as in table II of [SLAPSE]; step: longest between two poses, less '
        'what twist and covariances explain [map unit]; covered: positions within 3 sigma of the '
        'true ones; NEES: of poses, 6 if the covariances are right, where the truth is exact; '
        'standstill: farthest from where it stopped; planes: true ones that were found; on one: '
        'observations of planes four fifths of whose macroblocks lie on one true plane; still so:'
        ' stationary points or blocks called moving; mirrored, cut: the same clips with other '
        'vectors; CPU: of all stages, for each frame of the video. Speed given: `--speed` with a '
        'speed drawn from the truth, 1 % noise, in place of the height; free scale: neither.\n\n'
        f'{_table(measured, COLUMNS)}\n'
        '## Moving obstacles\n\n'
        'In time: passages of movers of at least 6 macroblocks met by a confirmed obstacle '
        'within 0.5 s. Position (of the range), velocity and time to contact: median errors. '
        'Relabelled: cars that became an obstacle within 1 s of starting, or ceased to be one '
        'within 1 s of stopping. NEES: of position and velocity, 6 if the covariances are '
        'right.\nFalse, confirmed: rows of confirmed obstacles that meet no mover, and all, for '
        'each key frame. Boxes met: key frames in which the annotated box meets an obstacle.\n\n'
        f'{_table(seen, OBSTACLE_COLUMNS)}')


def _table(measured: dict[str, dict[str, Any]], columns: dict[str, tuple[str, str]]) -> str:
    head = f'| sequence | {" | ".join(columns)} |\n|' + ' --- |' * (len(columns) + 1)
    rows = [row(name, figures, columns) for name, figures in measured.items()]
    return '\n'.join([head, *rows]) + '\n'


def commit_of(folder: Path) -> str:
    """Return the commit that is checked out, with a + where files differ from it."""
    answer = subprocess.run(['git', 'describe', '--always', '--dirty=+'], cwd=folder, check=False,
                            capture_output=True, text=True)
    return answer.stdout.strip() or 'unknown'


def all_scenes(options: argparse.Namespace) -> list[Scene]:
    """Return what is measured, in the order of the page."""
    data, found = options.data.resolve(), []
    if data.is_dir():
        found = [*cases.given(data), *cases.cameraless(data), *cases.recoded(data),
                 *cases.lossy(data), *altered(data)]
    found += [*cases.streets(options.streets, options.frames), *cases.drives(), *cases.flights()]
    return found


def cache_of(options: argparse.Namespace) -> Cache:
    """Return the cache folder, for the code as it is."""
    return Cache(options.cache.resolve(), state_of_code(), options.only)


def workers_of(options: argparse.Namespace,
               change: Callable[[], None] | None = None) -> Workers:
    """Return the processes that the options ask for, each after a change of its own."""
    return Workers(options.jobs, options.nice, change, scheduler=options.scheduler)


def tell(name: str, figures: Figures):
    """Print the figures of a row."""
    print(row(name, figures) + row('', figures, OBSTACLE_COLUMNS)[3:], file=sys.stderr, flush=True)


def add_options(parser: argparse.ArgumentParser):
    """Add what is measured, where it is cached, and in how many processes."""
    parser.add_argument('--data', type=Path, default=DATA, help='folder of the sequences')
    parser.add_argument('--only', default='', help='only rows whose name holds this')
    parser.add_argument('--streets', type=int, default=STREETS, help='rendered streets')
    parser.add_argument('--frames', type=int, default=STREET_FRAMES, help='pictures of a street')
    parser.add_argument('--cache', type=Path, default=CACHE,
                        help='folder of what is rendered, encoded, decoded and measured; what is '
                             'there is not made again (default: %(default)s)')
    parser.add_argument('--jobs', type=int, default=0, help='processes (default: one a core)')
    parser.add_argument('--nice', type=int, default=0, help='added to their niceness')
    parser.add_argument('--scheduler', default='', metavar='ADDRESS',
                        help='running Dask scheduler in place of these processes; its workers see '
                             'data and cache under the same names')


def main(arguments: list[str] | None = None) -> int:
    """Measure everything and write the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    add_options(parser)
    parser.add_argument('-o', '--output', type=Path, default=Path('docs/results.md'))
    options = parser.parse_args(arguments)
    measured = measure_all(all_scenes(options), cache_of(options), workers_of(options), tell)
    options.output.parent.mkdir(parents=True, exist_ok=True)
    options.output.write_text(page(measured, commit_of(Path.cwd())))
    return 0


if __name__ == '__main__':
    sys.exit(main())
