"""The page of results: ten lines, one short table for each question, and all rows as a table.

A row of the evaluation is a scene in an encoding. Scenes of one kind, and its encodings, are lines
of the short tables: medians, the worst, and sums.
"""

from collections.abc import Callable, Iterable
import csv
from dataclasses import dataclass
import io
from pathlib import Path
import re
import statistics
from typing import Any

from mv_slapse.tools.cases import ENCODINGS

Rows = dict[str, dict[str, Any]]
HEIGHT, SPEED, FREE = 'height or none', 'speed given', 'free scale'
CLIPS = 'given clips'
WORST_SHOWN = 10
HEAD = """# Results

Made by `make evaluate{options}` at commit {commit}, default settings, `--camera-height` where the
data set tells it. A row is `mv_slapse run VIDEO --camera camera.yaml [--camera-height H] -o OUT`,
then `mv_slapse eval OUT --ground-truth …`; all {n} rows with all figures stand in
[results.csv](results.csv). Speed given: `--speed` drawn from the truth with 1 % noise, in place of
the height; free scale: neither. A scene, and each mover in it, is in the tables once for each
encoding ({encodings}).

"""


@dataclass(frozen=True)
class Name:
    """What the name of a row says."""

    kind: str  # of the scene: its name without the number
    mode: str  # where the scale comes from
    encoding: str


@dataclass(frozen=True)
class Column:
    """A column of a short table: the figures of its rows as one text."""

    title: str
    key: str
    of: Callable[[list[float]], float]
    form: str


@dataclass(frozen=True)
class Question:
    """A short table."""

    title: str
    note: str
    columns: tuple[Column, ...]
    needed: str  # a row without this figure is not in it
    by: Callable[[Name], str]
    of: Callable[[Rows], Rows] = dict  # which rows are asked


def name_of(row: str) -> Name:
    """Return what the name of a row says."""
    scene, _, encoding = row.rpartition('/')
    mode = next((m for m in (SPEED, FREE) if re.search(rf'(^{m}, |, {m}$)', scene)), HEIGHT)
    scene = re.sub(rf'^({SPEED}|{FREE}), |, ({SPEED}|{FREE})$', '', scene)
    # the given clips with movers are one kind, mirrored and cut ones two others
    clip = re.fullmatch(r'(?:moving/)?(?:seq\w+|car\d+|tusimple)((?:, \w+)?)', scene)
    kind = f'{CLIPS}{clip[1]}' if clip else re.sub(r' \d+$', '', scene)
    return Name(kind, mode, encoding.rpartition('.')[0] or encoding)


def _kind(name: Name) -> str:
    return name.kind if name.mode == HEIGHT else f'{name.kind}, {name.mode}'


def _clips_by_encoding(name: Name) -> str:
    """Return the kind; of the given clips, which have few movers, for each encoding."""
    return f'{_kind(name)}, {name.encoding}' if name.kind.startswith(CLIPS) else _kind(name)


def _in_all_encodings(measured: Rows) -> Rows:
    """Return the rows of those scenes that each encoding of ENCODINGS has."""
    main = {Path(file).stem for file in ENCODINGS}
    has: dict[str, set[str]] = {}
    for row in measured:
        has.setdefault(row.rpartition('/')[0], set()).add(name_of(row).encoding)
    return {row: figures for row, figures in measured.items() if name_of(row).encoding in main
            and has[row.rpartition('/')[0]] >= main}


def _median(title: str, key: str, form: str) -> Column:
    return Column(title, key, statistics.median, form)


def _worst(key: str, form: str, of: Callable = max) -> Column:
    return Column('worst', key, of, form)


def _sum(title: str, key: str) -> Column:
    return Column(title, key, sum, '{:.0f}')


QUESTIONS = (
    Question('How far off is the position?',
             'Medians over scenes and encodings, and the worst. ATE: mean error after similarity '
             'alignment, rigid: after rigid alignment, ε_D: of the way from the first pose '
             'without alignment (table II of [SLAPSE]), all in per cent of the way; step: longest '
             'between two poses, less what twist and covariances explain [map unit]; standstill: '
             'farthest from where it stopped.',
             (_median('ATE [%]', 'ate_mean_percent', '{:.3f}'),
              _worst('ate_mean_percent', '{:.3f}'),
              _median('rigid [%]', 'ate_rigid_mean_percent', '{:.2f}'),
              _worst('ate_rigid_mean_percent', '{:.2f}'),
              _median('ε_D [%]', 'epsilon_d_percent', '{:.2f}'),
              Column('step', 'unexplained_step', max, '{:.2f}'),
              Column('standstill [m]', 'standstill_drift_m', max, '{:.3f}')),
             'ate_mean_percent', _kind),
    Question('Are its covariances right?',
             'Posed: key frames with a pose; covered: positions of these within 3 sigma of the '
             'true ones; NEES: of poses, 6 if the covariances are right, where the truth is '
             'exact.',
             (_median('posed [%]', 'posed_percent', '{:.0f}'),
              Column('least', 'posed_percent', min, '{:.0f}'),
              _median('covered [%]', 'position_covered_percent', '{:.0f}'),
              Column('least', 'position_covered_percent', min, '{:.0f}'),
              _median('NEES', 'pose_nees', '{:.1f}'), _worst('pose_nees', '{:.1f}')),
             'position_covered_percent', _kind),
    Question('Does the encoding matter?',
             'Medians over the scenes with a true way that are there in each of these encodings.',
             (_median('ATE [%]', 'ate_mean_percent', '{:.3f}'),
              _worst('ate_mean_percent', '{:.3f}'),
              _median('rigid [%]', 'ate_rigid_mean_percent', '{:.2f}')),
             'ate_mean_percent', lambda name: name.encoding, _in_all_encodings),
    Question('Are the planes there?',
             'Found: true planes that were found, in all; errors: medians; on one: observations '
             'of planes four fifths of whose macroblocks lie on one true plane.',
             (_sum('found', 'n_planes'), _median('depth [m]', 'plane_depth_error_m', '{:.2f}'),
              _median('normal [deg]', 'plane_normal_error_deg', '{:.1f}'),
              _median('on one [%]', 'plane_observations_on_one_plane_percent', '{:.0f}')),
             'plane_depth_error_m', _kind),
    Question('Is what moves called moving, and nothing else?',
             'Movers called moving, of those labelled; of the given clips by encoding, which show '
             'the same movers, of rendered scenes in all. Still so: stationary points or blocks '
             'called moving.',
             (_sum('called moving', 'movers_found'), _sum('of', 'movers_total'),
              _median('still so [%]', 'stationary_called_moving_percent', '{:.2f}'),
              _worst('stationary_called_moving_percent', '{:.2f}')),
             'movers_total', _clips_by_encoding),
    Question('Are obstacles confirmed in time, and where they are?',
             'In time: passages of movers of at least 6 macroblocks met by a confirmed obstacle '
             'within 0.5 s. Position (of the range), velocity, time to contact: medians of '
             'median errors. NEES: of position and velocity, 6 if the covariances are right. '
             'False: rows of confirmed obstacles that meet no mover, for each key frame.',
             (_sum('in time', 'movers_confirmed_in_time'), _sum('of', 'movers_due'),
              _median('position [%]', 'obstacle_position_error_percent', '{:.1f}'),
              _median('velocity [m/s]', 'obstacle_velocity_error_m_s', '{:.2f}'),
              _median('contact [%]', 'obstacle_ttc_error_percent', '{:.1f}'),
              _median('NEES', 'obstacle_nees', '{:.1f}'),
              _sum('id switches', 'identity_switches'),
              _median('false / frame', 'false_obstacles_per_frame', '{:.3f}')),
             'movers_due', _kind),
    Question('Is what lies ahead told a planner in time, and nothing else?',
             'Hazards: movers that the camera would meet if both went on as they do, within 1.2 m '
             'of its way. In time: confirmed at a time to contact of 2 s or more, or within 0.5 s '
             'of covering 12 macroblocks where that is later; missed: not at 1 s either. Others: '
             'passages of other movers, in time within 0.5 s of covering 9 macroblocks. False '
             'braking: key frames with a confirmed obstacle on the camera\'s way, less than 3 s '
             'away, where nothing moves. Lengths are those of the run or of the truth, in the '
             'labelled clips by the height of KITTI\'s cameras; where none is known, on any way.',
             (_sum('hazards', 'hazards'), _sum('in time', 'hazards_in_time'),
              _sum('missed', 'hazards_missed'),
              _median('contact when confirmed [s]', 'contact_at_confirmation_s', '{:.1f}'),
              _sum('others', 'others'), _sum('others in time', 'others_in_time'),
              _sum('false braking', 'false_braking_frames'),
              _sum('key frames', 'frames_judged')),
             'frames_judged', _kind),
    Question('What does it cost?', 'CPU time of all stages for a frame of the video.',
             (_median('CPU [ms]', 'cpu_ms', '{:.1f}'), _worst('cpu_ms', '{:.1f}')),
             'cpu_ms', _kind))


def page(measured: Rows, commit: str, first_seed: int = 0) -> str:
    """Return the page, given the figures of each row and the first seed of what is rendered."""
    encodings = ', '.join(dict.fromkeys(name_of(row).encoding for row in measured
                                        if not row.startswith('original')))
    options = f' ARGS="--first-seed {first_seed}"' if first_seed else ''
    return '\n'.join([HEAD.format(commit=commit, n=len(measured), encodings=encodings,
                                  options=options)
                      + _summary(measured), *(_table(q, measured) for q in QUESTIONS),
                      _failures(measured)]).rstrip() + '\n'


def rows_as_csv(measured: Rows) -> str:
    """Return all rows with all figures, as CSV."""
    keys = sorted({key for figures in measured.values() for key in figures})
    file = io.StringIO()
    writer = csv.writer(file, lineterminator='\n')
    writer.writerow(['sequence', *keys])
    for row, figures in measured.items():
        writer.writerow([row, *('' if figures.get(key) is None else figures[key] for key in keys)])
    return file.getvalue()


def _table(question: Question, measured: Rows) -> str:
    groups: dict[str, list[dict[str, Any]]] = {}
    for row, figures in question.of(measured).items():
        if figures.get(question.needed) is not None:
            groups.setdefault(question.by(name_of(row)), []).append(figures)
    head = ['', 'rows', *(column.title for column in question.columns)]
    lines = [_line(head), _line(['---'] * len(head)),
             *(_line([group, str(len(found)), *(_cell(column, found)
                                                for column in question.columns)])
               for group, found in groups.items())]
    return f'## {question.title}\n\n{question.note}\n\n' + '\n'.join(lines) + '\n'


def _cell(column: Column, found: list[dict[str, Any]]) -> str:
    values = [figures[column.key] for figures in found if figures.get(column.key) is not None]
    return column.form.format(column.of(values)) if values else ''


def _line(cells: Iterable[str]) -> str:
    return f'| {" | ".join(cells)} |'


def _summary(measured: Rows) -> str:
    """Return a line for each thing that a reader asks first."""
    lines = []
    for mode, said in ((HEIGHT, 'camera height or nothing given'), (SPEED, 'speed given'),
                       (FREE, 'free scale')):
        errors = _values(measured, 'ate_mean_percent', lambda name, m=mode: name.mode == m)
        if errors:
            lines.append(f'Position, {said}: {statistics.median(errors):.3f} % of the way in the '
                         f'median of {len(errors)} rows, {max(errors):.2f} % in the worst.')
    rigid = _values(measured, 'ate_rigid_mean_percent')
    if rigid:
        lines.append(f'With metric scale, after rigid alignment: {statistics.median(rigid):.2f} % '
                     f'in the median of {len(rigid)} rows, {max(rigid):.2f} % in the worst.')
    covered = _values(measured, 'position_covered_percent')
    if covered:
        lines.append(f'At least 95 % of the positions lie within 3 sigma in '
                     f'{sum(c >= 95 for c in covered)} of {len(covered)} rows.')
    lines += [line for line in (
        _of(measured, 'movers_found', 'movers_total', 'labelled movers of the given clips are '
            'called moving', lambda name: name.kind == CLIPS),
        _of(measured, 'movers_confirmed_in_time', 'movers_due', 'passages of movers are confirmed '
            'within 0.5 s', lambda name: name.mode == HEIGHT),
        _of(measured, 'others_in_time', 'others', 'passages of movers that are no hazard are '
            'confirmed within 0.5 s of covering 9 macroblocks', lambda name: name.mode == HEIGHT)
    ) if line]
    false = _values(measured, 'false_obstacles_per_frame')
    if false:
        lines.append(f'{sum(f == 0 for f in false)} of {len(false)} rows have no false obstacle, '
                     f'the worst has {max(false):.2f} a key frame.')
    cost = _values(measured, 'cpu_ms')
    if cost:
        lines.append(f'A picture costs {statistics.median(cost):.0f} ms of CPU in the median, '
                     f'{max(cost):.0f} ms in the worst row, beside what else ran then; '
                     '`docs/benchmarks.md` has ratios that hold elsewhere.')
    failed = sum('error' in figures for figures in measured.values())
    lines.append(f'{failed} of {len(measured)} rows could not be measured.')
    return '\n'.join(f'* {line}' for line in lines) + '\n'


def _of(measured: Rows, part: str, whole: str, said: str, keep: Callable[[Name], bool]) -> str:
    parts, wholes = (sum(_values(measured, key, keep)) for key in (part, whole))
    return f'{parts:.0f} of {wholes:.0f} {said}, each counted for each encoding.' if wholes else ''


def _values(measured: Rows, key: str,
            keep: Callable[[Name], bool] = lambda _: True) -> list[float]:
    return [figures[key] for row, figures in measured.items()
            if figures.get(key) is not None and keep(name_of(row))]


def _failures(measured: Rows) -> str:
    """Return what could not be measured, and the rows that are farthest off."""
    failed = [(row, figures['error']) for row, figures in measured.items() if 'error' in figures]
    worst = sorted(((figures['ate_mean_percent'], row) for row, figures in measured.items()
                    if figures.get('ate_mean_percent') is not None), reverse=True)
    missed = [(row, f'{figures["movers_total"] - figures["movers_found"]:.0f} of '
               f'{figures["movers_total"]:.0f} movers not called moving')
              for row, figures in measured.items()
              if (figures.get('movers_total') or 0) > (figures.get('movers_found') or 0)]
    off = [(row, f'position {error:.2f} % off') for error, row in worst[:WORST_SHOWN]]
    lines = [*failed, *off, *missed[:WORST_SHOWN]]
    return ('## Where does it fail?\n\nThe rows that could not be measured, those farthest off, '
            f'and the first {WORST_SHOWN} that miss movers.\n\n| row | what |\n| --- | --- |\n'
            + '\n'.join(_line(pair) for pair in lines) + '\n')
