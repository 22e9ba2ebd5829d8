"""``report.html`` of a run: its way, planes and obstacles, and how sure it was when."""

from collections.abc import Mapping
import json
from pathlib import Path
from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Ellipse
from mv_slapse.config import Settings
from mv_slapse.evaluation.detection import confirmed
from mv_slapse.records import TrackingStatus, WITH_POSE
from mv_slapse.storage.tables import OBSTACLES_HEADER, read_table
from mv_slapse.storage.whole_files import write_text
from mv_slapse.tools import page
from mv_slapse.tools.figures import FOUND, MOVER
from mv_slapse.tools.history import History
import numpy as np

REPORT = 'report.html'
ELLIPSES = 20  # along the way
STATUS_COLOURS = {TrackingStatus.INITIALISING: '#bbbbbb', TrackingStatus.OK: '#009e73',
                  TrackingStatus.PREDICTED: '#e69f00', TrackingStatus.LOST: '#d55e00'}


def write(output: str | Path, summary: Mapping[str, Any], history: History):
    """Write the report of a folder of results; one file that needs no network."""
    output, rows = Path(output), history.columns()
    unit = 'm' if summary['scale_status'] == 'metric' else 'map unit'
    obstacles = confirmed(read_table(output / 'obstacles.csv', OBSTACLES_HEADER))
    map_ = json.loads((output / 'map.json').read_text())
    sections = [('What came out', page.table(_facts(summary), ('', '', '')))]
    if summary['poses']:
        sections += [
            ('The way, planes and obstacles', page.image(page.png(
                _way(rows, map_, obstacles, unit)), 'from above and from the side')),
            ('Over time', page.image(page.png(_over_time(rows, obstacles, unit)),
                                     'tracking, scale, planes and obstacles over time'))]
    sections += [('Time by stage', page.image(page.png(_stages(summary)), 'CPU by stage')),
                 ('Settings that are not the usual ones', page.listing(_changed(summary))),
                 ('Provenance', page.listing(summary))]
    write_text(output / REPORT, page.page(f'mv_slapse: {Path(summary["input"]).name}', sections))


def _facts(summary: Mapping[str, Any]) -> list[tuple[str, str, str]]:
    frames, total = max(summary['frames'], 1), summary['cpu_seconds'].get('total', 0.0)
    reasons = {**summary['broken_reasons'], **summary['reasons']}
    return [
        ('pictures', f'{summary["frames"]}', f'at {summary["fps"]:g} a second'),
        ('key frames', f'{summary["key_frames"]}', f'{summary["poses"]} of them with a pose'),
        ('broken pairs', f'{summary["broken_segments"]}', 'without motion vectors to rely on'),
        ('scale', summary['scale_status'], summary['scale_source'] or 'nothing tells the length; '
         'give --camera-height or --speed'),
        ('planes', f'{summary["planes"]}', 'ever in the map'),
        ('obstacles', f'{summary["obstacles_confirmed"]}', 'confirmed'),
        ('CPU', f'{1000 * total / frames:.1f} ms', 'a picture, all stages'),
        *((f'{count} times', '', reason) for reason, count in reasons.items()),
        *(('warning', '', warning) for warning in summary['warnings'])]


def _changed(summary: Mapping[str, Any]) -> dict[str, Any]:
    usual = Settings()
    return {f'{section}.{name}': value for section, values in summary['settings'].items()
            for name, value in values.items()
            if value != getattr(getattr(usual, section), name)} or {'all': 'as usual'}


def _way(rows: dict[str, np.ndarray], map_: Mapping[str, Any],
         obstacles: dict[str, np.ndarray], unit: str) -> Figure:
    """Draw the way from above (x, z) and from the side (y, z) in the first camera's frame."""
    figure = Figure(figsize=(11, 7), layout='constrained')
    grid = figure.subplots(2, 1, sharex=True, height_ratios=(3, 1))
    known = np.isin(rows['status'], WITH_POSE)
    size = max(np.ptp(rows[name][known]) for name in 'xyz')
    for axes, across, title in ((grid[0], 'x', 'from above'), (grid[1], 'y', 'from the side')):
        _draw_ways(axes, {name: column[known] for name, column in rows.items()}, across)
        index = 'xyz'.index(across)
        for plane in map_['planes']:
            normal, outline = plane['normal'], np.array(plane['outline']).reshape(-1, 3)
            if len(outline) and abs(normal[1 - index]) < 0.5:  # one that is seen edge on
                axes.plot(outline[:, 2], outline[:, index], color=FOUND, lw=1.2)
        axes.plot(obstacles['pz'], obstacles[f'p{across}'], '.', color=MOVER, ms=4)
        axes.set(title=f'{title}: way with 3 sigma, planes (blue), obstacles (orange)',
                 ylabel=f'{"right" if across == "x" else "down"} {across} [{unit}]')
        axes.grid(alpha=0.3)
        # What is far off may not make the way a dot.
        axes.set_xlim(_limits(rows['z'][known], size))
        axes.set_ylim(_limits(rows[across][known], size))
        axes.invert_yaxis()
    grid[1].set_xlabel(f'forward z [{unit}]')
    return figure


def _draw_ways(axes: Axes, rows: dict[str, np.ndarray], across: str):
    axes.plot(rows['z'], rows[across], '.-', color='black', lw=1, ms=3)
    for i in range(0, len(rows['z']), max(1, len(rows['z']) // ELLIPSES)):
        axes.add_patch(Ellipse((rows['z'][i], rows[across][i]), 6 * rows['sigma_z'][i],
                               6 * rows[f'sigma_{across}'][i], fc='black', alpha=0.15, ec='none'))


def _limits(values: np.ndarray, size: float) -> tuple[float, float]:
    """Return the limits of an axis on which a way of this size lies; no axis is cut too close."""
    half = 0.55 * max(np.ptp(values), size / 4, 1e-9)
    middle = (values.min() + values.max()) / 2
    return middle - half, middle + half


def _over_time(rows: dict[str, np.ndarray], obstacles: dict[str, np.ndarray],
               unit: str) -> Figure:
    figure = Figure(figsize=(11, 9), layout='constrained')
    axes = figure.subplots(5, 1, sharex=True, height_ratios=(0.5, 2, 2, 2, 2))
    stamp = rows['stamp']
    for status, colour in STATUS_COLOURS.items():
        axes[0].fill_between(stamp, 0, 1, where=rows['status'] == status, step='pre',
                             color=colour, label=status.name.lower())
    axes[0].set(yticks=[], title='tracking')
    axes[0].legend(ncols=4, fontsize=8, loc='lower right')
    for name in 'xyz':
        axes[1].plot(stamp, rows[f'sigma_{name}'], label=name)
    axes[1].set(ylabel=f'[{unit}]', title='standard deviation of the position')
    axes[1].legend(fontsize=8)
    axes[2].plot(stamp, rows['speed'], color='black')
    axes[2].set(ylabel=f'[{unit}/s]', title='speed; grey where the scale is not metric')
    axes[2].fill_between(stamp, 0, 1, where=rows['metric'] == 0, step='pre', color='#dddddd',
                         transform=axes[2].get_xaxis_transform())
    axes[3].plot(stamp, rows['vectors'], color=FOUND)
    axes[3].plot(stamp[rows['broken'] > 0], rows['vectors'][rows['broken'] > 0], 'x', color=MOVER)
    axes[3].set(ylabel='number', title='stream: vectors of each pair; crosses: broken pairs')
    axes[4].step(stamp, rows['planes'], where='post', color=FOUND, label='planes in the map')
    axes[4].step(stamp, rows['obstacles'], where='post', color=MOVER, label='obstacles')
    soon = np.isfinite(obstacles['ttc']) & (obstacles['ttc'] < 10)
    axes[4].plot(obstacles['stamp'][soon] / 1e9, obstacles['ttc'][soon], '.', color='black', ms=3,
                 label='time to contact [s]')
    axes[4].set(title='planes and obstacles', xlabel='time [s]')
    axes[4].legend(fontsize=8)
    for ax in axes[1:]:
        ax.grid(alpha=0.3)
    return figure


def _stages(summary: Mapping[str, Any]) -> Figure:
    figure = Figure(figsize=(11, 2.2), layout='constrained')
    axes, left = figure.subplots(), 0.0
    for name, seconds in summary['cpu_seconds'].items():
        if name != 'total':
            ms = 1000 * seconds / max(summary['frames'], 1)
            axes.barh(0, ms, left=left, label=f'{name} {ms:.2f}')
            left += ms
    axes.set(yticks=[], xlabel='ms of CPU a picture')
    axes.legend(ncols=5, fontsize=8, loc='lower center', bbox_to_anchor=(0.5, 1.0))
    return figure
