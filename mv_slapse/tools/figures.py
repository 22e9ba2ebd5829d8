"""Pictures of a run beside its truth: from above, over time, and in the camera's view."""

from dataclasses import dataclass
from typing import Any

from matplotlib.axes import Axes
from matplotlib.collections import PatchCollection
from matplotlib.figure import Figure
from matplotlib.patches import Polygon, Rectangle
from mv_slapse.evaluation import detection, planes, trajectory
from mv_slapse.evaluation.truth import LabelTable, Truth
from mv_slapse.geometry.blocks import MACROBLOCK
from mv_slapse.records import Label
from mv_slapse.tools.eval import Results
import numpy as np

TRUE, FOUND, MOVER, CALM = '#8c8c8c', '#0072b2', '#d55e00', '#009e73'   # told apart by everybody
LABEL_COLOURS = {Label.STATIONARY: CALM, Label.MOVING: MOVER, Label.INFINITY: '#56b4e9'}
WIDE = 45.0   # farther to the side nothing is drawn [m]
NEAR, AHEAD = 60.0, 30.0   # ranges beyond are cut; drawn past the last pose [m]


@dataclass(frozen=True)
class Comparison:
    """Results and truth in one frame and unit.

    Attributes
    ----------
    results, truth : Results, Truth
    alignment : trajectory.Similarity
        Of the estimate onto the truth; with metric scale its scale is 1.
    positions, errors : (N, 3), (N,)
        Aligned camera positions [m] and their distances to the true ones [m].
    stamps : (N,) int64
        Of both [ns].
    """

    results: Results
    truth: Truth
    alignment: trajectory.Similarity
    positions: np.ndarray
    errors: np.ndarray
    stamps: np.ndarray


def compare(results: Results, truth: Truth) -> Comparison:
    """Return results aligned with their truth."""
    score = trajectory.evaluate(results.trajectory, truth.trajectory)
    index, _ = trajectory.associate(results.trajectory.stamps, truth.trajectory.stamps)
    alignment = score.rigid if results.is_metric else score.alignment
    errors = score.ate_rigid if results.is_metric else score.ate
    positions = alignment.apply(results.trajectory.positions[index])
    return Comparison(results, truth, alignment, positions, errors,
                      results.trajectory.stamps[index])


def overview(comparison: Comparison, map_: dict[str, Any], scene: dict[str, Any],
             view: tuple[int, np.ndarray] | None) -> Figure:
    """Draw all on one page; ``view`` is a key frame's stamp [ns] and picture (H, W)."""
    figure = Figure(figsize=(11, 8.2), layout='constrained')
    grid = figure.add_gridspec(2, 2, width_ratios=(1.25, 1), height_ratios=(1.1, 1))
    if view is not None:
        axes = figure.add_subplot(grid[0, 0])
        _draw_view(axes, *view, comparison.results)
        axes.set_title(f'macroblocks at {view[0] / 1e9:.2f} s: green stationary, orange moving, '
                       'blue at infinity', fontsize=9)
    _draw_ranges(figure.add_subplot(grid[0, 1]), comparison)
    _draw_above(figure.add_subplot(grid[1, :]), comparison, map_, scene)
    return figure


def way_and_error(comparison: Comparison) -> Figure:
    """Draw the aligned way over the true one from above, and the position's error over time."""
    figure = Figure(figsize=(8, 8), layout='constrained')
    above, error = figure.subplots(2, 1, height_ratios=(3, 1))
    true, found = comparison.truth.trajectory.positions, comparison.positions
    above.plot(true[:, 0], true[:, 2], color=TRUE, lw=4, label='true')
    above.plot(found[:, 0], found[:, 2], color='black', lw=1, label='found, aligned')
    above.set(xlabel='right x [m]', ylabel='forward z [m]', aspect='equal')
    above.set_adjustable('datalim')
    error.plot(comparison.stamps / 1e9, comparison.errors, color='black')
    error.set(xlabel='time [s]', ylabel='error of the position [m]')
    error.set_ylim(bottom=0)
    for axes in (above, error):
        axes.grid(alpha=0.3)
    _legend(above)
    return figure


def from_above(comparison: Comparison, map_: dict[str, Any], scene: dict[str, Any]) -> Figure:
    """Draw trajectory, planes and obstacles from above, with their truth in grey."""
    figure = Figure(figsize=(11, 4.6), layout='constrained')
    _draw_above(figure.add_subplot(), comparison, map_, scene)
    return figure


def over_time(comparison: Comparison) -> Figure:
    """Draw the errors of position and planes and the range of every mover over time."""
    figure = Figure(figsize=(11, 6), layout='constrained')
    axes = figure.subplots(2, 2, sharex=True).ravel()
    axes[0].plot(comparison.stamps / 1e9, comparison.errors, '.-', color='black')
    axes[0].set(ylabel='[m]', title='camera position, error')
    axes[0].set_ylim(bottom=0)
    stamps, depth, angle = plane_errors(comparison)
    for ax, errors, unit, name in ((axes[1], depth, '[m]', 'depth'),
                                   (axes[2], np.degrees(angle), '[deg]', 'normal')):
        ax.plot(stamps / 1e9, errors, '.', color=FOUND, ms=4)
        ax.set(ylabel=unit, title=f'planes, error of the {name}, one dot an observation')
        ax.set_ylim(0, max(1.0, 1.2 * np.percentile(errors, 98)) if len(errors) else 1)
    _draw_ranges(axes[3], comparison)
    for ax in axes:
        ax.grid(alpha=0.3)
        ax.set_xlabel('time [s]')
    return figure


def in_view(image: np.ndarray, stamp: int, results: Results) -> Figure:
    """Draw the labels of the macroblocks and the obstacles' boxes over a key frame's picture."""
    figure = Figure(figsize=(image.shape[1] / 100, image.shape[0] / 100), dpi=150)
    _draw_view(figure.add_axes((0, 0, 1, 1)), stamp, image, results)
    return figure


def liveliest(results: Results, stamps: list[int]) -> int | None:
    """Return the stamp, of those given, of the key frame that shows most: obstacles, labels."""
    confirmed = detection.confirmed(results.obstacles)['stamp']
    known = [stamp for stamp in stamps if stamp in results.labels.stamps]
    moving = {stamp: int(np.sum(results.labels.label[results.labels.stamps == stamp] ==
                                Label.MOVING)) for stamp in known}
    return max(known, key=lambda s: (np.sum(confirmed == s), moving[s]), default=None)


def plane_errors(comparison: Comparison) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return stamps [ns] and errors of depth [m] and normal [rad] of the observed planes.

    Each is compared with the true plane that most of its macroblocks show; those that show none
    are left out.
    """
    truth, table = comparison.truth, comparison.results.planes
    if not truth.planes or truth.labels is None:
        return np.zeros(0), np.zeros(0), np.zeros(0)
    shares = np.nan_to_num(planes.plane_shares(table, truth.planes, comparison.results.labels,
                                               truth.labels))
    index = {stamp: k for k, stamp in enumerate(truth.trajectory.stamps)}
    rotations = truth.trajectory.rotations()
    found = []
    for i in np.flatnonzero(shares.max(axis=1, initial=0) > 0):
        k = index.get(table['stamp'][i])
        if k is None:
            continue
        normals, depths = planes.in_camera(truth.planes, rotations[k],
                                           truth.trajectory.positions[k])
        best = shares[i].argmax()
        cosine = normals[best] @ [table[name][i] for name in ('nx', 'ny', 'nz')]
        found.append((table['stamp'][i], abs(comparison.alignment.scale * table['d'][i] -
                                             depths[best]), np.arccos(np.clip(cosine, -1, 1))))
    stamps, depth, angle = np.array(found, float).reshape(-1, 3).T
    return stamps, depth, angle


def _draw_view(axes: Axes, stamp: int, image: np.ndarray, results: Results):
    height, width = image.shape
    axes.imshow(image, cmap='gray', vmin=0, vmax=255,
                extent=(-0.5, width - 0.5, height - 0.5, -0.5))
    row = int(np.flatnonzero(results.labels.stamps == stamp)[0])
    for label, colour in LABEL_COLOURS.items():
        axes.add_collection(_blocks(results.labels, row, label, colour))
    obstacles = detection.confirmed(results.obstacles)
    for x, y, w, h in detection.boxes(obstacles)[obstacles['stamp'] == stamp]:
        axes.add_patch(Rectangle((x, y), w, h, fill=False, ec=MOVER, lw=2))
    axes.set_axis_off()


def _draw_above(axes: Axes, comparison: Comparison, map_: dict[str, Any], scene: dict[str, Any]):
    for plane in scene['planes']:
        for part in plane.get('parts', [plane['polygon']]):
            _draw_wall(axes, plane['normal'], np.array(part), TRUE, 4, 'true plane')
    for plane in map_['planes']:
        if len(plane['outline']) and not plane['is_ground']:
            outline = comparison.alignment.apply(np.array(plane['outline']))
            normal = comparison.alignment.R @ np.array(plane['normal'])
            _draw_wall(axes, normal, outline, FOUND, 1.6, 'plane found')
    _draw_cars(axes, comparison)
    path = comparison.truth.trajectory.positions
    axes.plot(path[:, 2], path[:, 0], color=TRUE, lw=4, label='true trajectory')
    axes.plot(comparison.positions[:, 2], comparison.positions[:, 0], '.-', color='black', lw=1,
              ms=4, label='trajectory found')
    low, high = path[:, 2].min() - 5, path[:, 2].max() + AHEAD
    side = np.clip(np.array([path[:, 0].min() - 16, path[:, 0].max() + 18]), -WIDE, WIDE)
    axes.set(xlim=(low, high), ylim=side[::-1], aspect='equal', xlabel='forward z [m]',
             ylabel='right x [m]')
    _legend(axes, loc='upper right', ncols=3)


def _draw_wall(axes: Axes, normal: Any, outline: np.ndarray, colour: str, width: float,
               name: str):
    """Draw an upright plane as the line on which it stands."""
    if abs(normal[1]) > 0.5:
        return
    along = np.array([normal[2], -normal[0]])
    position = outline[:, [0, 2]] @ along
    ends = outline[[position.argmin(), position.argmax()]]
    axes.plot(ends[:, 2], ends[:, 0], color=colour, lw=width, solid_capstyle='butt', label=name)


def _draw_cars(axes: Axes, comparison: Comparison):
    """Draw the ways of movers and of confirmed obstacles."""
    movers = comparison.truth.movers
    if movers is not None:
        for id_ in np.unique(movers['id']):
            row = movers['id'] == id_
            axes.plot(movers['pz'][row], movers['px'][row], color=MOVER, alpha=0.3, lw=5,
                      label='true mover')
    found = detection.confirmed(comparison.results.obstacles)
    position = comparison.alignment.apply(np.c_[found['px'], found['py'], found['pz']])
    if len(position):
        axes.plot(position[:, 2], position[:, 0], '.', color=MOVER, ms=4,
                  label='obstacle confirmed')


def _draw_ranges(axes: Axes, comparison: Comparison):
    """Draw how far the movers are, and how far the confirmed obstacles are said to be."""
    axes.set(ylabel='[m]', xlabel='time [s]')
    axes.set_title('range of movers (lines) and confirmed obstacles (dots)', fontsize=9)
    movers = comparison.truth.movers
    if movers is None:
        return
    for id_ in np.unique(movers['id']):
        row = movers['id'] == id_
        axes.plot(movers['stamp'][row] / 1e9, _range(movers, comparison.truth.trajectory, row),
                  color=TRUE, lw=2)
    found = detection.confirmed(comparison.results.obstacles)
    rows = np.isin(found['stamp'], comparison.results.trajectory.stamps)
    if rows.any():
        axes.scatter(found['stamp'][rows] / 1e9, comparison.alignment.scale *
                     _range(found, comparison.results.trajectory, rows), s=8, c=found['id'][rows],
                     cmap='tab10')
    axes.set_ylim(0, NEAR)


def _range(table: detection.Table, path: trajectory.Trajectory, rows: np.ndarray) -> np.ndarray:
    """Return the distances between things at some rows and the camera at the same stamps."""
    camera = path.positions[np.searchsorted(path.stamps, table['stamp'][rows])]
    return np.linalg.norm(np.c_[table['px'], table['py'], table['pz']][rows] - camera, axis=1)


def _blocks(labels: LabelTable, row: int, label: Label, colour: str) -> PatchCollection:
    """Return the macroblocks of a label as patches."""
    corner = np.c_[labels.x, labels.y][labels.label[row] == label] - MACROBLOCK / 2
    square = MACROBLOCK * np.array([[0, 0], [1, 0], [1, 1], [0, 1]])
    return PatchCollection([Polygon(at + square) for at in corner], fc=colour, ec='none',
                           alpha=0.45 if label == Label.MOVING else 0.22)


def _legend(axes: Axes, **options: Any):
    """Name every kind of line once."""
    named = dict(zip(*reversed(axes.get_legend_handles_labels()), strict=True))
    axes.legend(named.values(), named.keys(), fontsize=8, **options)
