"""``report.html`` and ``demo.png``: what a run gave beside its truth, in one file each."""

from collections.abc import Mapping
import json
from pathlib import Path
from typing import Any

from mv_slapse.evaluation.truth import read_truth
from mv_slapse.tools import figures as drawing
from mv_slapse.tools import page
from mv_slapse.tools.eval import read_results
import numpy as np

REPORT, PICTURE = 'report.html', 'demo.png'
ROWS = (   # name, format of figures, what it means
    ('trajectory', '{ate_mean_percent:.2f} %',
     'mean position error, similarity alignment, of {distance_m:.1f} m'),
    ('trajectory, metric', '{ate_rigid_mean_percent:.2f} %',
     'the same with the scale as found ({scale_status})'),
    ('planes', '{n_planes}', 'true planes seen in more than 3 key frames'),
    ('plane depth', '{plane_depth_error_m:.2f} m', 'mean error of an observation'),
    ('plane normal', '{plane_normal_error_deg:.1f} deg', 'mean error of an observation'),
    ('planes, purity', '{plane_observations_on_one_plane_percent:.0f} %',
     'observations that lie on one true plane'),
    ('movers', '{movers_found} of {movers_total}', 'whose macroblocks are called moving'),
    ('movers, tracked', '{movers_tracked} of {movers_trackable}', 'as confirmed obstacles'),
    ('obstacle position', '{obstacle_position_error_m:.2f} m', 'median error'),
    ('obstacle velocity', '{obstacle_velocity_error_m_s:.2f} m/s', 'median error'),
    ('time to contact', '{obstacle_ttc_error_percent:.0f} %', 'median error'),
    ('false obstacles', '{false_obstacles_per_frame:.3f}', 'confirmed, for each key frame'),
    ('false alarms', '{stationary_called_moving_percent:.2f} %',
     'stationary macroblocks called moving'),
)


def table(figures: Mapping[str, Any], summary: Mapping[str, Any]) -> list[tuple[str, str, str]]:
    """Return rows of name, result and meaning; ``-`` where a figure is missing."""
    rows = [(name, _filled(form, figures), _filled(meaning, figures))
            for name, form, meaning in ROWS]
    total = summary.get('cpu_seconds', {}).get('total', 0.0)
    per_frame = 1000 * total / max(summary.get('frames', 0), 1)
    return [*rows, ('CPU', f'{per_frame:.1f} ms', 'for each frame of the video, all stages')]


def write(output: Path, truth_folder: Path, figures: Mapping[str, Any],
          summary: Mapping[str, Any], images: Mapping[int, np.ndarray] | None = None):
    """Write the report and the picture of a folder of results.

    Parameters
    ----------
    output, truth_folder : Path
        Files of a run, and the truth as the simulator writes it.
    figures, summary : dict
        As ``eval`` and ``run`` return them.
    images : dict of stamp [ns] to (H, W) uint8, or None
        Pictures of key frames; the one that shows most is drawn with its labels.
    """
    results, truth = read_results(output), read_truth(truth_folder)
    comparison = drawing.compare(results, truth)
    map_ = json.loads((output / 'map.json').read_text())
    scene = json.loads((truth_folder / 'scene.json').read_text())
    stamp = drawing.liveliest(results, list(images or {}))
    view = None if stamp is None else (stamp, images[stamp])
    (output / PICTURE).write_bytes(page.png(drawing.overview(comparison, map_, scene, view)))
    above = page.png(drawing.from_above(comparison, map_, scene))
    errors = page.png(drawing.over_time(comparison))
    sections = [('From above', page.image(above, 'trajectory, planes and obstacles from above')),
                ('Over time', page.image(errors, 'errors over time'))]
    if view is not None:
        labelled = page.png(drawing.in_view(view[1], stamp, results))
        sections.insert(0, (f'What the camera sees at {stamp / 1e9:.2f} s',
                            page.image(labelled, 'labels of macroblocks') + _legend()))
    sections += [('Figures', page.table(table(figures, summary))),
                 ('Provenance', page.listing({'summary': summary, 'figures': figures,
                                          'street': scene.get('settings')}))]
    html = page.page('mv_slapse on a rendered street', sections)
    (output / REPORT).write_text(html, encoding='utf-8')


def _filled(form: str, figures: Mapping[str, Any]) -> str:
    try:
        return form.format_map(figures)
    except (KeyError, TypeError, ValueError):   # not evaluated, or None: nothing to compare
        return '-'


def _legend() -> str:
    names = ''.join(f'<b style="background:{colour}">&nbsp;</b>{label.name.lower()} &emsp;'
                    for label, colour in drawing.LABEL_COLOURS.items())
    return f'<p class="legend">{names} frames: confirmed obstacles</p>'
