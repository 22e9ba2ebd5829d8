"""What does each rule of the core earn? Each is switched off, one at a time, over the same rows.

The rows are those of ``make evaluate``, clips mirrored and cut among them; ``rules.py`` holds the
rules. What was measured is kept in the cache folder and not measured again, so that a run may be
interrupted, and new rules cost only themselves. A figure of a group of rows (a sequence or street
in all its encodings) counts where it changes by more than twice the scatter: what it differs by
between versions of the same clip. A rule earns what is worse without it, and costs what is better.
The scatter is that of different clips, and so does not see what is a little worse in row after
row: figures of single rows that are worse, and better, are counted beside it.
"""

import argparse
from collections.abc import Callable, Sequence
from functools import partial
from hashlib import sha256
import json
from math import exp
from pathlib import Path
import sys

import gate
from mv_slapse.tools import evaluate
from mv_slapse.tools.cases import Case, Scene
from mv_slapse.tools.rows import Cache, Figures, measure_all
import rules
from rules import Rule

FEW = (  # scenes, with the encodings taken, that show most of the core for little time
    ('moving/seq', 'lowlatency'), ('kitti00', 'kitti00/mpeg2'), ('street 0', 'lowlatency'),
    ('crossing 1', 'mpeg2'), ('busy 0', 'mpeg2'), ('standstill', 'mpeg2'), ('turn', 'mpeg2'),
    ('fast 14', 'bframes'), ('flight, fast', 'mpeg2'))
TOLD = {  # measures of the page, and how a change of all rows is told
    'ATE': 'ln ATE', 'found': 'found', 'still so': 'still so [%]', 'in time': 'in time',
    'relabelled': 'relabelled', 'switches': 'switches', 'false': 'false',
    'NEES': 'pose NEES off', 'obstacle NEES': 'obstacle NEES off'}


def few(scene: Scene, cases: list[Case]) -> list[Case]:
    """Return the rows of a scene that are among the few."""
    part = next((part for name, part in FEW if scene.name.startswith(name)), None)
    return [] if part is None else [case for case in cases if part in case.name
                                    and not case.name.startswith(('free scale', 'speed given'))]


def a_third(number: int, cases: list[Case]) -> list[Case]:
    """Return one row of a scene, another encoding from scene to scene."""
    return [cases[number % len(cases)]] if cases else []


def chosen(scenes: Sequence[Scene], which: str):
    """Return the scenes that are measured, and the function that chooses their rows."""
    if which == 'few':
        names = tuple(name for name, _ in FEW)
        return [scene for scene in scenes if scene.name.startswith(names)], few
    if which == 'third':
        numbers = {scene.name: i for i, scene in enumerate(scenes)}
        return scenes, lambda scene, cases: a_third(numbers[scene.name], cases)
    return scenes, lambda scene, cases: cases


def label(cache: Cache, rule: Rule) -> str:
    """Return under which name the figures without a rule are kept."""
    digest = sha256(rule.content.encode()).hexdigest()[:8]
    return f'{cache.label} without {rule.name} {digest}'


def without(rule: Rule, scenes: Sequence[Scene], cache: Cache, options: argparse.Namespace,
            choose: Callable) -> dict[str, Figures]:
    """Return the figures of the rows without a rule."""
    workers = evaluate.workers_of(options, partial(rules.switch_off, rule.name))
    return measure_all(scenes, Cache(cache.folder, label(cache, rule), cache.only), workers,
                       None, choose)


class Verdict:
    """What the rows without a rule show against those with it."""

    def __init__(self, rule: Rule, before: gate.Rows, after: gate.Rows, altered: gate.Rows):
        """Compare."""
        self.rule = rule
        common = [name for name in before if name in after]
        self.before, self.after = ({name: rows[name] for name in common}
                                   for rows in (before, after))
        self.changes = gate.changes(self.before, self.after, altered | before)
        self.same = sum(before[name] | {'cpu_ms': 0} == after[name] | {'cpu_ms': 0}
                        for name in common)
        self.errors = [name for name in common if 'error' in after[name]]

    @property
    def earned(self) -> list[gate.Change]:
        """What is worse without the rule by more than the scatter, the worst first."""
        found = [change for change in self.changes if change.worse > gate.TIMES_SCATTER]
        return sorted(found, key=lambda change: -change.worse)

    @property
    def cost(self) -> list[gate.Change]:
        """What is better without the rule by more than the scatter, the best first."""
        found = [change for change in self.changes if change.worse < -gate.TIMES_SCATTER]
        return sorted(found, key=lambda change: change.worse)

    @property
    def single(self) -> tuple[int, int]:
        """How many figures of single rows are worse without the rule, and how many better."""
        worse = [measure.better * (a - b) / measure.finest
                 for measure in gate.MEASURES for name in self.before
                 for a, b in [[gate.value({name: rows[name]}, measure)
                               for rows in (self.before, self.after)]]
                 if a is not None and b is not None]
        return sum(one > 1 for one in worse), sum(one < -1 for one in worse)

    @property
    def judgement(self) -> str:
        """What this says of the rule."""
        if self.errors:
            return f'needed: {len(self.errors)} rows fail'
        if not self.earned:
            worse, better = self.single
            if worse > better + 2 * (worse + better)**0.5:
                return 'earns a little, row after row'
            return 'costs more than it earns' if self.cost else 'nothing beyond scatter'
        return 'earns' if len(self.earned) > len(self.cost) else 'earns and costs'

    def over_all(self, name: str) -> str:
        """Return a figure of all rows without the rule, against with it."""
        measure = next(one for one in gate.MEASURES if one.name == name)
        a, b = gate.total(self.before, measure), gate.total(self.after, measure)
        if a is None or b is None:
            return ''
        return f'× {exp(b - a):.3f}' if measure.combine is gate.log_mean else f'{b - a:+.3g}'


def page(verdicts: Sequence[Verdict], commit: str, which: str, n_rows: int) -> str:
    """Return the whole page."""
    lines = ['# Ablation', '', *__doc__.splitlines(), '',
             f'Made by `python benchmarks/ablation.py --rows {which}` at commit {commit}: '
             f'{n_rows} rows (few: {len(FEW)} kinds of scenes; third: one encoding of each '
             'scene). Columns: all rows without the rule against with it; groups: figures of '
             'groups that are worse, and better, without it by more than twice the scatter; '
             'single rows: figures of rows that are, by more than the least that counts.', '',
             f'| rule | verdict | groups | single rows | same rows | {" | ".join(TOLD)} |',
             '|' + ' --- |' * (len(TOLD) + 5)]
    for verdict in verdicts:
        lines.append('| ' + ' | '.join([
            verdict.rule.name, verdict.judgement, f'{len(verdict.earned)}, {len(verdict.cost)}',
            '{}, {}'.format(*verdict.single),
            f'{verdict.same} of {len(verdict.before)}',
            *map(verdict.over_all, TOLD.values())]) + ' |')
    for verdict in verdicts:
        lines += ['', f'## {verdict.rule.name}', '', f'{verdict.rule.what}.'.capitalize(), '']
        for title, found in (('Worse', verdict.earned), ('Better', verdict.cost)):
            lines += [f'- {title} without: {_told(change)}' for change in found[:6]]
        if len(verdict.earned) + len(verdict.cost) > 12:
            lines.append('- …')
    return '\n'.join(lines) + '\n'


def _told(change: gate.Change) -> str:
    before, after = (gate.shown(figure, change.measure)
                     for figure in (change.before, change.after))
    name = change.measure.name.removeprefix('ln ')
    return f'{change.group}, {name}: {before} → {after}, {abs(change.worse):.1f} × scatter'


def main(arguments: list[str] | None = None) -> int:
    """Switch each rule off and write the page, anew after each."""
    parser = argparse.ArgumentParser(prog='ablation.py', description=__doc__,
                                     formatter_class=argparse.RawDescriptionHelpFormatter)
    evaluate.add_options(parser)
    parser.add_argument('--rules', default='', help='names of rules, with commas between '
                        '(default: all)')
    parser.add_argument('--list', action='store_true', help='list the rules')
    parser.add_argument('--rows', choices=('few', 'third', 'all'), default='all')
    parser.add_argument('--reference', type=Path, help='figures of `gate.py measure` whose '
                        'versions of clips tell the scatter, beside those of the rows themselves')
    parser.add_argument('-o', '--output', type=Path, default=Path('docs/ablation.md'))
    options = parser.parse_args(arguments)
    if options.list:
        print('\n'.join(f'{rule.name}: {rule.what}' for rule in rules.RULES))
        return 0
    names = [name.strip() for name in options.rules.split(',') if name.strip()]
    unknown = [name for name in names if name not in rules.BY_NAME]
    if unknown:
        parser.error(f'no rule {unknown[0]!r}; --list names them')
    wanted = [rules.BY_NAME[name] for name in names] or rules.RULES
    cache = evaluate.cache_of(options)
    scenes, choose = chosen(evaluate.all_scenes(options), options.rows)
    before = measure_all(scenes, cache, evaluate.workers_of(options), None, choose)
    known = json.loads(options.reference.read_text()) if options.reference else {}
    altered = known.get('rows', {}) | known.get('altered', {})
    verdicts = []
    options.output.parent.mkdir(parents=True, exist_ok=True)
    for rule in wanted:
        after = without(rule, scenes, cache, options, choose)
        verdicts.append(Verdict(rule, before, after, altered))
        print(f'{rule.name}: {verdicts[-1].judgement}', file=sys.stderr, flush=True)
        options.output.write_text(page(verdicts, evaluate.commit_of(Path.cwd()), options.rows,
                                       len(before)))
    return 0


if __name__ == '__main__':
    sys.exit(main())
