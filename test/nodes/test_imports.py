"""What a node does not need is not loaded: it would only make the start longer."""

import subprocess
import sys

import pytest

pytest.importorskip('rclpy')
pytest.importorskip('mv_slapse_msgs')

from conftest import ROOT  # noqa: E402

FILES = ('rosbags', 'mcap')  # only services that write need libraries for files
NEVER = {'decoder': (*FILES, 'scipy.spatial', 'scipy.ndimage', 'mv_slapse.scene'),
         'slam': (*FILES, 'av', 'scipy.spatial', 'mv_slapse.codec')}


@pytest.mark.parametrize('name', NEVER)
def test_a_node_loads_only_what_it_needs(name):
    program = f'import sys, mv_slapse.nodes.{name}; print(*sys.modules)'
    done = subprocess.run([sys.executable, '-c', program], cwd=ROOT, text=True,
                          capture_output=True, check=True)
    assert not set(done.stdout.split()) & set(NEVER[name])
