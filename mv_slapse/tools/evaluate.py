"""``make evaluate``: every sequence in every encoding and what is rendered, as a page and rows.

Sequences are read where they lie, ``../shared/data`` beside the checkout; rendered streets need
nothing. The page names the commit and the commands, so that anybody can repeat a row. A run that
was interrupted goes on where it ended.
"""

import argparse
from collections.abc import Callable
from pathlib import Path
import subprocess  # to ask git for the commit  # nosec B404
import sys
from typing import Any

from mv_slapse.tools import cases
from mv_slapse.tools.altered import altered
from mv_slapse.tools.batch.workers import Workers
from mv_slapse.tools.cases import Scene
from mv_slapse.tools.results_page import page, rows_as_csv
from mv_slapse.tools.rows import Cache, Figures, measure_all, state_of_code

DATA = Path('../shared/data')
CACHE = Path('out/cache')
STREETS = 5
STREET_FRAMES = 150
HAZARDS = 1
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

PLANNER_COLUMNS = {
    'hazards': ('hazards', '{:d}'), 'in time': ('hazards_in_time', '{:d}'),
    'missed': ('hazards_missed', '{:d}'),
    'contact when confirmed [s]': ('contact_at_confirmation_s', '{:.1f}'),
    'others': ('others', '{:d}'), 'others in time': ('others_in_time', '{:d}'),
    'false braking': ('false_braking_frames', '{:d}'), 'key frames': ('frames_judged', '{:d}')}


def row(name: str, figures: dict[str, Any], columns: dict[str, tuple[str, str]] = COLUMNS) -> str:
    """Return one row of a table."""
    if 'error' in figures:
        return f'| {name} | {figures["error"]} |' + ' |' * (len(columns) - 1)
    cells = [pattern.format(figures[key]) if figures.get(key) is not None else ''
             for key, pattern in columns.values()]
    return f'| {name} | ' + ' | '.join(cells) + ' |'


def commit_of(folder: Path) -> str:
    """Return the commit that is checked out, with a + where files differ from it."""
    answer = subprocess.run(['git', 'describe', '--always', '--dirty=+'], cwd=folder, check=False,
                            capture_output=True, text=True)  # fixed words  # nosec B603 B607
    return answer.stdout.strip() or 'unknown'


def all_scenes(options: argparse.Namespace) -> list[Scene]:
    """Return what is measured, in the order of the page."""
    data, found = options.data.resolve(), []
    if data.is_dir():
        found = [*cases.given(data), *cases.cameraless(data), *cases.recoded(data),
                 *cases.lossy(data), *altered(data)]
    first = options.first_seed
    found += [*cases.streets(options.streets, options.frames, first),
              *cases.references(options.streets, options.frames, first), *cases.drives(first),
              *cases.hazards(options.hazards, first), *cases.flights(first)]
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
    print(row(name, figures) + row('', figures, OBSTACLE_COLUMNS)[3:]
          + row('', figures, PLANNER_COLUMNS)[3:], file=sys.stderr, flush=True)


def add_options(parser: argparse.ArgumentParser):
    """Add what is measured, where it is cached, and in how many processes."""
    parser.add_argument('--data', type=Path, default=DATA, help='folder of the sequences')
    parser.add_argument('--only', default='', help='only rows whose name holds this')
    parser.add_argument('--streets', type=int, default=STREETS, help='rendered streets')
    parser.add_argument('--hazards', type=int, default=HAZARDS,
                        help='rendered drives toward each kind of hazard')
    parser.add_argument('--first-seed', type=int, default=0, metavar='SEED',
                        help='first random seed of rendered scenes: of scenes that nobody has '
                        'looked at (default: 0, those of docs/results.md)')
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
    options.output.write_text(page(measured, commit_of(Path.cwd()), options.first_seed))
    options.output.with_suffix('.csv').write_text(rows_as_csv(measured))
    return 0


if __name__ == '__main__':
    sys.exit(main())
