from itertools import pairwise

import bounded
from mv_slapse.config import Settings
from mv_slapse.errors import UnusableInput, UsageError
from mv_slapse.storage import yaml_files
from mv_slapse.storage.camera_info import read_camera
from mv_slapse.tools.settings_arguments import override, read_settings
import pytest

BOMB = 'a: &a [x, x, x, x, x, x, x, x, x]\n' + ''.join(
    f'{b}: &{b} [{", ".join([f"*{a}"] * 9)}]\n' for a, b in pairwise('abcdefghi'))
REFUSED = {'aliases': BOMB, 'deep': '[' * 20_000, 'deep dicts': '{a: ' * 20_000,
           'large': 'a: ' + 'x' * 300_000, 'digits': 'a: ' + '9' * 5000, 'date': 'a: 2001-99-99',
           'binary': 'a: !!binary "x"', 'not text': b'\xff\xfe\x00', 'tag': 'a: !!python/name:os',
           'two': 'a: 1\n---\nb: 2', 'no key': '{[a]: 1}'}


@pytest.mark.parametrize('name', REFUSED)
def test_what_could_fill_the_memory_is_refused(tmp_path, name):
    content = REFUSED[name]
    path = tmp_path / 'a.yaml'
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    with bounded.refusal(), pytest.raises(ValueError, match='.'):
        yaml_files.load(path)
    with bounded.refusal(), pytest.raises(UnusableInput, match=str(path)):
        read_camera(path)
    with bounded.refusal(), pytest.raises(UsageError, match=str(path)):
        read_settings(path)


def test_plain_values_are_read(tmp_path):
    path = tmp_path / 'a.yaml'
    path.write_text('a: {b: [1, 2.5, text, true]}\n')
    assert yaml_files.load(path) == {'a': {'b': [1, 2.5, 'text', True]}}


@pytest.mark.parametrize('entry', [
    'data: [1.0e-300, 0, 8, 0, 1.0e-300, 8, 0, 0, 1]', 'data: [1.0e+300, 0, 8, 0, 9, 8, 0, 0, 1]',
    'data: [9, 0, 1.0e+300, 0, 9, 8, 0, 0, 1]'])
def test_a_camera_that_no_lens_has_is_refused(tmp_path, entry):
    path = tmp_path / 'camera.yaml'
    path.write_text(f'image_width: 640\nimage_height: 480\ncamera_matrix: {{{entry}}}\n')
    with pytest.raises(UnusableInput, match=r'no lens has|out of range'):
        read_camera(path)


@pytest.mark.parametrize('size', ['.inf', '.nan', '1.0e+300', '[]', '70000'])
def test_a_size_that_no_picture_has_is_refused(tmp_path, size):
    path = tmp_path / 'camera.yaml'
    path.write_text(f'image_width: {size}\nimage_height: 480\ncamera_matrix: '
                    '{data: [500, 0, 320, 0, 500, 240, 0, 0, 1]}\n')
    with pytest.raises(UnusableInput, match=str(path)):
        read_camera(path)


@pytest.mark.parametrize('value', ['9' * 400, '[' * 5000, '-' * 5000 + '1'])
def test_a_setting_that_no_number_can_be_is_refused(value):
    with pytest.raises(UsageError, match='camera_height'):
        override(Settings(), [f'scene.camera_height={value}'])
