"""``report.html`` and ``demo.png``: what a run gave beside its truth, in one file each."""

import base64
from collections.abc import Mapping
from html import escape
from io import BytesIO
import json
from pathlib import Path
from typing import Any

from matplotlib.figure import Figure
from mv_slapse.evaluation.truth import read_truth
from mv_slapse.tools import figures as drawing
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
STYLE = """
body { font: 15px/1.5 system-ui, sans-serif; max-width: 68rem; margin: 2rem auto; padding: 0 1rem;
  color: #222 } h1 { font-size: 1.6rem } h2 { font-size: 1.15rem; margin-top: 2.2rem }
table { border-collapse: collapse } td, th { padding: .25rem .8rem; border-bottom: 1px solid #ddd;
  text-align: left } td:nth-child(2) { text-align: right; font-weight: 600; white-space: nowrap }
img { max-width: 100% } pre { background: #f5f5f5; padding: .8rem; overflow: auto;
  font-size: 12px } .legend b { padding: 0 .5em; margin-right: .3em }
"""


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
    (output / PICTURE).write_bytes(_png(drawing.overview(comparison, map_, scene, view)))
    above = _png(drawing.from_above(comparison, map_, scene))
    sections = [('From above', _image(above, 'trajectory, planes and obstacles from above')),
                ('Over time', _image(_png(drawing.over_time(comparison)), 'errors over time'))]
    if view is not None:
        labelled = _png(drawing.in_view(view[1], stamp, results))
        sections.insert(0, (f'What the camera sees at {stamp / 1e9:.2f} s',
                            _image(labelled, 'labels of macroblocks') + _legend()))
    sections += [('Figures', _table(table(figures, summary))),
                 ('Provenance', _listing({'summary': summary, 'figures': figures,
                                          'street': scene.get('settings')}))]
    (output / REPORT).write_text(_page(sections), encoding='utf-8')


def plain(value: Any) -> Any:
    """Return a value as JSON has words for it: no numpy types, no infinite numbers."""
    if isinstance(value, Mapping):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [plain(item) for item in value]
    value = value.item() if hasattr(value, 'item') else value
    return None if isinstance(value, float) and not np.isfinite(value) else value


def _filled(form: str, figures: Mapping[str, Any]) -> str:
    try:
        return form.format_map(figures)
    except (KeyError, TypeError, ValueError):   # not evaluated, or None: nothing to compare
        return '-'


def _png(figure: Figure) -> bytes:
    file = BytesIO()
    # Without the date and the version two runs give the same file.
    figure.savefig(file, format='png', metadata={'Software': None})
    return file.getvalue()


def _image(png: bytes, name: str) -> str:
    data = base64.b64encode(png).decode('ascii')
    return f'<img alt="{escape(name)}" src="data:image/png;base64,{data}">'


def _legend() -> str:
    names = ''.join(f'<b style="background:{colour}">&nbsp;</b>{label.name.lower()} &emsp;'
                    for label, colour in drawing.LABEL_COLOURS.items())
    return f'<p class="legend">{names} frames: confirmed obstacles</p>'


def _table(rows: list[tuple[str, str, str]]) -> str:
    body = ''.join('<tr>' + ''.join(f'<td>{escape(cell)}</td>' for cell in row) + '</tr>'
                   for row in rows)
    return f'<table><tr><th></th><th>result</th><th>meaning</th></tr>{body}</table>'


def _listing(content: Mapping[str, Any]) -> str:
    return f'<pre>{escape(json.dumps(plain(content), indent=1))}</pre>'


def _page(sections: list[tuple[str, str]]) -> str:
    body = '\n'.join(f'<h2>{escape(title)}</h2>\n{content}' for title, content in sections)
    head = f'<meta charset="utf-8"><title>mv_slapse</title><style>{STYLE}</style>'
    return (f'<!doctype html>\n<html lang="en"><head>{head}</head>\n<body>'
            f'<h1>mv_slapse on a rendered street</h1>\n{body}\n</body></html>\n')
