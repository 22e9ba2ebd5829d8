import argparse
import json
import re

import cv2
from mv_slapse.evaluation import planes, trajectory
from mv_slapse.evaluation.truth import LabelTable, read_truth
from mv_slapse.simulation.street import Street, StreetSettings
from mv_slapse.simulation.truth import film
from mv_slapse.storage.tum import Trajectory
from mv_slapse.tools import demo, figures, report
from mv_slapse.tools.eval import Results
from mv_slapse.tools.plain import plain
import numpy as np
import pytest


@pytest.fixture(scope='module')
def result(tmp_path_factory):
    return demo.run(tmp_path_factory.mktemp('demo'), seed=1, quick=True)


@pytest.fixture(scope='module')
def truth(tmp_path_factory):
    folder = tmp_path_factory.mktemp('truth')
    for _ in film(Street(StreetSettings(seed=2, n_frames=4, fps=10.0)), folder):
        pass
    return read_truth(folder)


def results_of(truth, depth_error=0.0, turn=0.0, summary=None):
    """Return results that are the truth but for stated errors of the planes."""
    path, rows = truth.trajectory, []
    for k, stamp in enumerate(path.stamps):
        normals, depths = planes.in_camera(truth.planes, path.rotations()[k], path.positions[k])
        c, s = np.cos(turn), np.sin(turn)
        turned = normals @ np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]])
        rows += [(stamp, id_, *turned[id_], depths[id_] + depth_error)
                 for id_ in np.unique(truth.labels.plane[k]) if 0 <= id_ < len(truth.planes)]
    table = dict(zip(('stamp', 'id', 'nx', 'ny', 'nz', 'd'), np.array(rows).T, strict=True))
    table['stamp'] = table['stamp'].astype(np.int64)
    obstacles = {**truth.movers, 'state': np.full(len(truth.movers['id']), 'confirmed')}
    return Results(path, table, obstacles, truth.labels, summary or {'scale_status': 'metric'})


def test_the_demo_leaves_the_files_of_a_run_its_truth_and_a_report(result):
    names = {str(path.relative_to(result.output)) for path in result.output.rglob('*')}
    assert names >= {
        'trajectory.tum', 'planes.csv', 'obstacles.csv', 'labels.npz', 'map.json', 'results.mcap',
        'summary.json', 'report.html', 'demo.png', 'camera.yaml', 'video.mpg',
        'truth/ground_truth.tum', 'truth/scene.json', 'truth/movers.csv',
        'truth/truth_labels.npz'}


def test_the_demo_follows_the_camera(result):
    assert result.summary.frames == demo.N_FRAMES_QUICK
    assert not result.summary.is_lost
    assert result.figures['scale_status'] == 'metric'
    assert result.figures['ate_mean_percent'] < 1.0
    assert result.figures['ate_rigid_mean_percent'] < 3.0


def test_the_report_stands_alone_and_tells_the_figures(result):
    page = (result.output / 'report.html').read_text()
    assert not re.search(r'(src|href)="(?!data:)', page)
    assert page.count('data:image/png;base64,') == 3
    assert f'{result.figures["ate_mean_percent"]:.2f} %' in page
    assert f'demo -o {result.output}' in page


def test_the_picture_is_a_picture(result):
    picture = cv2.imread(str(result.output / 'demo.png'))
    assert picture.shape[0] > 400
    assert picture.std() > 20


def test_the_text_names_every_figure_and_where_to_look(result):
    text = demo.text(result)
    assert f'{result.figures["n_planes"]}  true planes' in text
    assert str(result.output / 'report.html') in text


def test_json_is_one_object_and_quiet_is_silent(result, monkeypatch, capsys):
    monkeypatch.setattr(demo, 'run', lambda *_: result)
    options = {'output': 'x', 'seed': 1, 'quick': True}
    assert demo.main(argparse.Namespace(**options, quiet=True, json=False)) == 0
    assert capsys.readouterr().out == ''
    assert demo.main(argparse.Namespace(**options, quiet=False, json=True)) == 0
    printed = json.loads(capsys.readouterr().out)
    assert printed['ate_mean_m'] == pytest.approx(result.figures['ate_mean_m'])


def test_a_figure_that_is_missing_or_undefined_is_a_dash():
    rows = {name: value for name, value, _ in report.table({'n_planes': 7}, {})}
    assert (rows['planes'], rows['trajectory']) == ('7', '-')
    rows = {name: value for name, value, _ in report.table({'plane_depth_error_m': None}, {})}
    assert rows['plane depth'] == '-'


def test_plain_values_are_json():
    value = {'a': np.float64(1.5), 2: (np.inf, np.int32(3)), 'b': [np.nan, 'x', None]}
    assert plain(value) == {'a': 1.5, '2': [None, 3], 'b': [None, 'x', None]}


def test_plane_errors_are_those_that_were_made(truth):
    comparison = figures.compare(results_of(truth, 0.25, 0.1), truth)
    stamps, depth, angle = figures.plane_errors(comparison)
    assert len(stamps) > 20
    np.testing.assert_allclose(depth, 0.25, atol=1e-6)
    upright = angle > 1e-3   # the ground turns about its own normal
    np.testing.assert_allclose(angle[upright], 0.1, atol=1e-3)


def test_positions_are_aligned_with_the_scale_only_where_it_is_free(truth):
    path = truth.trajectory
    half = Trajectory(path.stamps, path.positions / 2, path.quaternions)
    for status, expected in (('unknown', 0.0), ('metric', None)):
        results = results_of(truth, summary={'scale_status': status})
        results = Results(half, results.planes, results.obstacles, results.labels, results.summary)
        errors = figures.compare(results, truth).errors
        assert (errors.max() < 1e-6) == (expected is not None)
    assert trajectory.evaluate(half, path).alignment.scale == pytest.approx(2)


def test_the_liveliest_key_frame_has_most_obstacles_then_most_moving_blocks():
    labels = LabelTable(np.array([10, 20, 30]), np.zeros(2), np.zeros(2),
                        np.array([[1, 0], [1, 1], [0, 0]]), np.zeros((3, 2)))
    obstacles = {'stamp': np.array([10, 10]), 'state': np.array(['confirmed', 'tentative'])}
    results = Results(None, {}, obstacles, labels, {})
    assert figures.liveliest(results, [10, 20, 30]) == 10
    assert figures.liveliest(results, [20, 30, 40]) == 20
    assert figures.liveliest(results, [40]) is None
