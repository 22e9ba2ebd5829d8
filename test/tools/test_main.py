from dataclasses import replace
import json
import os
import re
import subprocess
import sys

from conftest import ROOT
from mv_slapse.codec.encoding.encoder import write_video
from mv_slapse.simulation.wheels import drawn_speeds
from mv_slapse.storage.bag_reader import BagReader
from mv_slapse.storage.tables import read_speeds, write_speeds
from mv_slapse.storage.tum import read_trajectory
from mv_slapse.tools import main as command_line
from mv_slapse.tools import run
from mv_slapse.tools.run_summary import Summary
import numpy as np
import pytest

CAMERA = """image_width: 480
image_height: 352
camera_matrix: {rows: 3, cols: 3, data: [375.0, 0, 240, 0, 375.0, 176, 0, 0, 1]}
distortion_model: plumb_bob
distortion_coefficients: {rows: 1, cols: 5, data: [0, 0, 0, 0, 0]}
"""


def test_run_and_eval_work_together(call, clip, tmp_path):
    code, out, err = call('run', clip.video, '--camera', clip.camera, '--camera-height', 1.65,
                          '-o', tmp_path, '--max-frames', 13, '--json')
    summary = json.loads(out)
    assert (code, err, summary['frames']) == (0, '', 13)
    assert summary['command'].startswith('mv_slapse run ')
    assert summary['settings']['scene']['camera_height'] == 1.65
    code, out, err = call('eval', tmp_path, '--ground-truth', clip.truth, '--json')
    assert (code, err) == (0, '')
    assert json.loads(out)['n_poses'] == summary['poses']


def test_run_reports_on_the_terminal_unless_told_to_be_quiet(call, clip, tmp_path):
    arguments = ['run', clip.video, '--camera', clip.camera, '-o', tmp_path, '--max-frames', 9]
    code, out, err = call(*arguments)
    assert code == 0
    assert '9 frames' in out
    assert f'results in {tmp_path}' in out
    assert call(*arguments, '--quiet') == (0, '', '')


def test_no_other_run_begins_before_the_report_is_written(call, clip, tmp_path, monkeypatch):
    from mv_slapse.tools import run_report
    arguments = ['run', clip.video, '--camera', clip.camera, '-o', tmp_path, '--max-frames', 9]
    monkeypatch.setattr(run_report, 'write', lambda *_: codes.append(
        call(*arguments, '--no-report')[0]))
    codes = []
    assert call(*arguments)[0] == 0
    assert codes == [2]


def test_settings_come_from_file_and_command_line(call, clip, tmp_path):
    (tmp_path / 's.yaml').write_text('extraction: {min_macroblocks: 25, seed: 1}')
    _, out, _ = call('run', clip.video, '--camera', clip.camera, '-o', tmp_path / 'o', '--json',
                     '--max-frames', 5, '--settings', tmp_path / 's.yaml',
                     '--set', 'extraction.seed=2')
    extraction = json.loads(out)['settings']['extraction']
    assert (extraction['min_macroblocks'], extraction['seed']) == (25, 2)


@pytest.fixture
def wheels(clip, tmp_path):
    """Return a table of the true speed."""
    truth = read_trajectory(clip.truth / 'ground_truth.tum')
    write_speeds(tmp_path / 'wheels.csv', drawn_speeds(truth, 0, 0.0))
    return tmp_path / 'wheels.csv'


def test_a_speed_makes_the_scale_metric(call, clip, wheels, tmp_path):
    code, out, err = call('run', clip.video, '--camera', clip.camera, '--speed', wheels,
                          '-o', tmp_path / 'out', '--json')
    summary = json.loads(out)
    assert (code, err, summary['warnings']) == (0, '', [])
    assert (summary['scale_status'], summary['scale_source']) == ('metric', 'speed')
    _, out, _ = call('eval', tmp_path / 'out', '--ground-truth', clip.truth, '--json')
    assert json.loads(out)['scale'] == pytest.approx(1, abs=0.02)


@pytest.mark.parametrize(('option', 'name'), [
    ('--camera', 'map.json'), ('--speed', 'planes.csv'), ('--settings', 'summary.json')])
def test_a_run_replaces_no_file_that_it_reads(call, clip, wheels, tmp_path, option, name):
    given = {'--camera': clip.camera, '--speed': wheels, '--settings': tmp_path / 's.yaml'}
    given['--settings'].write_text('scene: {camera_height: 1.65}')
    text = given[option].read_text()
    given[option] = tmp_path / name
    given[option].write_text(text)
    code, _, err = call('run', clip.video, '-o', tmp_path, *(x for pair in given.items()
                                                             for x in pair))
    assert code == 2
    assert f'{name} is where the results of this run go' in err
    assert given[option].read_text() == text


def test_speeds_of_another_clock_are_not_used_and_it_is_said(call, clip, wheels, tmp_path):
    late = [replace(speed, stamp=speed.stamp + 10**12) for speed in read_speeds(wheels)]
    write_speeds(wheels, late)
    code, out, _ = call('run', clip.video, '--camera', clip.camera, '--speed', wheels,
                        '-o', tmp_path / 'out', '--json')
    summary = json.loads(out)
    assert (code, summary['scale_status']) == (0, 'unknown')
    assert 'both must be of one clock' in summary['warnings'][0]


def test_inspect_prints_one_object(call, clip):
    code, out, _ = call('inspect', clip.video, '--json')
    assert code == 0
    assert json.loads(out)['codec'] == 'mpeg2video'


@pytest.mark.parametrize(('given', 'start'), [(['--start', 5], 5), ([], 1)])
def test_bag_makes_one_that_run_takes(call, clip, tmp_path, given, start):
    truth = clip.truth / 'ground_truth.tum'
    code, out, _ = call('bag', clip.video, '--camera', clip.camera, '--ground-truth', truth,
                        '-o', tmp_path / 'bag', '--max-frames', 9, *given)
    assert code == 0
    assert '9 packets' in out
    reader = BagReader(tmp_path / 'bag')
    assert min(packet.stamp for packet in reader.packets(reader.video_topic())) == start * 10**9
    code, out, _ = call('run', tmp_path / 'bag', '-o', tmp_path / 'out', '--json')
    assert code == 0
    assert json.loads(out)['first_stamp'] == start
    assert call('eval', tmp_path / 'out', '--ground-truth', truth,
                '--stamp-offset', start)[0] == 0


def test_a_lost_run_ends_with_4(call, clip, tmp_path, monkeypatch):
    def lost(*_, **__):
        return Summary('a.mp4', key_frames=9, poses=2, reasons={'fog': 7},
                       cpu_seconds={'total': 0.0})

    monkeypatch.setattr(run, 'run', lost)
    code, out, err = call('run', clip.video, '--camera', clip.camera, '-o', tmp_path, '--json',
                          '--no-report')
    assert code == 4
    assert json.loads(out)['poses'] == 2
    assert 'fog' in err


def test_noise_is_never_given_a_pose_in_silence(call, tmp_path):
    pictures = np.random.default_rng(0).integers(0, 256, (12, 352, 480), np.uint8)
    write_video(tmp_path / 'noise.mpg', pictures, 25.0)
    (tmp_path / 'camera.yaml').write_text(CAMERA)
    code, _, err = call('run', tmp_path / 'noise.mpg', '--camera', tmp_path / 'camera.yaml',
                        '-o', tmp_path / 'out', '--quiet')
    assert code in (3, 4)
    assert 'mv_slapse' in err


BAD_INPUT = [
    (['run', '{tmp}/none.mp4', '--camera', '{camera}'], 3, 'none.mp4: no such file'),
    (['run', '{tmp}', '--camera', '{camera}'], 3, 'no pictures there'),
    (['run', '{camera}', '--camera', '{camera}'], 3, 'cannot be opened as a video'),
    (['run', '{video}', '--camera', '{tmp}/none.yaml'], 3, 'no camera file'),
    (['run', '{video}', '--camera', '{video}'], 3, 'cannot be read as a camera file'),
    (['run', '{video}', '--camera', '{tmp}/uncalibrated.yaml'], 3, 'not calibrated'),
    (['run', '{video}', '--camera', '{tmp}/other.yaml'], 3, '480x352.*641x352'),
    (['run', '{video}'], 2, 'give one with --camera'),
    (['run', '{video}', '--camera', '{camera}', '--topic', '/a'], 2, 'is not a bag'),
    (['run', '{video}', '--camera', '{camera}', '--speed', '/odom'], 2, 'no such file; give a t'),
    (['run', '{video}', '--camera', '{camera}', '--speed', '{camera}'], 3, 'no column stamp'),
    (['run', '{video}', '--camera', '{camera}', '--set', 'a.b=1'], 2, 'no setting a.b'),
    (['run', '{video}', '--camera', '{camera}', '--settings', '{tmp}/none'], 2, 'settings file'),
    (['run', '{video}', '--camera', '{camera}', '-o', '{camera}/a'], 2, 'cannot be written'),
    (['run', 'gopher://a/b', '--camera', '{camera}'], 3, 'protocol not allowed'),
    (['eval', '{tmp}', '--ground-truth', '{truth}'], 3, 'not a folder of results'),
    (['eval', '{out}'], 2, 'nothing to compare with'),
    (['eval', '{out}', '--ground-truth', '{tmp}/none'], 3, 'cannot be read as a trajectory'),
    (['eval', '{out}', '--ground-truth', '{video}'], 3, 'as a trajectory'),
    (['inspect', '{tmp}/none.mp4'], 3, 'no such file'),
    (['inspect', '{camera}'], 3, 'cannot be opened as a video'),
    (['bag', '{video}', '--camera', '{camera}', '-o', '{out}'], 2, 'exists already'),
    (['bag', '{tmp}/none.mp4', '--camera', '{camera}', '-o', '{tmp}/b'], 3, 'no such file')]


@pytest.mark.parametrize(('arguments', 'code', 'message'), BAD_INPUT,
                         ids=[f'{a[0]}-{m}' for a, _, m in BAD_INPUT])
def test_bad_input_is_named_without_a_traceback(call, clip, tmp_path, arguments, code, message):
    (tmp_path / 'uncalibrated.yaml').write_text(CAMERA.replace('375.0', '0.0'))
    (tmp_path / 'other.yaml').write_text(CAMERA.replace('480', '641'))
    names = {**{name: str(path) for name, path in vars(clip).items()}, 'tmp': str(tmp_path)}
    found, out, err = call(*(argument.format(**names) for argument in arguments), *(
        ['-o', tmp_path / 'results'] if arguments[0] == 'run' and '-o' not in arguments else []))
    assert found == code
    assert out == ''
    assert err.startswith(f'mv_slapse {arguments[0]}: ')
    assert 'Traceback' not in err
    assert len(err.splitlines()) <= 3
    assert re.search(message, err), err


def test_an_error_is_an_object_where_one_is_asked_for(call, tmp_path):
    code, out, err = call('inspect', tmp_path / 'none.mp4', '--json')
    assert code == 3
    assert json.loads(out) == {'error': err.split(': ', 1)[1].strip(), 'exit_code': 3}


def test_one_object_is_printed_where_a_plot_has_no_truth(call, clip, tmp_path):
    (tmp_path / 'boxes.csv').write_text('frame,x,y,width,height\n')
    code, out, _ = call('eval', clip.out, '--boxes', tmp_path / 'boxes.csv', '--json',
                        '--plot', tmp_path / 'a.png')
    assert code == 2
    assert '--plot needs a true trajectory' in json.loads(out)['error']


def test_wrong_usage_is_an_object_where_one_is_asked_for(capsys):
    with pytest.raises(SystemExit):
        command_line.main(['run', '--json'])
    assert json.loads(capsys.readouterr().out)['exit_code'] == 2


def test_undefined_numbers_are_null_in_json(call, clip, monkeypatch):
    from mv_slapse.tools import eval as evaluation
    monkeypatch.setattr(evaluation, 'evaluate', lambda *_: {
        'a': float('nan'), 'b': [np.float64('inf'), np.int64(3)], 'c': np.float32(0.5)})
    _, out, _ = call('eval', clip.out, '--json')
    assert json.loads(out) == {'a': None, 'b': [None, 3], 'c': 0.5}


def test_a_fault_of_the_program_is_told_apart_and_can_be_traced(call, clip, monkeypatch):
    from mv_slapse.tools import eval as evaluation

    def broken(*_):
        raise ZeroDivisionError('somewhere')

    monkeypatch.setattr(evaluation, 'evaluate', broken)
    code, _, err = call('eval', clip.out)
    assert code == 1
    assert 'a fault of mv_slapse: ZeroDivisionError: somewhere; run again with --debug' in err
    with pytest.raises(ZeroDivisionError):
        call('eval', clip.out, '--debug')


BAG = ['bag', 'a', '--camera', 'b', '-o', 'c']


@pytest.mark.parametrize('arguments', [[], ['fly'], ['run'], ['run', 'a', '--max-frames', '0'],
                                       ['run', 'a', '--max-frames', '9' * 20],
                                       [*BAG, '--start', '1e12'], [*BAG, '--start', '-5'],
                                       [*BAG, '--start', 'nan'],
                                       ['run', 'a', '-o', ''], ['batch', 'a', '-o', ''],
                                       ['demo', '-o', ''],
                                       ['run', 'a', '--camera-height', '-1'],
                                       ['run', 'a', '--camera-height', 'tall'],
                                       ['run', 'a', '--camera-height', 'nan'],
                                       ['eval', 'a', '--fps', 'nan'], ['eval', 'a', '--fps', '0'],
                                       ['eval', 'a', '--stamp-offset', 'inf']])
def test_wrong_usage_ends_with_2(arguments, capsys):
    with pytest.raises(SystemExit) as caught:
        command_line.main(arguments)
    assert caught.value.code == 2
    assert 'usage: mv_slapse' in capsys.readouterr().err


@pytest.mark.parametrize('command', ['run', 'eval', 'inspect', 'bag', 'demo', 'doctor'])
def test_every_command_has_help(command, capsys):
    with pytest.raises(SystemExit) as caught:
        command_line.main([command, '--help'])
    assert caught.value.code == 0
    assert f'usage: mv_slapse {command}' in capsys.readouterr().out


@pytest.mark.parametrize(('arguments', 'code'), [
    (['inspect', '{video}'], 3), (['inspect', '{video}', '--json'], 3), (['doctor'], 3),
    (['eval', '{out}', '--json'], 2)])
@pytest.mark.parametrize('unbuffered', ['', '1'])
def test_standard_output_may_be_on_a_full_disk(clip, arguments, code, unbuffered):
    names = [argument.format(**vars(clip)) for argument in arguments]
    with open('/dev/full', 'w') as full:
        done = subprocess.run([sys.executable, '-m', 'mv_slapse', *names], stdout=full, text=True,
                              env={**os.environ, 'PYTHONPATH': str(ROOT),
                                   'PYTHONUNBUFFERED': unbuffered},
                              stderr=subprocess.PIPE)
    assert done.returncode == code, done.stderr
    assert len(done.stderr.splitlines()) == 1, done.stderr
    if code == 3:
        assert 'standard output cannot be written: No space left on device' in done.stderr


def test_the_module_runs_as_a_program(tmp_path):
    done = subprocess.run([sys.executable, '-m', 'mv_slapse', 'inspect', tmp_path / 'none.mp4'],
                          capture_output=True, text=True, check=False)
    assert done.returncode == 3
    assert done.stderr.startswith('mv_slapse inspect: ')
    assert 'Traceback' not in done.stderr


def test_the_shell_is_told_what_may_follow(tmp_path):
    pytest.importorskip('argcomplete')
    line = 'mv_slapse run --camera-'
    subprocess.run([sys.executable, '-m', 'mv_slapse'], check=False, cwd=tmp_path, env={
        **os.environ, '_ARGCOMPLETE': '1', '_ARGCOMPLETE_STDOUT_FILENAME': str(tmp_path / 'out'),
        'COMP_LINE': line, 'COMP_POINT': str(len(line)), 'PYTHONPATH': str(ROOT)})
    assert '--camera-height' in (tmp_path / 'out').read_text()
    assert '--overlay' not in (tmp_path / 'out').read_text()
