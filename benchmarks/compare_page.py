"""The page of ``compare.py`` and its two pictures."""

from collections.abc import Callable, Iterable, Sequence
from hashlib import sha256
import json
from pathlib import Path
from typing import Any

from matplotlib import rc_context
from matplotlib.figure import Figure
from mv_slapse.storage.whole_files import whole
from mv_slapse.tools.plain import plain
import numpy as np
from speed import machine

Row = dict[str, Any]
COLOURS = {'ours': '#0072b2', 'SLAPSE': '#e69f00', 'MVO': '#d55e00', '1-point EKF': '#009e73',
           'LK': '#cc79a7', 'ORB': '#8c6d31'}
SHOWN = ('kitti00', 'parking', 'street 0', 'street 1')  # whose ways are drawn
ABOUT_WAYS = """\
Without a height or a speed all but LK and ORB have a free scale. Mean position error after
similarity alignment in percent of the way, in brackets the greatest ([MVO], table 1).
"""
ABOUT_EPSILON = """\
ε_D, mean relative error of the place without alignment ([SLAPSE], table II) [%]. The unit is the
first step, as there, or the metre for LK and ORB, which are told the length of each step. In
brackets it is such that half of the distances from the start are too long: the EKF begins at rest
and has no first step, and the record of `kitti00` begins with a speed that is wrong by a quarter
(docs/figures.md), which the first step as unit makes an error of all that follows, unless the
scale drifts by as much.
"""
ABOUT_CPU = """\
CPU time of a frame of the video [ms], decoding included, one thread; poses and pictures; share
of the time that lies between the first pose and the last. The printed pipelines and the EKF are
numpy, the package, LK and ORB compiled.
"""
PUBLISHED = (
    ('[SLAPSE], own videos of 42 and 38 m', 'ε_D 2.9 and 5.1 %; planes 0.61 and 0.65 m, 7.07 and '
     '3.26 deg; true positives 91.1 % at ε_h = 1 px'),
    ('[MVO], Málaga, 201 and 134 m', 'ATE 1.43 (3.15) and 2.53 (3.73) %; planes 0.55 m, 6.80 deg; '
     '85 of 88 movers'),
    ('1-point EKF by [MVO], Málaga', 'ATE 0.99 (1.83) and 6.80 (9.20) %'),
    ('direct sparse odometry, its own program, measured here', '`kitti00` 0.72 %, 66 ms a frame; '
     '`parking` 0.09 %'),
    ('an ORB SLAM, its own program, measured here', '`kitti00` 0.14 % on 30 % of the frames, '
     '41 ms a frame; `parking` 0.06 % on 66 % of the frames'))
NOTES = """\
What we suppose where a baseline does worse here than it was published, or than it could:

* **Printed pipelines.** Ways and planes are as good as published or better, but for [SLAPSE] on
  `kitti00` and `street 3`: the length of the way is carried by planes of the last pair alone, and
  a homography of a moving car counts as one of the scene. Three things that the print leaves open
  matter: which of a block's vectors are right is told as the package does it; a homography must
  be that of a plane under the pair's motion to enter a filter; and [MVO]'s filter gives a plane
  up that is not where it expects it ("verify", section 5; without it `kitti00` errs by 8 %).
* **True positives** are fewer than the 91 % of [SLAPSE]: inliers of a homography come from the
  whole picture, and here four fifths of them must lie on one surface, where the authors looked at
  the picture; they also took two planes of a pair at ε_h = 1 px, not four.
* **Movers** are fewer than [MVO]'s 85 of 88: clips of 10 pictures a second instead of 23 to 30 and
  cars of less than 20 macroblocks have no plane of their own; a slower or oncoming car that fills
  its epipolar lines bends the line that is fitted to them, and a plane of the scene takes its
  blocks in.
* **1-point EKF.** It begins with a velocity of zero and depths of which nothing is known: the
  first ten pictures err two to four times as much as the mean; without the first twenty the error
  is 1.5 % on `kitti00` and 0.8 to 1.1 % elsewhere. At 10 pictures a second and 7 m/s (`kitti00`)
  points live for a few pictures, each new one has the usual depth of the others until it is known
  better, and the scale drifts. The state is kept in {W}; one about the camera is linearised
  better on long ways. 120 points instead of 80 take 2.6 times as long and bring 1.85 instead of
  2.00 % on `kitti00`.
* **LK and ORB** have no map: each step errs by itself. One wrong essential matrix turns all that
  follows (ORB on `kitti00` at 20 m; `parking` is walls, and one plane allows two motions). They
  are told the length of each step, which nobody has; without it they have no scale at all.
"""
ABOUT_PLANES = """\
Stationary planes of the rendered streets, (17) of [MVO]. As in the papers, where somebody said
which planes of the scene were found, errors are those of true planes, seen as such in more than
three key frames; on one: share of all observations of planes whose macroblocks lie, four fifths
of them, on one true plane.
"""
ABOUT_SWEEP = """\
Table I of [SLAPSE] on the same streets: homographies extracted from each pair by itself, at least
20 macroblocks and four planes. A true positive has four fifths of its macroblocks on one true
surface, counted for the planes of the package alike, over all its key frames.
"""
ABOUT_MOVERS = """\
A mover is found where half of its macroblocks, or labelled points, are called moving in half of
the key frames in which it covers six macroblocks or more. [MVO] counts a vehicle that is found
once, and reports 85 of 88; false positives it does not report. Definition 1 judges blocks,
Definition 2 planes by the vote of their blocks. What is still: macroblocks of the streets,
labelled points of the clips. SLAPSE, the EKF and the odometries tell nothing of movers.
"""
ABOUT_OBSTACLES = """\
What the filters of single obstacles, (14)-(16) of [MVO] and the package's, make of them on the
rendered streets. [MVO] reports no such figures. In time: within half a second of covering six
macroblocks. Errors are medians over all key frames in which an obstacle meets a mover, in the mean
of the streets: of the place in percent of its distance, of the velocity, of the time to contact.
Told: somebody says which macroblocks show which mover, so that the filter is judged and not its
input. The place is where the ray of the middle of its blocks meets its plane.
"""
ABOUT_FILTER = """\
By itself [MVO] follows none: most planes that it calls moving are parts of facades and road, and
those whose velocity comes close to zero it hands to the scene. Told which blocks move, its filter
gives speeds that are nearly right, and places that are not: ten blocks do not tell the tilt of
their plane, on which the depth of their middle hangs (Obstacle filter, below).
"""
ABOUT_DEPARTURES = """\
What the printed step gives, and what the package has in its place; why is in
[papers.md](papers.md). Drawn scenes have no pictures, only vectors that err by 0.25 px.
"""
NAMED = """\
On `parking` chaining costs accuracy; it halves the number of pairs. Not measured by itself: the
lasting errors of vectors, for which the print has no model; they are in the NEES above, and what
they are worth to the package is in [papers.md](papers.md) and [ablation.md](ablation.md).
"""


def table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """Return a table."""
    return '\n'.join([f'| {" | ".join(head)} |', '|' + ' --- |' * len(head),
                      *(f'| {" | ".join(row)} |' for row in rows)]) + '\n'


class Results:
    """What was found, by tag, in the order of the scenes."""

    def __init__(self, found: dict[tuple, Any]):
        """Take it."""
        self.found = found
        self.ways = [name for name in self._scenes() if self.row(name, 'LK')]
        self.streets = [name for name in self.ways if name.startswith('street')]
        self.clips = [name for name in self._scenes() if name not in self.ways]

    def row(self, scene: str, method: str) -> Row:
        """Return the figures of a scene by a method, empty where there are none."""
        return self.found.get(('row', scene, method), {})

    def methods(self) -> list[str]:
        """Return the methods in the order of the columns."""
        return [name for name in COLOURS if any(self.row(scene, name) for scene in self.ways)]

    def _scenes(self) -> list[str]:
        return sorted({tag[1] for tag in self.found if tag[0] == 'row'})


def by_method(results: Results, cell: Callable[[Row], str], more: Sequence[Sequence[str]] = ()
              ) -> str:
    """Return a table with a row for each way and a column for each method, and more rows."""
    rows = [(f'`{scene}`', *(_cell(results.row(scene, method), cell)
                             for method in results.methods())) for scene in results.ways]
    return table(('', *map(printed_name, results.methods())), [*rows, *more])


def cpu_table(results: Results) -> str:
    """Return CPU times and coverage; of the labelled clips, which have no way, times alone."""
    def of_clips(method: str) -> str:
        rows = [row for name in results.clips if (row := results.row(name, method))]
        return f'{np.mean([row["cpu_ms"] for row in rows]):.0f}' if rows else ''

    more = [(f'labelled clips, {len(results.clips)}', *map(of_clips, results.methods()))]
    return by_method(results, lambda row: f'{row["cpu_ms"]:.0f}; {row["n_poses"]} of '
                     f'{row["n_frames"]}; {row["covered_percent"]:.0f} %',
                     more if results.clips else ())


def fingerprint(found: dict[tuple, Any]) -> str:
    """Return a name of all that was found but for CPU times."""
    figures = {str(tag): {name: value for name, value in row.items() if name != 'cpu_ms'}
               if isinstance(row, dict) else row for tag, row in found.items()}
    return sha256(json.dumps(plain(figures), sort_keys=True).encode()).hexdigest()[:16]


def printed_name(method: str) -> str:
    """Return how a column is called."""
    return f'{method}, printed' if method in ('SLAPSE', 'MVO') else method


def _cell(row: Row, cell: Callable[[Row], str]) -> str:
    return 'lost' if 'error' in row else cell(row) if row else ''


def plane_table(results: Results) -> str:
    """Return table II of [SLAPSE] and table 2 of [MVO]."""
    rows = []
    for scene in results.streets:
        for method in ('ours', 'SLAPSE', 'MVO'):
            row = results.row(scene, method)
            rows.append((f'`{scene}`', printed_name(method), str(row['n_planes']),
                         f'{row["on_one_percent"]:.0f}',
                         _number(row['plane_depth_error_m'], '.2f'),
                         _number(row['plane_normal_error_deg'], '.1f')))
    return table(('', '', 'true planes found', 'on one [%]', 'ε_d [m]', 'ε_n [deg]'), rows)


def sweep_table(results: Results) -> str:
    """Return table I of [SLAPSE]."""
    sums: dict[float, np.ndarray] = {}
    for tag, row in results.found.items():
        if tag[0] == 'sweep':
            sums[tag[2]] = sums.get(tag[2], np.zeros(2)) + (row['planes'], row['true'])
    rows = [(f'printed, ε_h = {h:g} px', f'{n:.0f}', f'{100 * true / max(n, 1):.1f} %')
            for h, (n, true) in sorted(sums.items())]
    ours = [results.row(scene, 'ours') for scene in results.streets]
    n = [row['n_rows'] for row in ours]
    share = np.average([row['on_one_percent'] for row in ours], weights=n)
    return table(('', 'extracted planes', 'true positives'),
                 [*rows, ('ours', str(sum(n)), f'{share:.1f} %')])


def mover_table(results: Results) -> str:
    """Return what is found of movers, and what is wrongly called one."""
    kinds = (('ours', 'ours', ''), ('MVO, Definition 2', 'MVO', ''),
             ('MVO, Definition 1', 'MVO', 'by_block_'))
    rows = []
    for what, names in (('rendered streets', results.streets), ('labelled clips', results.clips)):
        for title, method, prefix in kinds:
            some = [row for name in names if (row := results.row(name, method))]
            found, total, once = (sum(row[f'{prefix}movers_{key}'] for row in some)
                                  for key in ('found', 'total', 'once'))
            still = [row[f'{prefix}stationary_called_moving_percent'] for row in some]
            still = [share for share in still if share is not None]
            if still:
                rows.append((f'{what}, {len(some)}', title, f'{found} of {total}', str(once),
                             f'{np.mean(still):.2f}', f'{max(still):.2f}'))
    return table(('', '', 'movers found', 'once', 'still called moving [%]', 'at worst [%]'), rows)


def obstacle_table(results: Results) -> str:
    """Return how movers are followed."""
    rows = []
    for title, method, prefix in (('ours', 'ours', ''), ('MVO, printed', 'MVO', ''),
                                  ('MVO, printed, told', 'MVO', 'told_')):
        some = [results.row(name, method) for name in results.streets]
        in_time, due, tracked, total = (sum(row.get(f'{prefix}movers_{key}', 0) for row in some)
                                        for key in ('confirmed_in_time', 'due', 'tracked',
                                                    'trackable'))
        false = np.mean([row.get(f'{prefix}false_obstacles_per_frame', np.nan) for row in some])
        rows.append((title, f'{in_time} of {due}', f'{tracked} of {total}',
                     *_obstacle_errors(results, method, prefix), f'{false:.2f}'))
    return table(('', 'in time', 'followed for half of the time', 'place [%]', 'velocity [m/s]',
                  'contact [%]', 'false in a key frame'), rows)


def _obstacle_errors(results: Results, method: str, prefix: str) -> list[str]:
    """Return the mean errors on streets where some mover is followed."""
    some = [row for name in results.streets for row in [results.row(name, method)]
            if row.get(f'{prefix}movers_tracked')]
    cells = []
    for key, pattern in (('position_error_percent', '.0f'), ('velocity_error_m_s', '.2f'),
                         ('ttc_error_percent', '.0f')):
        values = [row[f'{prefix}obstacle_{key}'] for row in some]
        values = [value for value in values if value is not None]
        cells.append(_number(np.mean(values) if values else None, pattern))
    return cells


def departure_table(results: Results) -> str:
    """Return what each departure gives."""
    rows = [(title, *row) for tag in sorted(tag for tag in results.found if tag[0] == 'departure')
            for title in [tag[1]] for row in results.found[tag]]
    rows += _of_rows(results)
    return table(('', 'measured', 'printed', 'ours'), sorted(rows, key=lambda row: row[0]))


def _of_rows(results: Results) -> list[tuple[str, ...]]:
    """Return the departures that the rows above show already."""
    def mean(method: str, key: str, pattern: str) -> str:
        values = [results.row(scene, method).get(key) for scene in results.streets]
        return _number(np.mean([one for one in values if one is not None] or [np.nan]), pattern)

    return [('Stationary planes', 'planes on one true plane [%]; their errors of depth [m] and '
             'normal [deg], rendered streets',
             *(f'{mean(one, "on_one_percent", ".0f")}; {mean(one, "plane_depth_error_m", ".2f")}, '
               f'{mean(one, "plane_normal_error_deg", ".1f")}' for one in ('MVO', 'ours'))),
            ('Scene filter, noise', 'positions within 3 sigma of the true ones [%] and NEES (6 '
             'expected) on rendered streets',
             *(f'{mean(one, "position_covered_percent", ".0f")}, {mean(one, "pose_nees", ".3g")}'
               for one in ('MVO', 'ours'))),
            ('Obstacle filter', 'errors of place [%], velocity [m/s] and contact [%] of movers on '
             'rendered streets; printed: told their blocks, and with planes held upright, too',
             '; '.join(', '.join(_obstacle_errors(results, 'MVO', prefix))
                       for prefix in ('told_', 'upright_')),
             ', '.join(_obstacle_errors(results, 'ours', '')))] if results.streets else []


def _number(value: float | None, pattern: str) -> str:
    return '' if value is None else format(value, pattern)


def text(results: Results, head: str, commit: str, pictures: Sequence[str]) -> str:
    """Return the whole page."""
    parts = [
        '# Side by side', head,
        f'Made by `make compare` at commit {commit} on {machine()}. Another run gives the same '
        'page and pictures but for CPU times, which stand in the table of CPU times and in '
        f'{pictures[-1]} alone; the fingerprint of all other figures is '
        f'`{fingerprint(results.found)}`. On a processor for which BLAS has other kernels the '
        'printed pipelines may take other samples: their way on `kitti00` was seen to err by 2.6 '
        'to 3.9 % [SLAPSE] and 1.5 or 0.9 % [MVO].', *(f'![{name}]({name})' for name in pictures),
        '## The way', ABOUT_WAYS,
        by_method(results, lambda row: f'{row["ate_mean_percent"]:.2f} '
                                       f'({row["ate_max_percent"]:.2f})'),
        ABOUT_EPSILON, by_method(
            results, lambda row: f'{_number(row["epsilon_d_percent"], ".1f")} '
                                 f'({row["epsilon_d_by_ratio"]:.1f})'),
        ABOUT_CPU, cpu_table(results),
        'What was published, and what others reach with pixels and full optimisation:',
        table(('', ''), PUBLISHED), NOTES]
    if results.streets:
        parts += ['## Planes', ABOUT_PLANES, plane_table(results), ABOUT_SWEEP,
                  sweep_table(results)]
    parts += ['## Moving obstacles', ABOUT_MOVERS, mover_table(results)]
    if results.streets:
        parts += [ABOUT_OBSTACLES, obstacle_table(results), ABOUT_FILTER]
    parts += ['## Step by step',
              ABOUT_DEPARTURES, departure_table(results), NAMED]
    return '\n\n'.join(part.strip('\n') for part in parts) + '\n'


def ways(results: Results) -> Figure:
    """Draw the ways over the true ones, from above."""
    shown = [name for name in SHOWN if name in results.ways] or results.ways[:4]
    figure = Figure(figsize=(11, 7), layout='constrained')
    for axes, scene in zip(figure.subplots(2, 2).ravel(), shown, strict=False):
        truth = np.array(results.row(scene, 'LK').get('truth', np.zeros((0, 2))))
        axes.plot(*truth.T, color='#bbbbbb', lw=6, label='true', solid_capstyle='round')
        for method in results.methods():
            path = np.array(results.row(scene, method).get('path', np.zeros((0, 2))))
            axes.plot(*path.T, color=COLOURS[method], lw=1.2, label=printed_name(method))
        axes.set(title=scene, xlabel='right x [m]', ylabel='forward z [m]')
        axes.grid(alpha=0.3)
        wide, high = np.ptp(truth, axis=0)
        if 0.1 < wide / max(high, 1e-9) < 10:  # of a straight way no difference would be seen
            axes.set_aspect('equal', adjustable='datalim')
    axes.legend(fontsize=7)
    return figure


def cost(results: Results) -> Figure:
    """Draw errors against CPU time."""
    figure = Figure(figsize=(7, 4.5), layout='constrained')
    axes, marks = figure.subplots(), 'os^Dv<>P'
    for method in results.methods():
        for mark, scene in zip(marks, results.ways, strict=False):
            row = results.row(scene, method)
            if 'error' not in row:
                axes.loglog(row['cpu_ms'], row['ate_mean_percent'], mark, color=COLOURS[method],
                            label=printed_name(method) if scene == results.ways[0] else None)
    for mark, scene in zip(marks, results.ways, strict=False):
        axes.loglog([], [], mark, color='black', mfc='none', label=scene)
    axes.set(xlabel='CPU time of a frame [ms]', ylabel='error of the way [%]')
    axes.grid(alpha=0.3, which='both')
    axes.legend(fontsize=7, ncols=2)
    return figure


def write(path: Path, found: dict[tuple, Any], head: str, commit: str):
    """Write the page and its pictures beside it."""
    results = Results(found)
    pictures = {f'{path.stem}_ways.svg': ways(results), f'{path.stem}_cost.svg': cost(results)}
    for name, figure in pictures.items():
        # without the date and with names by a fixed seed two runs give the same file
        with rc_context({'svg.hashsalt': 'mv_slapse'}), whole(path.with_name(name), 'w') as file:
            figure.savefig(file, format='svg', metadata={'Date': None})
    path.write_text(text(results, head, commit, list(pictures)))
