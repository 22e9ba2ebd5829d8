"""One recording, one folder: the one of ``run``, whole, and made once."""

from dataclasses import replace
import json

from mv_slapse.errors import UnusableOutput
from mv_slapse.storage.camera_info import read_camera
from mv_slapse.tools.batch import task
from mv_slapse.tools.run import run
import pytest

WAY = 10 * 11 / 15  # m between the first picture and the twelfth: 10 m/s, 15 Hz
FILES = ('trajectory.tum', 'planes.csv', 'obstacles.csv', 'labels.npz', 'map.json', 'results.mcap')


@pytest.fixture
def item(items):
    return items[0]


def ran(item, output, call='call'):
    return task.run_recording(item, str(output), call)


def test_the_folder_is_the_one_of_run_and_is_made_once(item, place, tmp_path):
    item = replace(item, ground_truth=str(place / 'truth'), report=True)
    row = ran(item, tmp_path)
    run(item.input, read_camera(item.camera), item.settings, tmp_path / 'alone')
    out = tmp_path / item.name
    for name in FILES:
        assert (out / name).read_bytes() == (tmp_path / 'alone' / name).read_bytes(), name
    summary = json.loads((out / 'summary.json').read_text())
    assert (out / 'report.html').exists()
    assert summary['command'].startswith(f'mv_slapse run {item.input} --camera ')
    assert (row['status'], row['exit_code'], row['frames']) == ('done', 0, 12)
    assert row['poses'] == summary['poses'] > 3
    assert row['scale_source'] == 'camera height'
    assert row['way'] == pytest.approx(WAY, rel=0.03)
    assert 0 < row['epsilon_d_percent'] < 5
    stamp = (out / task.ROW).stat().st_mtime_ns
    assert ran(item, tmp_path, 'another') == row
    assert (out / task.ROW).stat().st_mtime_ns == stamp
    assert sorted(path.name for path in tmp_path.iterdir()) == ['a.mpg', 'alone']
    again = ran(replace(item, key='other'), tmp_path)
    assert again['poses'] == row['poses']
    assert (out / task.ROW).stat().st_mtime_ns > stamp
    assert not task.remains(tmp_path)


@pytest.mark.parametrize(('change', 'code', 'told'), [
    ({'input': 'none.mp4'}, 3, 'none.mp4'), ({'camera': ''}, 2, 'brings no calibration'),
    ({'camera': 'none.yaml'}, 3, 'no camera file'), ({'ground_truth': 'none.tum'}, 3, 'none.tum'),
    ({'code': 'other'}, 3, 'another version'), ({'max_frames': 1}, 3, 'no two key frames')])
def test_a_bad_recording_is_a_row_with_its_reason(item, tmp_path, change, code, told):
    row = ran(replace(item, **change), tmp_path)
    assert (row['status'], row['exit_code']) == ('failed', code)
    assert told in row['reason']
    assert json.loads((tmp_path / item.name / task.ROW).read_text())['reason'] == row['reason']


def test_a_fault_of_ours_is_a_row_too(item, tmp_path, monkeypatch):
    monkeypatch.setattr(task, 'read_camera', lambda path: 1 / 0)
    row = ran(item, tmp_path)
    assert (row['status'], row['exit_code']) == ('failed', 1)
    assert 'ZeroDivisionError' in row['reason']


def test_a_failed_one_is_tried_again_by_the_next_call_only(items, tmp_path):
    item = items[-1]
    first = ran(item, tmp_path)
    stamp = (tmp_path / item.name / task.ROW).stat().st_mtime_ns
    assert ran(item, tmp_path) == first
    assert (tmp_path / item.name / task.ROW).stat().st_mtime_ns == stamp
    assert ran(item, tmp_path, 'next')['status'] == 'failed'
    assert (tmp_path / item.name / task.ROW).stat().st_mtime_ns > stamp


def test_after_three_dead_workers_it_is_not_begun_again(item, tmp_path):
    place = tmp_path / item.name
    begun = [task._begun(place, 'call') for _ in range(task.TRIES)]
    assert None not in begun
    (begun[0] / task.ROW).unlink()  # it died that soon
    row = ran(item, tmp_path)
    assert (row['status'], row['exit_code']) == ('failed', task.DIED)
    assert '3 workers' in row['reason']
    assert ran(item, tmp_path, 'next')['status'] == 'done'


def test_who_is_first_stays(item, tmp_path):
    place = tmp_path / item.name
    first, second = (task._begun(place, 'call') for _ in range(2))
    for part, poses in ((first, 1), (second, 2)):
        task._write(part / task.ROW, {'status': 'done', 'call': 'call', 'key': item.key,
                                      'poses': poses})
    assert task._placed(first, place, item.key)['poses'] == 1
    assert task._placed(second, place, item.key)['poses'] == 1
    assert [path.name for path in tmp_path.iterdir()] == [item.name]


def test_what_is_no_run_stays_and_is_told_before_the_run_and_after(item, tmp_path, monkeypatch):
    mine = tmp_path / item.name / 'mine.txt'
    mine.parent.mkdir()
    mine.touch()
    monkeypatch.setattr(task, '_row', None)
    with pytest.raises(UnusableOutput, match='no run of a batch'):
        ran(item, tmp_path)
    part = task._begun(mine.parent, 'call')
    with pytest.raises(UnusableOutput, match='no run of a batch'):
        task._placed(part, mine.parent, item.key)
    assert mine.exists()


def test_most_key_frames_without_a_pose_is_lost(item, tmp_path, monkeypatch):
    monkeypatch.setattr('mv_slapse.tools.run_summary.SHARE_OF_POSES', 1.1)
    row = ran(item, tmp_path)
    assert (row['status'], row['exit_code']) == ('lost', 4)
    assert 'tracking was lost' in row['reason']
    assert ran(item, tmp_path, 'next') == row
