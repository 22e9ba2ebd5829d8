"""Rows of the evaluation in processes of their own, and what is kept of them."""

from dataclasses import replace
from functools import partial
import json
from shutil import copytree

from mv_slapse.config import Settings
from mv_slapse.storage.camera_info import read_camera
from mv_slapse.tools import cases, rows
from mv_slapse.tools.batch.workers import Workers
from mv_slapse.tools.run import decode, replay, run
import pytest

REFUSE = """
from mv_slapse.tools import rows

def refused(*_):
    raise rows.MvSlapseError('changed')

rows.replay = refused
"""


@pytest.fixture(scope='module')
def scenes():
    """Return a short street."""
    return cases.streets(1, 20)[:1]


@pytest.fixture(scope='module')
def cache(tmp_path_factory):
    return rows.Cache(tmp_path_factory.mktemp('cache'), 'now', 'mpeg2')


@pytest.fixture(scope='module')
def measured(scenes, cache):
    told = []
    found = rows.measure_all(scenes, cache, Workers(1), lambda *row: told.append(row))
    assert told == list(found.items())
    return found


def test_a_row_has_its_figures(measured):
    figures, = measured.values()
    assert list(measured) == ['street 0/mpeg2.mpg']
    assert figures['n_poses'] > 1
    assert figures['ate_mean_percent'] < 5
    assert figures['cpu_ms'] > 0


def test_figures_that_are_kept_are_not_measured_again(scenes, cache, measured, monkeypatch):
    case, = cache.cases(scenes[0])
    cache.figures(case).write_text(json.dumps({'n_poses': 77}))
    try:
        assert rows.measured(case, cache) == (case.name, {'n_poses': 77})
    finally:
        cache.figures(case).unlink()
    monkeypatch.setattr(rows, 'decode', None)  # the correspondences are kept as well
    again = rows.measured(case, cache)[1]
    same = measured[case.name]
    assert again | {'cpu_ms': 0} == same | {'cpu_ms': 0}


def test_other_code_is_measured_again(scenes, cache, measured):
    case, = cache.cases(scenes[0])
    other = rows.Cache(cache.folder, 'then')
    assert cache.figures(case) != other.figures(case)
    assert cache.figures(case).exists()
    assert not other.figures(case).exists()


def test_other_pictures_truth_height_or_speeds_under_one_name_are_other_figures(
        scenes, cache, measured, tmp_path):
    case, = cache.cases(scenes[0])
    copytree(case.ground_truth, tmp_path / 'truth')
    (tmp_path / 'truth' / 'movers.csv').write_text('another')
    (tmp_path / 'video').write_bytes(b'another')
    others = [replace(case, video=tmp_path / 'video'), replace(case, height=case.height + 1),
              replace(case, ground_truth=tmp_path / 'truth'), replace(case, speeds=(None,))]
    assert len({cache.figures(one) for one in [case, *others]}) == 5


def test_a_change_is_made_in_each_process(scenes, cache, measured):
    changed = rows.Cache(cache.folder, 'changed', 'mpeg2')
    workers = Workers(1, change=partial(exec, REFUSE, {}))
    found = rows.measure_all(scenes, changed, workers)
    assert found == {'street 0/mpeg2.mpg': {'error': 'changed'}}


def test_comments_and_docstrings_change_nothing(tmp_path, monkeypatch):
    monkeypatch.setattr(rows, 'PACKAGE', tmp_path)
    said = []
    for text in ('def a():\n    """Why."""\n    return 1\n', 'def a():  # so\n    """."""\n'
                 '    return 1\n', 'def a():\n    """Why."""\n    return 2\n'):
        (tmp_path / 'a.py').write_text(text)
        rows._said.cache_clear()
        said.append(rows._said(('a.py',)))
    rows._said.cache_clear()
    assert said[0] == said[1] != said[2]


def test_a_replay_writes_the_same_files_as_a_run(clip, tmp_path):
    camera, settings = read_camera(clip.camera), Settings()
    first = run(clip.video, camera, settings, tmp_path / 'run')
    second = replay(decode(clip.video, camera, settings), camera, settings, tmp_path / 'replay')
    for name in ('trajectory.tum', 'planes.csv', 'obstacles.csv', 'labels.npz'):
        assert (tmp_path / 'run' / name).read_bytes() == (tmp_path / 'replay' / name).read_bytes()
    times = {'cpu_seconds': {}}
    assert first.to_dict() | times == second.to_dict() | times
