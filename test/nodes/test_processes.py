"""Nodes as processes: how they start, what they say when they cannot, and how they end."""

import os
from pathlib import Path
import re
import signal
import socket
import subprocess
import sys
import tempfile
import time

import pytest

pytest.importorskip('rclpy')
pytest.importorskip('mv_slapse_msgs')

from conftest import ROOT  # noqa: E402
from diagnostic_msgs.msg import DiagnosticArray  # noqa: E402
import endings  # noqa: E402
from mv_slapse.codec.encoding.encoder import write_video  # noqa: E402
from mv_slapse.nodes import standby  # noqa: E402
from mv_slapse.nodes.conversions import camera_from_msg  # noqa: E402
from mv_slapse.storage.camera_info import write_camera  # noqa: E402
from mv_slapse_msgs.msg import Correspondences  # noqa: E402
from nodes import clips, fake_launch  # noqa: E402
from rclpy.utilities import get_rmw_implementation_identifier  # noqa: E402
from std_srvs.srv import Trigger  # noqa: E402

NODES = ('decoder', 'plane_extraction', 'slam', 'obstacle_tracker', 'all_in_one')


def start(name, *arguments, more=()):
    return subprocess.Popen(
        [sys.executable, '-m', f'mv_slapse.nodes.{name}', *more, '--ros-args', *arguments],
        env={**os.environ, 'PYTHONPATH': str(ROOT)}, text=True,
        stdout=subprocess.PIPE, stderr=subprocess.STDOUT)


def names_of(peer):
    return set(peer.get_node_names())


def stop(processes, number):
    for process in processes:
        process.send_signal(number)
    for process in processes:
        said, _ = process.communicate(timeout=20)
        endings.check(process.returncode, said)


def told_to_end(program, number):
    """Return exit code and words of a program that says when it has started, after a signal."""
    process = subprocess.Popen([sys.executable, '-c', program], text=True, cwd=ROOT,
                               stdout=subprocess.PIPE, stderr=subprocess.STDOUT)
    assert process.stdout.readline() == 'started\n'
    time.sleep(1.0)
    process.send_signal(number)
    said, _ = process.communicate(timeout=20)
    return process.returncode, said


def test_all_nodes_take_their_parameter_files_and_end_cleanly_on_sigint(bench):
    processes = [start(name, '--params-file', str(ROOT / 'config' / f'{name}.yaml'))
                 for name in NODES]
    assert bench.spin(lambda: set(NODES) <= names_of(bench.peer), 60)
    time.sleep(0.3)
    stop(processes, signal.SIGINT)


def test_a_node_ends_cleanly_on_sigterm(bench):
    process = start('slam')
    assert bench.spin(lambda: 'slam' in names_of(bench.peer), 30)
    stop([process], signal.SIGTERM)


def test_the_executor_ends_before_what_it_waits_on(ros_domain):
    program = ('from mv_slapse.nodes import shell\n'
               'class Told(shell.SupervisedExecutor):\n'
               '    def shutdown(self): print("executor", flush=True); super().shutdown()\n'
               'class Node(shell.Node):\n'
               '    def destroy_node(self): print("node", flush=True); super().destroy_node()\n'
               '    def escaped(self, *_): pass\n'
               'shell.SupervisedExecutor = Told\n'
               'print("started", flush=True)\n'
               'shell.run(lambda: Node("ends"))\n')
    code, said = told_to_end(program, signal.SIGTERM)
    endings.check(code, said)
    assert said.splitlines()[:2] == ['executor', 'node']


def test_a_node_whose_end_hangs_is_ended_with_code_1_and_tells_where(ros_domain):
    program = ('import time; from mv_slapse.nodes import shell\n'
               'shell.END_TIME = 0.5\n'
               'class Stuck(shell.Node):\n'
               '    def destroy_node(self): time.sleep(60)\n'
               '    def escaped(self, *_): pass\n'
               'print("started", flush=True)\n'
               'shell.run(lambda: Stuck("stuck"))\n')
    code, said = told_to_end(program, signal.SIGINT)
    assert code == 1
    assert 'destroy_node' in said


def cpu_of(number):
    """Return the CPU time of a process, without its children."""
    words = Path(f'/proc/{number}/stat').read_text().rpartition(')')[2].split()
    return sum(map(int, words[11:13]))


def child_of(process):
    return int(Path(f'/proc/{process.pid}/task/{process.pid}/children').read_text() or 0)


@pytest.fixture
def standing(bench):
    """A node that is forked by a process left behind."""
    process = start('slam', more=['--standby'])
    try:
        assert bench.spin(lambda: child_of(process) and 'slam' in names_of(bench.peer), 60)
        yield process
    finally:
        process.kill()
        process.wait()


def test_a_node_that_is_killed_is_there_again_without_loading_anything(bench, standing):
    first = child_of(standing)
    os.kill(first, signal.SIGKILL)
    assert bench.spin(lambda: child_of(standing) not in (0, first), 30)
    second = child_of(standing)
    assert bench.spin(lambda: not Path(f'/proc/{first}').exists())
    if get_rmw_implementation_identifier() == standby.FAST_DDS:
        assert bench.spin(lambda: any(not standby.is_free(i) for i in standby.PARTICIPANTS), 30)
    client = bench.peer.create_client(Trigger, '/slam/reset')
    assert bench.spin(client.service_is_ready, 30)
    assert cpu_of(second) < 0.6 * cpu_of(standing.pid)  # a third is usual
    standing.send_signal(signal.SIGTERM)
    said, _ = standing.communicate(timeout=20)
    assert standing.returncode == 0
    assert 'SIGKILL has ended the node, it is started again' in said
    assert not Path(f'/proc/{second}').exists()


@pytest.fixture
def no_profile(monkeypatch):
    """What a test sets in its place is taken back as well."""
    monkeypatch.setenv(standby.PROFILES, '')
    monkeypatch.delenv(standby.PROFILES)


def test_each_that_is_forked_again_has_ports_that_none_before_it_had(
        no_profile, monkeypatch, tmp_path):
    monkeypatch.setenv('ROS_DOMAIN_ID', '91')
    monkeypatch.setattr(tempfile, 'tempdir', str(tmp_path))
    ports, chosen = standby.Ports(standby.FAST_DDS), []
    for _ in range(3):
        ports.change()
        profile = Path(os.environ[standby.PROFILES]).read_text()
        chosen.append(int(re.search(r'<participantID>(\d+)<', profile)[1]))
        if len(chosen) == 1:  # the next one is another's
            taken = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
            taken.bind(('', 7410 + 250 * 91 + 2 * following(chosen[0])))
    taken.close()
    assert chosen[1:] == [following(following(chosen[0])), following(chosen[1])]
    ports.close()
    assert not list(tmp_path.iterdir())


def following(participant):
    order = standby.PARTICIPANTS
    return order[(order.index(participant) + 1) % len(order)]


def test_two_that_were_forked_again_find_each_other(bench, standing):
    other = start('obstacle_tracker', more=['--standby'])
    try:
        assert bench.spin(lambda: child_of(other) and 'obstacle_tracker' in names_of(bench.peer),
                          60)
        killed = {process: child_of(process) for process in (standing, other)}
        for number in killed.values():
            os.kill(number, signal.SIGKILL)
        assert bench.spin(lambda: all(child_of(process) not in (0, number)
                                      for process, number in killed.items()), 30)
        said = {}
        bench.peer.create_subscription(DiagnosticArray, '/diagnostics', lambda msg: said.update(
            ((one.name, item.key), item.value) for one in msg.status for item in one.values), 10)
        assert bench.spin(lambda: said.get(('obstacle_tracker', 'publishers of /odometry')) == '1',
                          20)
    finally:
        other.kill()
        other.wait()


@pytest.mark.parametrize('own', ['variable', 'file', 'middleware'])
def test_a_profile_of_the_users_own_is_left_alone(no_profile, monkeypatch, tmp_path, own):
    monkeypatch.chdir(tmp_path)
    if own == 'variable':
        monkeypatch.setenv(standby.PROFILES, 'mine.xml')
    elif own == 'file':
        (tmp_path / standby.PROFILES_HERE).touch()
    ports = standby.Ports('another' if own == 'middleware' else standby.FAST_DDS)
    ports.change()
    ports.close()
    assert os.environ.get(standby.PROFILES) == ('mine.xml' if own == 'variable' else None)


def test_a_node_does_not_outlive_the_process_left_behind(bench, standing):
    node = child_of(standing)
    standing.kill()
    standing.wait()
    assert bench.spin(lambda: not Path(f'/proc/{node}').exists(), 20)


def test_what_ends_a_node_for_good_does_so_with_a_standby_too(ros_domain):
    process = start('decoder', '-p', 'source:=/missing/film.mp4', more=['--standby'])
    said, _ = process.communicate(timeout=20)
    assert process.returncode == 3
    assert said.count('/missing/film.mp4') == 1


def test_a_parameter_out_of_bounds_ends_the_node_with_code_2_and_its_bounds(ros_domain):
    process = start('slam', '-p', 'scene.camera_height:=-1.0')
    said, _ = process.communicate(timeout=20)
    assert process.returncode == 2
    assert 'scene.camera_height' in said
    assert 'Min: 0.0' in said
    assert 'Traceback' not in said


def test_an_unknown_parameter_is_warned_about_with_the_nearest_name(bench):
    process = start('slam', '-p', 'scene.camera_hight:=1.2', '-p', 'source:=elsewhere')
    assert bench.spin(lambda: 'slam' in names_of(bench.peer), 30)
    process.send_signal(signal.SIGINT)
    said, _ = process.communicate(timeout=20)
    assert ('parameter scene.camera_hight is unknown and not used: did you mean '
            'scene.camera_height?') in said
    assert 'source' not in said  # a parameter of the decoder, from a file that they share


def test_what_the_launch_file_starts_runs(bench, tmp_path):
    write_video(tmp_path / 'clip.mp4', clips.pictures(), clips.FPS)
    write_camera(tmp_path / 'camera.yaml', camera_from_msg(clips.camera_info()))
    (tmp_path / 'slow.yaml').write_text('/**: {ros__parameters: {source_rate: 0.1}}')
    received = bench.listen(Correspondences, '/robot/correspondences')
    started = fake_launch.resolve(
        ROOT / 'mv_slapse' / 'launch' / 'mv_slapse.launch.py', input=str(tmp_path / 'clip.mp4'),
        params_file=str(tmp_path / 'slow.yaml'), camera_info_url=str(tmp_path / 'camera.yaml'),
        namespace='robot', all_in_one='false')
    processes = [subprocess.Popen(s.cmd, text=True, stdout=subprocess.PIPE,
                                  stderr=subprocess.STDOUT) for s in started]
    try:
        assert bench.spin(lambda: received and set(NODES[:4]) <= names_of(bench.peer), 60)
    finally:
        stop(processes, signal.SIGINT)


def test_a_source_that_is_not_there_ends_the_node_with_code_3(ros_domain):
    process = start('decoder', '-p', 'source:=/missing/film.mp4')
    said, _ = process.communicate(timeout=20)
    assert process.returncode == 3
    assert '/missing/film.mp4' in said
    assert 'Traceback' not in said


def test_a_parameter_file_that_is_not_there_ends_the_node_with_code_2(ros_domain):
    process = start('slam', '--params-file', '/missing.yaml')
    said, _ = process.communicate(timeout=20)
    assert process.returncode == 2
    assert '/missing.yaml' in said
    assert 'Traceback' not in said
