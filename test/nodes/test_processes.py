"""Nodes as processes: how they start, what they say when they cannot, and how they end."""

import os
from pathlib import Path
import signal
import subprocess
import sys
import time

import pytest

pytest.importorskip('rclpy')
pytest.importorskip('mv_slapse_msgs')

from conftest import ROOT  # noqa: E402
from diagnostic_msgs.msg import DiagnosticArray  # noqa: E402
import endings  # noqa: E402
from mv_slapse.codec.encoding.encoder import write_video  # noqa: E402
from mv_slapse.fields import camera_from_message  # noqa: E402
from mv_slapse.nodes import standby  # noqa: E402
from mv_slapse.storage.camera_info import write_camera  # noqa: E402
from mv_slapse_msgs.msg import Correspondences  # noqa: E402
from nodes import clips, fake_launch  # noqa: E402
from std_srvs.srv import Trigger  # noqa: E402

NODES = ('decoder', 'plane_extraction', 'slam', 'obstacle_tracker', 'all_in_one')


def start(name, *arguments, more=(), env=os.environ):
    return subprocess.Popen(
        [sys.executable, '-m', f'mv_slapse.nodes.{name}', *more, '--ros-args', *arguments],
        env={**env, 'PYTHONPATH': str(ROOT)}, text=True,
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


def wait_for(condition):
    end = time.monotonic() + 60
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.1)


def children_of(process):
    """Return the numbers of the node, and of the process that waits to follow it."""
    text = Path(f'/proc/{process.pid}/task/{process.pid}/children').read_text()
    return [int(number) for number in text.split()]


def node_of(process):
    """Return the number of the node once another one waits, else 0."""
    return children_of(process)[0] if len(children_of(process)) == 2 else 0


def has_shared_memory(number):
    """Return whether a process hears by DDS in shared memory."""
    return '/dev/shm/fastrtps_port' in Path(f'/proc/{number}/maps').read_text()


def is_participant(number):
    """Return whether a process has the threads of one."""
    return any('dds.' in (path / 'comm').read_text()
               for path in Path(f'/proc/{number}/task').iterdir())


def is_in_ros(bench, number):
    return f'{standby.PLACE}{number}' in names_of(bench.peer)


@pytest.fixture
def standing(bench):
    """A node that is forked by a process left behind."""
    process = start('slam', more=['--standby'])
    try:
        assert bench.spin(lambda: node_of(process) and 'slam' in names_of(bench.peer), 60)
        yield process
    finally:
        process.kill()
        process.wait()


def test_a_node_that_is_killed_is_followed_by_one_that_is_in_ros_by_then(bench, standing):
    first, second = children_of(standing)
    assert bench.spin(lambda: is_in_ros(bench, second), 30)
    os.kill(first, signal.SIGKILL)
    assert bench.spin(lambda: node_of(standing) == second, 30)
    assert bench.spin(lambda: not Path(f'/proc/{first}').exists())
    client = bench.peer.create_client(Trigger, '/slam/reset')
    assert bench.spin(client.service_is_ready, 30)
    assert bench.spin(lambda: not is_in_ros(bench, second))  # but as slam
    assert cpu_of(second) < 0.6 * cpu_of(standing.pid)  # a third is usual
    third = children_of(standing)[1]
    assert bench.spin(lambda: is_in_ros(bench, third), 30)
    standing.send_signal(signal.SIGTERM)
    said, _ = standing.communicate(timeout=20)
    assert standing.returncode == 0
    assert 'SIGKILL has ended the node, it is started again' in said
    assert not any(Path(f'/proc/{number}').exists() for number in (second, third))
    assert bench.spin(lambda: not is_in_ros(bench, third))  # it has taken its leave


def test_the_one_that_waits_hears_by_udp_alone(ros_domain):
    """With ROS_AUTOMATIC_DISCOVERY_RANGE=LOCALHOST rmw_fastrtps chooses, whatever is asked for."""
    subnet = {key: value for key, value in os.environ.items() if 'DISCOVERY_RANGE' not in key}
    process = start('slam', more=['--standby'], env=subnet)
    try:
        wait_for(lambda: node_of(process) and all(map(is_participant, children_of(process))))
        assert [has_shared_memory(number) for number in children_of(process)] == [True, False]
    finally:
        process.kill()
        process.wait()


def test_a_node_comes_again_where_the_one_that_was_to_follow_it_was_killed(bench, standing):
    first, second = children_of(standing)
    os.kill(second, signal.SIGKILL)
    os.kill(first, signal.SIGKILL)
    assert bench.spin(lambda: node_of(standing) not in (0, first, second), 30)
    client = bench.peer.create_client(Trigger, '/slam/reset')
    assert bench.spin(client.service_is_ready, 30)
    stop([standing], signal.SIGINT)


def test_one_that_waits_ends_with_the_process_that_has_forked_it(standing):
    numbers = children_of(standing)
    standing.kill()
    wait_for(lambda: not any(Path(f'/proc/{number}').exists() for number in numbers))


def test_two_that_were_forked_again_find_each_other(bench, standing):
    other = start('obstacle_tracker', more=['--standby'])
    try:
        assert bench.spin(lambda: node_of(other) and 'obstacle_tracker' in names_of(bench.peer),
                          60)
        killed = {process: node_of(process) for process in (standing, other)}
        for number in killed.values():
            os.kill(number, signal.SIGKILL)
        assert bench.spin(lambda: all(node_of(process) not in (0, number)
                                      for process, number in killed.items()), 30)
        said = {}
        bench.peer.create_subscription(DiagnosticArray, '/diagnostics', lambda msg: said.update(
            ((one.name, item.key), item.value) for one in msg.status for item in one.values), 10)
        assert bench.spin(lambda: said.get(('obstacle_tracker', 'publishers of /odometry')) == '1',
                          20)
    finally:
        other.kill()
        other.wait()


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
    write_camera(tmp_path / 'camera.yaml', camera_from_message(clips.camera_info()))
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


@pytest.mark.parametrize(('name', 'parameter', 'why'), [
    ('decoder', 'source:=/missing/film.mp4', '/missing/film.mp4'),
    ('all_in_one', 'source:=ftp://127.0.0.1/a.ts', 'protocol not allowed'),
    ('slam', 'map_file:={}/map.json', 'is no map of mv_slapse')])
def test_what_can_never_be_read_ends_the_node_with_code_3(ros_domain, tmp_path, name, parameter,
                                                          why):
    """In a process: a node whose constructor raises in this one stays in the graph."""
    (tmp_path / 'map.json').write_text('{}')
    process = start(name, '-p', parameter.format(tmp_path))
    said, _ = process.communicate(timeout=20)
    assert process.returncode == 3
    assert why in said
    assert 'Traceback' not in said


def test_a_parameter_file_that_is_not_there_ends_the_node_with_code_2(ros_domain):
    process = start('slam', '--params-file', '/missing.yaml')
    said, _ = process.communicate(timeout=20)
    assert process.returncode == 2
    assert '/missing.yaml' in said
    assert 'Traceback' not in said
