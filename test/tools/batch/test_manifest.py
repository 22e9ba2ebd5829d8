"""What is run, under which name, and what makes a run another one."""

from dataclasses import replace
import os
from pathlib import Path
import shutil

from mv_slapse.config import Settings
from mv_slapse.errors import MvSlapseError, UsageError
from mv_slapse.tools.batch.manifest import Recording, recordings
import pytest

PLAIN = Recording('')


def found(*inputs, like=PLAIN, sweeps=(), output='nowhere', code='1'):
    return recordings(list(map(str, inputs)), like, sweeps, Path(output), code)


def names(items):
    return [item.name for item in items]


@pytest.fixture
def folder(tmp_path):
    """Return a folder of recordings: videos, a bag, and what is none."""
    top = tmp_path / 'nights'
    for name in ('a.mp4', 'one/b.MKV', 'one/two/c.mcap', 'bag/metadata.yaml', 'bag/bag_0.mcap',
                 'notes.txt', 'thumbnail.png', 'out/a.mp4/results.mcap',
                 'set/image_0/000000.png', 'set/image_0/000001.png'):
        (top / name).parent.mkdir(parents=True, exist_ok=True)
        (top / name).write_bytes(name.encode())
    return top


def test_a_folder_holds_videos_bags_and_pictures_and_no_results(folder):
    items = found(folder)
    assert names(items) == ['a.mp4', 'bag', 'one-b.MKV', 'one-two-c.mcap', 'set']
    assert [item.input for item in items][1] == str(folder / 'bag')
    assert items[0].size == len('a.mp4')
    assert items[1].size == len('bag/metadata.yaml' 'bag/bag_0.mcap')


def test_what_lies_in_the_output_is_not_run(folder):
    (folder / 'out' / 'b.mp4').write_bytes(b'')
    assert 'out-b.mp4' in names(found(folder))
    assert 'out-b.mp4' not in names(found(folder, output=folder / 'out'))


def test_patterns_and_single_inputs_count_once(folder):
    assert names(found(folder / '*.mp4', folder / 'a.mp4', folder / 'bag')) == ['a.mp4', 'bag']


@pytest.mark.parametrize('pattern', ['*', '*/*', '**'])
@pytest.mark.parametrize('out', ['out', 'one/two/results', 'results/night'])
def test_a_pattern_may_match_the_output_and_what_is_in_it(tmp_path, monkeypatch, pattern, out):
    monkeypatch.chdir(tmp_path)
    for name in ('one/a.mp4', 'one/two/b.mp4', 'c.mp4', 'd/d.mp4'):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).touch()
    first = found(pattern, output=out)
    for name in ('batch.csv', 'batch.html', '.lock', 'a.mp4/row.json', 'a.mp4/results.mcap',
                 'b.mp4.0123abcd-0.part/results.mcap', 'image_0/row.json'):
        (tmp_path / out / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / out / name).touch()
    assert found(pattern, output=out) == first
    expanded = sorted(map(str, tmp_path.glob('one/*'))), sorted(map(str, tmp_path.glob('*/*')))
    assert all(names(found(*inputs, output=out)) for inputs in expanded)


@pytest.mark.parametrize('given', ['out', 'out/a.mp4', 'out/a.mp4/results.mcap', 'out/*'])
def test_the_output_alone_is_no_input(tmp_path, monkeypatch, given):
    monkeypatch.chdir(tmp_path)
    (tmp_path / 'out' / 'a.mp4').mkdir(parents=True)
    for name in ('row.json', 'results.mcap'):
        (tmp_path / 'out' / 'a.mp4' / name).touch()
    with pytest.raises(UsageError, match='nothing but .*/out, where the results go'):
        found(given, output='out')


def test_a_recording_that_lies_in_the_output_is_run_where_it_is_named(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / 'night').mkdir()
    (tmp_path / 'night' / 'a.mp4').touch()
    (tmp_path / 'fleet.csv').write_text('input\nnight/a.mp4\n')
    for given in ('fleet.csv', 'night/*', 'night/a.mp4'):
        assert names(found(given, output='.')) == ['a.mp4']


def test_two_of_one_name_get_names_that_stay(folder):
    shutil.copy(folder / 'a.mp4', folder / 'one' / 'a.mp4')
    both = found(folder / 'a.mp4', folder / 'one' / 'a.mp4')
    assert len(set(names(both))) == 2
    assert all(name.startswith('a.mp4-') for name in names(both))
    assert names(found(folder / 'one' / 'a.mp4', folder / 'a.mp4')) == names(both)[::-1]


def test_a_table_says_how_each_is_run(folder):
    (folder / 'dark.yaml').write_text('extraction: {min_macroblocks: 25}')
    (folder / 'table.csv').write_text(
        'input, camera, camera_height, speed, ground_truth, topic, max_frames, name, settings, '
        'extraction.seed\n'
        'a.mp4, cam.yaml, 1.5, , truth.tum, , 7, first, dark.yaml, 3\n'
        'bag, , , /odom, , /camera, , , , \n')
    like = replace(PLAIN, camera='default.yaml')
    first, second = found(folder / 'table.csv', like=like)
    assert (first.name, first.input) == ('first', str(folder / 'a.mp4'))
    assert first.camera == str(folder / 'cam.yaml')
    assert first.ground_truth == str(folder / 'truth.tum')
    assert first.max_frames == 7
    assert first.settings.scene.camera_height == 1.5
    assert first.settings.extraction.min_macroblocks == 25
    assert first.settings.extraction.seed == 3
    assert (second.name, second.speed, second.topic) == ('bag', '/odom', '/camera')
    assert second.camera == os.path.abspath('default.yaml')
    assert second.settings == Settings()


def test_a_speed_is_a_topic_where_there_is_no_such_file(folder, monkeypatch):
    monkeypatch.chdir(folder)
    (folder / 'tables').mkdir()
    (folder / 'tables' / 'rows.csv').write_text(
        'input,speed\n../bag,odom\n../bag,/odom\n../bag,speeds.csv\n')
    for text in ('odom', '/odom'):
        assert found('bag', like=replace(PLAIN, speed=text))[0].speed == text
    (folder / 'speeds.csv').touch()
    assert found('bag', like=replace(PLAIN, speed='speeds.csv'))[0].speed == str(
        folder / 'speeds.csv')
    shutil.move('speeds.csv', 'tables')
    assert [item.speed for item in found('tables/rows.csv')] == [
        'odom', '/odom', str(folder / 'tables' / 'speeds.csv')]


def test_sweeps_multiply(folder):
    items = found(folder / 'a.mp4', sweeps=['scene.camera_height=1.5,1.6', 'extraction.seed=1,2'])
    assert names(items) == ['a.mp4,camera_height=1.5,seed=1', 'a.mp4,camera_height=1.5,seed=2',
                            'a.mp4,camera_height=1.6,seed=1', 'a.mp4,camera_height=1.6,seed=2']
    assert [item.settings.scene.camera_height for item in items] == [1.5, 1.5, 1.6, 1.6]
    assert items[0].swept == 'scene.camera_height=1.5 extraction.seed=1'
    assert len({item.key for item in items}) == 4


def test_the_key_is_of_input_settings_files_beside_and_code(folder):
    camera = folder / 'camera.yaml'
    camera.write_text('a')
    like = replace(PLAIN, camera=str(camera))

    def key(**options):
        return found(folder / 'a.mp4', like=like, **options)[0].key

    first = key()
    assert key() == first
    keys = {first, key(code='2'), key(sweeps=['extraction.seed=5'])}
    camera.write_text('ab')
    keys.add(key())
    os.utime(folder / 'a.mp4', ns=(1, 1))
    keys.add(key())
    (folder / 'a.mp4').write_bytes(b'longer than it was')
    keys.add(key())
    assert len(keys) == 6


@pytest.mark.parametrize(('table', 'told'), [
    ('video\na.mp4\n', 'is not a table'), ('', 'is not a table'),
    ('input,colour\na.mp4,red\n', 'no column colour'),
    ('input,scene.colour\na.mp4,red\n', 'no setting scene.colour'),
    ('input,max_frames\na.mp4,few\n', 'no whole number'),
    ('input,camera\na.mp4\n', 'not as many values'), ('input,name\n,b\n', 'names no input')])
def test_a_wrong_table_is_refused_with_the_line(folder, table, told):
    (folder / 'table.csv').write_text(table)
    with pytest.raises(UsageError, match=told) as caught:
        found(folder / 'table.csv')
    assert 'table.csv' in str(caught.value)


@pytest.mark.parametrize('given', ['none.mp4', '*.none', '.'])
def test_an_input_that_is_not_there_is_refused(tmp_path, given):
    with pytest.raises(MvSlapseError, match=r'there is no|nothing matches|neither videos'):
        found(tmp_path / given)


@pytest.mark.parametrize('sweep', ['scene.camera_height', 'scene.camera_height=', 'scene.no=1'])
def test_a_sweep_that_makes_no_sense_is_refused(folder, sweep):
    with pytest.raises(UsageError):
        found(folder / 'a.mp4', sweeps=[sweep])
