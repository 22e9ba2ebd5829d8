"""Has a change of the core cost any figure? The rows of ``make evaluate``, kept and compared.

``measure`` runs the rows in parallel and keeps their figures as one JSON file; what was measured,
rendered, encoded or decoded before is taken from the cache. ``compare`` puts two such files side
by side, group by group: a group is a sequence or street in all its encodings. What is worse by
more than twice the scatter is flagged, and the exit code is 1. The scatter is how much a figure
differs between versions of the same clip: mirrored, cut by a few pixels, or with a little noise
in its pictures (``--noise``).
"""

import argparse
from collections.abc import Callable, Iterable
from dataclasses import dataclass
import json
from math import exp, isfinite, log, sqrt
from pathlib import Path
import re
import sys
from typing import Any

from mv_slapse.tools import cases, evaluate
from mv_slapse.tools.rows import Figures, measure_all

Rows = dict[str, Figures]
VERSION = re.compile(r', (mirrored|cut|noise)$')
TIMES_SCATTER = 2.0
FEWEST = 3  # groups whose scatter tells that of others


@dataclass(frozen=True)
class Measure:
    """A figure of a group of rows.

    Attributes
    ----------
    name, key : str
        For the table, and as ``mv_slapse eval`` calls it.
    combine : function of a list of float
        From rows to their group.
    better : int
        1: more is better, -1: less is better, 0: neither.
    finest : float
        Scatter below which no difference counts.
    """

    name: str
    key: str
    combine: Callable[[list[float]], float]
    better: int
    finest: float


def mean(values: Iterable[float]) -> float:
    """Return the mean."""
    values = list(values)
    return sum(values) / len(values)


def log_mean(values: Iterable[float]) -> float:
    """Return the logarithm of the geometric mean; 1e-4 and less are the same."""
    return mean(log(max(value, 1e-4)) for value in values)


def from_six(values: Iterable[float]) -> float:
    """Return how far a NEES of six degrees of freedom is off, as a logarithm."""
    return abs(log_mean(values) - log(6))


MEASURES = (
    Measure('ln ATE', 'ate_mean_percent', log_mean, -1, 0.02),
    Measure('found', 'movers_found', sum, 1, 0.5),
    Measure('still so [%]', 'stationary_called_moving_percent', mean, -1, 0.02),
    Measure('in time', 'movers_confirmed_in_time', sum, 1, 0.5),
    Measure('hazards', 'hazards_in_time', sum, 1, 0.5),
    Measure('others', 'others_in_time', sum, 1, 0.5),
    Measure('false braking', 'false_braking_frames', sum, -1, 0.5),
    Measure('relabelled', 'relabelled_in_time', sum, 1, 0.1),
    Measure('switches', 'identity_switches', sum, -1, 0.5),
    Measure('pose NEES off', 'pose_nees', from_six, -1, 0.1),
    Measure('obstacle NEES off', 'obstacle_nees', from_six, -1, 0.1),
    Measure('false', 'false_obstacles_per_frame', mean, -1, 0.005),
    Measure('confirmed', 'confirmed_obstacles_per_frame', mean, 0, 0.02),
    Measure('boxes met [%]', 'boxes_met_percent', mean, 1, 0.5))


def groups(rows: Rows) -> dict[str, Rows]:
    """Return the rows of each group."""
    found: dict[str, Rows] = {}
    for name, figures in rows.items():
        found.setdefault(name.rpartition('/')[0].removeprefix('moving/'), {})[name] = figures
    return found


def value(rows: Rows, measure: Measure) -> float | None:
    """Return a figure of a group; None where none of its rows has it."""
    known = [figures[measure.key] for figures in rows.values()
             if isinstance(figures.get(measure.key), int | float)]
    known = [one for one in known if isfinite(one)]
    return measure.combine(known) if known else None


def scatter(rows: Rows, measure: Measure) -> Callable[[str], float]:
    """Return a function of a group's name: standard deviation between versions of the same.

    A group without other versions has the typical scatter of the groups that have some, and
    no group has less than half of that: two versions may agree by chance.
    """
    families: dict[str, list[float]] = {}
    for name, group in groups(rows).items():
        found = value(group, measure)
        if found is not None:
            families.setdefault(VERSION.sub('', name), []).append(found)
    known = {family: _deviation(found) for family, found in families.items() if len(found) > 1}
    typical = sqrt(mean(one**2 for one in known.values())) if len(known) >= FEWEST else 0.0

    def of(name: str) -> float:
        own = known.get(VERSION.sub('', name))
        return max(typical if own is None else max(own, typical / 2), measure.finest)

    return of


@dataclass(frozen=True)
class Change:
    """A figure of a group before and after, and how many times the scatter it is worse."""

    group: str
    measure: Measure
    before: float
    after: float
    worse: float

    @property
    def is_flagged(self) -> bool:
        """Whether it is worse by more than chance explains."""
        return self.worse > TIMES_SCATTER


def changes(before: Rows, after: Rows, altered: Rows | None = None) -> list[Change]:
    """Return each figure of each group that both have; the scatter is that of ``altered``."""
    found = []
    common = [name for name in before if name in after]
    old, new = (groups({name: rows[name] for name in common}) for rows in (before, after))
    for measure in MEASURES:
        spread = scatter(before | (altered or {}), measure)
        for group in old:
            a, b = value(old[group], measure), value(new[group], measure)
            if a is not None and b is not None:
                found.append(Change(group, measure, a, b,
                                    measure.better * (a - b) / spread(group)))
    return found


def total(rows: Rows, measure: Measure) -> float | None:
    """Return a figure of all rows."""
    return value(rows, measure)


def text(before: dict[str, Any], after: dict[str, Any]) -> str:
    """Return two files of figures side by side."""
    old, new = before['rows'], after['rows']
    common = [name for name in old if name in new]
    a, b = ({name: rows[name] for name in common} for rows in (old, new))
    found = changes(a, b, before.get('altered'))
    lines = [f'{before["commit"]} -> {after["commit"]}: {len(common)} rows in both']
    missing = sorted(set(old) ^ set(new))
    lines += [f'only in one: {len(missing)} rows, first {missing[0]}'] if missing else []
    lines += _errors(a, b)
    lines += ['', 'over all rows']
    for measure in MEASURES:
        x, y = total(a, measure), total(b, measure)
        if x is not None and y is not None:
            lines.append(f'  {measure.name:18} {shown(x, measure):>9} -> {shown(y, measure):>9}'
                         + (f'  x {exp(y - x):.3f}' if measure.combine is log_mean else ''))
    same = sum(a[name] | {'cpu_ms': 0} == b[name] | {'cpu_ms': 0} for name in common)
    lines += [f'  rows without any difference: {same} of {len(common)}', '',
              'groups that differ by more than half their scatter (+: worse, in scatters)']
    for change in sorted(found, key=lambda change: -change.worse):
        if abs(change.worse) > 0.5:
            lines.append(f'{"! " if change.is_flagged else "  "}{change.group:32} '
                         f'{change.measure.name:18} {shown(change.before, change.measure):>9} -> '
                         f'{shown(change.after, change.measure):>9}  {change.worse:+.1f}')
    flagged = sum(change.is_flagged for change in found)
    return '\n'.join([*lines, '', f'{flagged} of {len(found)} figures of groups are worse by more '
                      f'than {TIMES_SCATTER:g} times the scatter'])


def _errors(before: Rows, after: Rows) -> list[str]:
    return [f'! {name}: {figures["error"]}' for name, figures in after.items()
            if 'error' in figures and 'error' not in before[name]]


def _deviation(values: list[float]) -> float:
    middle = mean(values)
    return sqrt(sum((one - middle)**2 for one in values) / (len(values) - 1))


def shown(figure: float, measure: Measure) -> str:
    """Return a figure of a group as text."""
    if measure.combine is log_mean:
        return f'{exp(figure):.4f}'
    return f'{figure:.3f}' if isinstance(figure, float) else str(figure)


def _measure(options: argparse.Namespace) -> int:
    scenes, cache = evaluate.all_scenes(options), evaluate.cache_of(options)
    workers = evaluate.workers_of(options)
    content = {'commit': evaluate.commit_of(Path.cwd()), 'code': cache.label,
               'rows': measure_all(scenes, cache, workers, evaluate.tell)}
    if options.noise:
        again = cases.grainy(options.data.resolve(), scenes)
        content['altered'] = measure_all(again, cache, workers, evaluate.tell)
    options.output.parent.mkdir(parents=True, exist_ok=True)
    options.output.write_text(written(content))
    return 0


def written(content: dict[str, Any]) -> str:
    """Return a file of figures, a line for each row."""
    parts = [f'"{key}": ' + ('{\n' + ',\n'.join(
        f'  {json.dumps(name)}: {json.dumps(figures)}' for name, figures in item.items()) + '}'
        if isinstance(item, dict) else json.dumps(item)) for key, item in content.items()]
    return '{' + ',\n'.join(parts) + '}\n'


def _compare(options: argparse.Namespace) -> int:
    before, after = (json.loads(path.read_text()) for path in (options.before, options.after))
    print(text(before, after))
    old, new = before['rows'], after['rows']
    failed = _errors(old, {name: row for name, row in new.items() if name in old})
    return int(bool(failed) or any(change.is_flagged for change in changes(
        old, new, before.get('altered'))))


def main(arguments: list[str] | None = None) -> int:
    """Measure, or compare two measurements."""
    parser = argparse.ArgumentParser(prog='gate.py', description=__doc__,
                                     formatter_class=argparse.RawDescriptionHelpFormatter)
    verbs = parser.add_subparsers(required=True, metavar='VERB')
    measure = verbs.add_parser('measure', help='run the rows and keep their figures')
    evaluate.add_options(measure)
    measure.add_argument('--noise', action='store_true',
                         help='also the rendered scenes, kitti00 and parking with noise in their '
                              'pictures: for the scatter')
    measure.add_argument('-o', '--output', type=Path, default=Path('out/figures.json'))
    measure.set_defaults(run=_measure)
    compare = verbs.add_parser('compare', help='compare two files of figures')
    compare.add_argument('before', type=Path)
    compare.add_argument('after', type=Path)
    compare.set_defaults(run=_compare)
    options = parser.parse_args(arguments)
    return options.run(options)


if __name__ == '__main__':
    sys.exit(main())
