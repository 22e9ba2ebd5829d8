from mv_slapse.config import Settings
from mv_slapse.errors import UsageError
from mv_slapse.tools import settings_arguments
import pytest


def test_a_text_changes_one_setting():
    changed = settings_arguments.override(Settings(), ['scene.camera_height=2',
                                                       'extraction.min_macroblocks = 30'])
    assert changed.scene.camera_height == 2.0
    assert isinstance(changed.scene.camera_height, float)
    assert changed.extraction.min_macroblocks == 30
    assert changed.decoder == Settings().decoder


def test_truth_values_are_written_as_in_yaml():
    changed = settings_arguments.override(Settings(), ['decoder.paper_weights=true'])
    assert changed.decoder.paper_weights is True


@pytest.mark.parametrize(('text', 'message'), [
    ('scene.camera_height', 'section.name=value'),
    ('scene.camera_hight=1', 'no setting scene.camera_hight; did you mean scene.camera_height'),
    ('scen.gate=1', 'no setting scen.gate; did you mean scene.gate'),
    ('gate=1', 'no setting gate; '),
    ('xyz.q=1', 'no setting xyz.q; docs/parameters.md lists all'),
    ('scene.camera_height=tall', "takes a float, not 'tall'"),
    ('extraction.min_macroblocks=2.5', 'takes a int, not 2.5'),
    ('scene.camera_height=1e400', r'camera_height = inf is out of bounds \[0.0, 1000.0\]'),
    ('scene.camera_height=1e-30', r'camera_height = 1e-30 is out of bounds \[0.001, 1000.0\]'),
    ('scene.acceleration=1e400', r'acceleration = inf is out of bounds \[0.0, 1000000000.0\]'),
    ('scene.camera_height=-1', r'camera_height = -1.0 is out of bounds')])
def test_a_wrong_text_is_refused(text, message):
    with pytest.raises(UsageError, match=message):
        settings_arguments.override(Settings(), [text])


def test_a_file_changes_what_it_names(tmp_path):
    path = tmp_path / 'settings.yaml'
    path.write_text('scene: {camera_height: 2}\nextraction:\n  seed: 7\n')
    changed = settings_arguments.read_settings(path)
    assert (changed.scene.camera_height, changed.extraction.seed) == (2.0, 7)


def test_the_parameter_file_of_a_node_will_do(tmp_path):
    path = tmp_path / 'slam.yaml'
    path.write_text('/**:\n  ros__parameters:\n    odom_frame: odom\n'
                    '    scene: {camera_height: 1.2}\n    extraction.seed: 7\n')
    read = settings_arguments.read_settings(path)
    assert (read.scene.camera_height, read.extraction.seed) == (1.2, 7)


@pytest.mark.parametrize(('text', 'message'), [('a: [', 'cannot be read'),
                                               ('', 'not a settings file'),
                                               ('camera_height: 1', 'outside a section'),
                                               ('scene: {x: 1}', 'no setting scene.x')])
def test_a_wrong_file_is_refused(tmp_path, text, message):
    path = tmp_path / 'settings.yaml'
    path.write_text(text)
    with pytest.raises(UsageError, match=message):
        settings_arguments.read_settings(path)
