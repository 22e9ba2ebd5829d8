"""``mv_slapse batch`` as a user calls it, on processes of its own and on somebody's scheduler."""

import csv
import importlib.util
import json
import os
from pathlib import Path
import shutil
import signal
import subprocess
import sys
import time

from mv_slapse.tools.batch import page
from mv_slapse.tools.batch.workers import UnusableCluster
import pytest

pytest.importorskip('distributed')


@pytest.fixture
def table(clip, tmp_path):
    """Return a table of three runs of a clip, the second of which is broken."""
    shutil.copy(clip.video, tmp_path / 'a.mpg')
    (tmp_path / 'b.mp4').write_text('no video')
    path = tmp_path / 'fleet.csv'
    path.write_text('input,camera,camera_height,ground_truth,max_frames,name\n'
                    f'a.mpg,{clip.camera},1.65,{clip.truth},,all\n'
                    f'b.mp4,{clip.camera},,,,broken\n'
                    f'a.mpg,{clip.camera},,,9,short <i>\n')
    return path


def rows(out):
    with (out / 'batch.csv').open(newline='') as file:
        return {row['name']: row for row in csv.DictReader(file)}


def test_a_table_is_run_once_and_told(call, table, tmp_path, monkeypatch):
    out = tmp_path / 'out'
    code, text, err = call('batch', table, '-o', out, '--workers', 1)
    assert (code, err) == (5, '')
    assert '3 recordings: 2 done, 1 failed' in text
    assert 'broken: failed (exit code 3): ' in text
    found = rows(out)
    assert list(found) == ['all', 'broken', 'short-i']
    assert [row['exit_code'] for row in found.values()] == ['0', '3', '0']
    assert 0 < float(found['all']['epsilon_d_percent']) < 5
    assert found['all']['scale_source'] == 'camera height'
    assert found['short-i']['frames'] == '9'
    assert 'cannot be opened' in found['broken']['reason']
    text = (out / page.PAGE).read_text()
    assert text.count('<tr class="done">') == 2
    assert text.count('<img ') == len([*page.SHOWN]) + 2
    assert '://' not in text.replace(found['all']['worker'], '').replace(
        found['broken']['worker'], '')
    (tmp_path / 'b.mp4').unlink()
    shutil.copy(tmp_path / 'a.mpg', tmp_path / 'b.mp4')
    before = {name: (out / name / 'row.json').stat().st_mtime_ns for name in ('all', 'short-i')}
    code, text, err = call('batch', table, '-o', out, '--workers', 2, '--json')
    assert (code, err) == (0, '')
    content = json.loads(text)
    assert [row['status'] for row in content['rows']] == ['done'] * 3
    assert before == {name: (out / name / 'row.json').stat().st_mtime_ns for name in before}
    # there is nothing left to run
    monkeypatch.setattr('mv_slapse.tools.batch_command.open_pool', None)
    assert call('batch', table, '-o', out, '--quiet') == (0, '', '')


@pytest.mark.parametrize('given', ['fleet.csv', 'a.mpg', '*.mp*'])
def test_recordings_are_not_replaced_by_their_results(call, table, monkeypatch, given):
    monkeypatch.chdir(table.parent)
    table.write_text('input\na.mpg\nb.mp4\n')
    before = {path: path.read_bytes() for path in table.parent.iterdir()}
    code, _, err = call('batch', given, '-o', '.')
    assert code == 2
    assert 'choose another folder with -o' in err
    assert {path: path.read_bytes() for path in table.parent.iterdir()} == before


def test_a_name_that_is_no_utf_8_costs_nobody_the_table(clip, tmp_path):
    name = os.fsdecode(b'stra\xdfe')
    (tmp_path / 'in').mkdir()
    shutil.copy(clip.video, tmp_path / 'in' / f'{name}.mpg')
    (tmp_path / 'in' / f'{name}.mp4').write_text('no video')
    out = tmp_path / 'out'
    done = run_alone('batch', tmp_path / 'in', '--camera', clip.camera, '-o', out, '--workers', 1)
    text, err = done.communicate(timeout=60)
    assert (done.returncode, err) == (5, '')
    assert 'stra\\udcdfe.mp4 ' in text
    assert '2 recordings: 1 done, 1 failed' in text
    assert {row['input']: row['status'] for row in rows(out).values()} == {
        f'{tmp_path}/in/stra\\udcdfe.mpg': 'done', f'{tmp_path}/in/stra\\udcdfe.mp4': 'failed'}
    assert 'stra\\udcdfe.mpg' in (out / page.PAGE).read_text()


def test_it_takes_the_cores_that_its_container_has(call, table, tmp_path, monkeypatch):
    asked = []

    def open_pool(workers):
        asked.append(workers.count)
        raise UnusableCluster('that is enough')

    monkeypatch.setattr('dask.system.CPU_COUNT', 1)
    monkeypatch.setattr('mv_slapse.tools.batch_command.open_pool', open_pool)
    assert call('batch', table, '-o', tmp_path / 'out')[0] == 3
    assert asked == [1]


def test_without_dask_it_says_what_to_install(call, clip, tmp_path, monkeypatch):
    find = importlib.util.find_spec
    monkeypatch.setattr(importlib.util, 'find_spec',
                        lambda name, *more: None if name == 'dask' else find(name, *more))
    code, _, err = call('batch', clip.video, '-o', tmp_path / 'out')
    assert code == 3
    assert "dask is not installed, which shares the work out; install it with: pip install " \
        "'dask>=2024.8'" in err
    assert not (tmp_path / 'out').exists()


@pytest.fixture
def scheduler(tmp_path):
    """Start a scheduler and a worker by hand; return its address and process."""
    file = tmp_path / 'scheduler.json'
    commands = (['scheduler', '--port', '0', '--no-dashboard', '--scheduler-file', file],
                ['worker', '--nthreads', '1', '--no-dashboard', '--scheduler-file', file])
    processes = [subprocess.Popen([sys.executable, '-m', 'dask', *command, '--host', '127.0.0.1'],
                                  stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
                 for command in commands]
    end = time.monotonic() + 60
    while not file.exists():
        assert time.monotonic() < end
        time.sleep(0.05)
    yield json.loads(file.read_text())['address'], processes[0]
    for process in processes:
        process.kill()
        process.wait()


def test_a_scheduler_of_somebody_does_the_same_until_it_is_lost(call, table, clip, scheduler,
                                                               tmp_path, monkeypatch):
    address, process = scheduler
    out = tmp_path / 'out'
    code, text, err = call('batch', table, '-o', out, '--scheduler', address,
                          '--no-report')
    assert (code, err) == (5, '')
    for name in ('trajectory.tum', 'planes.csv', 'obstacles.csv', 'labels.npz'):
        assert (out / 'all' / name).read_bytes() == (clip.out / name).read_bytes()
    run_all = _lost_after_one(process)
    monkeypatch.setattr('mv_slapse.tools.batch_command.scheduling.run_all', run_all)
    # so that it is asked, too, how many workers there are, as on a busy machine
    monkeypatch.setattr('mv_slapse.tools.batch.workers.RECENT', 0.0)
    code, text, err = call('batch', table, '-o', tmp_path / 'lost', '--scheduler', address,
                          '--no-report')
    assert code == 3
    assert 'is lost; what was done is whole, and the same call goes on' in err
    statuses = [row['status'] for row in rows(tmp_path / 'lost').values()]
    assert 'not run' in statuses
    whole = [path for path in (tmp_path / 'lost').iterdir()
             if path.is_dir() and path.suffix != '.part']
    assert whole
    assert all((path / 'row.json').exists() for path in whole)


def _lost_after_one(process):
    """Return ``run_all``, during which the scheduler ends after the first row."""
    from mv_slapse.tools.batch import scheduling
    given = scheduling.run_all

    def run_all(items, output, pool):
        found = given(items, output, pool)
        yield next(found)
        process.kill()
        process.wait()
        yield from found

    return run_all


def _hears_ctrl_c():
    # A shell's background job, such as a test run may be, starts with it ignored.
    signal.signal(signal.SIGINT, signal.SIG_DFL)


def run_alone(*arguments):
    """Start the command in a process of its own."""
    paths = str(Path(__file__).resolve().parents[2]), os.environ.get('PYTHONPATH', '')
    return subprocess.Popen([sys.executable, '-m', 'mv_slapse', *map(str, arguments)],
                            stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
                            preexec_fn=_hears_ctrl_c,
                            env={**os.environ, 'PYTHONPATH': os.pathsep.join(paths),
                                 'PYTHONIOENCODING': 'utf-8:strict'})


def test_what_is_interrupted_goes_on(table, tmp_path):
    out = tmp_path / 'out'
    process = run_alone('batch', table, '-o', out, '--workers', 1, '--no-report',
                        '--sweep', 'extraction.seed=' + ','.join(map(str, range(20))))
    end = time.monotonic() + 120
    while not list(out.glob('all,seed=*[0-9]/row.json')):
        assert process.poll() is None
        assert time.monotonic() < end
        time.sleep(0.02)
    process.send_signal(signal.SIGINT)
    err = process.communicate(timeout=60)[1]
    assert process.returncode == 130, err
    assert 'interrupted; what is done is whole' in err
    found = rows(out)
    assert len(found) == 60
    done = {name for name, row in found.items() if row['status'] == 'done'}
    assert done
    assert done <= {path.parent.name for path in out.glob('*/summary.json')}
    assert sum(row['status'] == 'not run' for row in found.values()) > 5
