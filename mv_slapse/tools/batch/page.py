"""``batch.html``: all runs in one table that sorts, distributions, and the worst with pictures.

One file that needs no network: it may be sent to whoever asks.
"""

from collections.abc import Sequence
from html import escape
from pathlib import Path
from string import Template
from typing import Any

from matplotlib.figure import Figure
from mv_slapse.errors import MvSlapseError
from mv_slapse.evaluation import trajectory
from mv_slapse.evaluation.truth import read_truth
from mv_slapse.storage import whole_files
from mv_slapse.storage.tum import read_trajectory
from mv_slapse.tools.batch.places import PAGE
from mv_slapse.tools.batch.summary import COLUMNS
from mv_slapse.tools.batch.task import DONE, Row
from mv_slapse.tools.page import image, png
import numpy as np

N_WORST = 10
BINS = 24
TRUE, FOUND = '#8c8c8c', '#0072b2'
SHOWN = {  # columns whose distributions are drawn
    'epsilon_d_percent': 'position error, per cent of the way',
    'lost_percent': 'key frames without a pose, per cent',
    'cpu_ms': 'CPU for each frame, ms', 'duration_s': 'duration, s', 'obstacles': 'obstacles',
    'hazards': 'hazards'}
STYLE = '''body { font: 14px/1.45 system-ui, sans-serif; margin: 2rem; color: #222 }
h1 { font-size: 1.5rem } h2 { font-size: 1.15rem; margin-top: 2rem }
table { border-collapse: collapse; font-size: 12px } td, th { padding: .2rem .6rem;
  border-bottom: 1px solid #ddd; text-align: left; vertical-align: top }
td.n { text-align: right; font-variant-numeric: tabular-nums } th { cursor: pointer;
  position: sticky; top: 0; background: #fff } tr.failed td { background: #fbe9e4 }
tr.lost td { background: #fdf6dd } figure { display: inline-block; margin: .5rem }
figcaption { font-size: 12px; max-width: 24rem } .wide { overflow-x: auto }'''
SORT = '''document.querySelectorAll('th').forEach((head, column) => {
  let up = false
  head.onclick = () => {
    const body = document.querySelector('tbody'), rows = [...body.rows]
    up = !up
    rows.sort((a, b) => {
      const [x, y] = [a, b].map(row => row.cells[column].textContent)
      if (x === '' || y === '') return (x === '') - (y === '')
      const order = isNaN(x) || isNaN(y) ? x.localeCompare(y) : x - y
      return up ? order : -order })
    body.append(...rows) } })'''
WHOLE = Template('''<!doctype html>
<html lang="en"><head><meta charset="utf-8"><title>mv_slapse batch</title>
<style>$style</style></head>
<body><h1>mv_slapse batch: $n runs</h1>
<p>$counts</p>
<h2>Distributions</h2>
$distributions
<h2>The worst</h2>
$worst
<h2>All runs</h2>
<p>A click on a name sorts by that column.</p>
<div class="wide"><table><thead><tr>$head</tr></thead><tbody>
$body
</tbody></table></div>
<script>$sort</script></body></html>
''')


def write(rows: Sequence[Row], output: Path):
    """Write the page of a folder of runs.

    Raises
    ------
    UnusableOutput
    """
    statuses = [row['status'] for row in rows]
    counts = ', '.join(f'{statuses.count(name)} {name}' for name in dict.fromkeys(statuses))
    whole_files.write_text(output / PAGE, WHOLE.substitute(
        style=STYLE, sort=SORT, n=len(rows), counts=counts,
        distributions=''.join(_distribution(rows, *item) for item in SHOWN.items()),
        worst=''.join(_pictured(row, output) for row in worst(rows)) or '<p>None was done.</p>',
        head=''.join(f'<th>{escape(name)}</th>' for name in COLUMNS),
        body='\n'.join(map(_table_row, rows))))


def worst(rows: Sequence[Row]) -> list[Row]:
    """Return the runs with results that are worst: by error where that is known, else lost."""
    known = [row for row in rows if row.get('poses') is not None]
    return sorted(known, key=lambda row: (-(row.get('epsilon_d_percent') or 0.0),
                                          -row['lost_percent']))[:N_WORST]


def _table_row(row: Row) -> str:
    cells = ''.join(_cell(row.get(name)) for name in COLUMNS)
    return f'<tr class="{escape(row["status"])}">{cells}</tr>'


def _cell(value: Any) -> str:
    if isinstance(value, int | float):
        return f'<td class="n">{value:.5g}</td>' if isinstance(value, float) else \
            f'<td class="n">{value}</td>'
    return f'<td>{escape(value or "")}</td>'


def _distribution(rows: Sequence[Row], column: str, title: str) -> str:
    values = np.array([row[column] for row in rows if row.get(column) is not None], float)
    if not len(values):
        return ''
    figure = Figure(figsize=(4.2, 2.4), layout='constrained')
    axes = figure.subplots()
    # Values that differ by rounding alone leave no room for bins between them.
    span = max(np.ptp(values), 1e-6 * np.abs(values).max()) / 2 or 0.5
    middle = (values.min() + values.max()) / 2
    axes.hist(values, BINS, range=(middle - span, middle + span), color=FOUND)
    axes.axvline(np.median(values), color='black', lw=1)
    axes.set(ylabel='runs')
    return _image(figure, f'{title}: median {np.median(values):.4g}, 95 % below '
                  f'{np.percentile(values, 95):.4g}, worst {values.max():.4g}')


def _pictured(row: Row, output: Path) -> str:
    errors = [f'{name} {row[name]:.4g}' for name in ('epsilon_d_percent', 'lost_percent')
              if row.get(name) is not None]
    caption = f'{row["name"]}: {", ".join(errors)}' + ('' if row['status'] == DONE else
                                                       f', {row["status"]}')
    try:
        return _image(_from_above(output / row['name'], row.get('ground_truth', '')), caption)
    except MvSlapseError as error:  # the folder has been taken away, or the truth
        return f'<figure><figcaption>{escape(caption)}: {escape(str(error))}</figcaption></figure>'


def _from_above(folder: Path, truth: str) -> Figure:
    """Draw the way of the camera in the plane that it fills most, with the true one."""
    path = read_trajectory(folder / 'trajectory.tum')
    positions, true = path.positions, None
    known = read_truth(truth).trajectory if truth else None
    if known is not None:
        score = trajectory.evaluate(path, known)
        positions, true = score.alignment.apply(positions), known.positions
    x, y = np.argsort(-np.ptp(positions, axis=0), kind='stable')[:2] if len(positions) else (0, 2)
    figure = Figure(figsize=(4.2, 3.2), layout='constrained')
    axes = figure.subplots()
    if true is not None:
        axes.plot(true[:, x], true[:, y], color=TRUE, lw=3, label='true')
    axes.plot(positions[:, x], positions[:, y], '.-', color=FOUND, ms=2, lw=1, label='found')
    axes.set(xlabel=f'{"xyz"[x]}', ylabel=f'{"xyz"[y]}', aspect='equal', adjustable='datalim')
    axes.legend(fontsize=8)
    return figure


def _image(figure: Figure, caption: str) -> str:
    return (f'<figure>{image(png(figure), caption)}<figcaption>{escape(caption)}</figcaption>'
            '</figure>')
