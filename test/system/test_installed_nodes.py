"""Nodes as installed: found as ``ros2 run`` finds them, they join the graph and end at Ctrl-C."""

import os
from pathlib import Path
import shutil
import signal
import subprocess
import time

import endings
import pytest

NODES = ('decoder', 'plane_extraction', 'slam', 'obstacle_tracker', 'all_in_one')
SECONDS = 120  # a loaded machine takes long to load five times rclpy, scipy and cv2


@pytest.fixture(scope='module')
def prefix():
    """Return the prefix of the installed package."""
    packages = pytest.importorskip('ament_index_python.packages')
    try:
        return Path(packages.get_package_prefix('mv_slapse'))
    except packages.PackageNotFoundError:
        pytest.skip('mv_slapse is not installed as a ROS package')


@pytest.fixture(scope='module')
def running(prefix, ros_domain, tmp_path_factory):
    """Processes of all nodes, by name."""
    folder = tmp_path_factory.mktemp('nodes')
    launchers = {node: prefix / 'lib' / 'mv_slapse' / node for node in NODES}
    processes = {node: subprocess.Popen([launcher], cwd=folder, stderr=subprocess.STDOUT,
                                        stdout=(folder / f'{node}.log').open('wb'))
                 for node, launcher in launchers.items()}
    yield processes, folder
    for process in processes.values():
        process.kill()
        process.wait()


def wait_for(names: set[str], processes) -> set[str]:
    """Return those of the names that the graph shows before the time is up."""
    rclpy = pytest.importorskip('rclpy')
    context = rclpy.Context()
    rclpy.init(context=context)
    observer = rclpy.create_node('observer', context=context)
    end, seen = time.monotonic() + SECONDS, set()
    while seen != names and time.monotonic() < end:
        if any(process.poll() is not None for process in processes.values()):
            break
        seen = names & set(observer.get_node_names())
        time.sleep(0.1)
    observer.destroy_node()
    rclpy.shutdown(context=context)
    return seen


def test_all_nodes_join_the_graph_and_end_at_an_interrupt(running):
    processes, folder = running
    seen = wait_for(set(NODES), processes)
    logs = '\n'.join((folder / f'{node}.log').read_text() for node in NODES)
    assert seen == set(NODES), logs
    for process in processes.values():
        os.kill(process.pid, signal.SIGINT)
    for node, process in processes.items():
        endings.check(process.wait(SECONDS), (folder / f'{node}.log').read_text())


def test_the_program_is_on_the_path(prefix):
    program = shutil.which('mv_slapse')
    assert program == str(prefix / 'bin' / 'mv_slapse')
    done = subprocess.run([program, '--help'], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert 'inspect' in done.stdout
