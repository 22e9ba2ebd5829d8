"""Package: one version everywhere, parameter files as the settings have them, nodes installed."""

import os
from pathlib import Path
import re
import subprocess
import sys
import xml.etree.ElementTree as ET

from mv_slapse.nodes.settings import NODE_SETTINGS
from mv_slapse.tools import parameter_files
import pytest
import yaml

ROOT = Path(__file__).resolve().parents[1]
NODES = ('decoder', 'plane_extraction', 'slam', 'obstacle_tracker', 'all_in_one')


def manifest(name: str) -> ET.Element:
    return ET.parse(ROOT / name).getroot()


def installed(node: str) -> Path:
    """Return the launcher of a node where `ros2 run` would find it."""
    packages = pytest.importorskip('ament_index_python.packages')
    try:
        prefix = packages.get_package_prefix('mv_slapse')
    except packages.PackageNotFoundError:
        pytest.skip('mv_slapse is not installed as a ROS package')
    return Path(prefix, 'lib', 'mv_slapse', node)


def test_the_three_versions_are_one():
    setup = re.search(r"version='([^']+)'", (ROOT / 'setup.py').read_text())[1]
    assert manifest('package.xml').findtext('version') == setup
    assert manifest('msg_defs/package.xml').findtext('version') == setup


def test_the_root_depends_on_what_the_messages_depend_on():
    root = {item.text for item in manifest('package.xml') if item.tag.endswith('depend')}
    messages = {item.text for item in manifest('msg_defs/package.xml')
                if item.tag.endswith('depend')}
    assert messages <= root


@pytest.mark.parametrize('path', sorted((ROOT / 'msg_defs' / 'msg').glob('*.msg')),
                         ids=lambda path: path.stem)
def test_every_message_can_be_made(path):
    msg = pytest.importorskip('mv_slapse_msgs.msg')
    assert getattr(msg, path.stem)()


@pytest.mark.parametrize('path', sorted((ROOT / 'msg_defs' / 'msg').glob('*.msg')),
                         ids=lambda path: path.stem)
def test_every_field_of_a_message_has_a_comment(path):
    lines = path.read_text().splitlines()
    constant = re.compile(r'\w+ [A-Z_]+=')
    assert not [line for line in lines if line and '#' not in line and not constant.match(line)]


def test_every_node_has_settings_and_a_parameter_file():
    assert set(NODE_SETTINGS) == set(NODES)
    assert {path.stem for path in (ROOT / 'config').glob('*.yaml')} >= set(NODES)


@pytest.mark.parametrize('node', NODES)
def test_the_parameter_file_is_what_the_settings_give(node):
    path = ROOT / 'config' / f'{node}.yaml'
    assert path.read_text() == parameter_files.text(node), 'run make config'


@pytest.mark.parametrize('node', NODES)
def test_the_parameter_file_names_every_parameter_with_its_default(node):
    written = yaml.safe_load(parameter_files.text(node))['/**']['ros__parameters']
    for prefix, kind in NODE_SETTINGS[node]:
        values = written[prefix] if prefix else written
        for name, item in kind.__dataclass_fields__.items():
            value = values[name]
            assert type(value)(item.default) == value
            assert type(value) is (list if type(item.default) is tuple else type(item.default))


@pytest.mark.parametrize('node', NODES)
def test_ros_finds_the_node(node):
    launcher = installed(node)
    assert os.access(launcher, os.X_OK)


@pytest.mark.parametrize('node', NODES)
def test_a_node_is_a_module_with_a_main(node):
    path = ROOT / 'mv_slapse' / 'nodes' / f'{node}.py'
    if not path.exists():
        pytest.skip('not written yet')
    assert 'def main(' in path.read_text()


def test_the_package_runs_as_a_module():
    done = subprocess.run([sys.executable, '-m', 'mv_slapse', '--help'], cwd=ROOT,
                          capture_output=True, text=True)
    assert done.returncode == 0
    assert all(word in done.stdout for word in ('run', 'eval', 'inspect', 'bag', 'demo', 'doctor'))


def test_doctor_runs_where_a_library_is_missing():
    code = """
import sys
class Missing:
    def find_spec(self, name, path=None, target=None):
        if name == 'scipy':
            raise ModuleNotFoundError(name, name=name)
sys.meta_path.insert(0, Missing())
from mv_slapse.__main__ import main
sys.exit(main(['doctor']))
"""
    done = subprocess.run([sys.executable, '-c', code], cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 3
    assert re.search(r'scipy +MISSING.*\n.*pip install scipy', done.stdout)
    assert 'command line: can NOT run' in done.stdout
    assert 'Traceback' not in done.stdout + done.stderr


def test_doctor_says_how_to_get_kernels_that_are_missing():
    code = """
import sys
sys.modules['mv_slapse_kernels'] = None
from mv_slapse.__main__ import main
sys.exit(main(['doctor']))
"""
    done = subprocess.run([sys.executable, '-c', code], cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 3
    assert re.search(r'compiled kernels +MISSING.*\n.*make setup.*colcon.*pip', done.stdout)
    assert 'Traceback' not in done.stdout + done.stderr
