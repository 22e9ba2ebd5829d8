from pathlib import Path

from nodes import fake_launch
import pytest

pytest.importorskip('ament_index_python')
LAUNCH_FILE = Path(__file__).parents[2] / 'mv_slapse' / 'launch' / 'mv_slapse.launch.py'
FOUR = ['decoder', 'plane_extraction', 'slam', 'obstacle_tracker']


def resolve(all_in_one='false', **arguments):
    return {started.executable: started for started in fake_launch.resolve(
        LAUNCH_FILE, all_in_one=all_in_one, **arguments)}


def test_without_arguments_one_process_does_everything():
    assert [one.executable for one in fake_launch.resolve(LAUNCH_FILE)] == ['all_in_one']


def test_the_four_nodes_start_on_their_own_topics():
    nodes = resolve()
    assert list(nodes) == FOUR
    assert all(node.parameters == {'use_sim_time': False} for node in nodes.values())
    assert not any(node.remappings for node in nodes.values())


def test_a_topic_is_remapped_with_the_camera_info_beside_it():
    nodes = resolve(input='/front/image_raw/ffmpeg')
    assert nodes['decoder'].remappings == {'video': '/front/image_raw/ffmpeg',
                                           'camera_info': '/front/camera_info'}
    assert nodes['plane_extraction'].remappings == {'camera_info': '/front/camera_info'}
    assert nodes['slam'].remappings == {}


def test_wheel_odometry_goes_to_the_filter_of_the_pose_alone():
    nodes = resolve(wheel_odometry_topic='/base/odom')
    assert [name for name in FOUR if 'wheel_odometry' in nodes[name].remappings] == ['slam']
    assert nodes['slam'].remappings == {'wheel_odometry': '/base/odom'}
    node = resolve(wheel_odometry_topic='/base/odom', all_in_one='true')['all_in_one']
    assert node.remappings == {'wheel_odometry': '/base/odom'}


def test_a_raw_topic_keeps_its_name_when_its_camera_info_is_sought():
    nodes = resolve(input='/front/image_raw')
    assert nodes['decoder'].remappings['camera_info'] == '/front/camera_info'


@pytest.mark.parametrize('url', ['rtsp://camera/stream', 'missing.mp4', '/dev/null'])
def test_a_file_url_or_device_becomes_the_source_of_the_decoder_alone(url):
    nodes = resolve(input=url, camera_info_url='camera.yaml')
    assert nodes['decoder'].parameters['source'] == url
    assert [name for name, node in nodes.items() if 'source' in node.parameters] == ['decoder']
    assert [name for name, node in nodes.items() if node.parameters.get('camera_info_url')
            == 'camera.yaml'] == ['decoder', 'plane_extraction']


def test_a_bag_is_played_with_its_clock_and_the_nodes_follow_it(tmp_path):
    nodes = resolve(input=str(tmp_path))
    assert nodes['ros2'].cmd[:4] == ['ros2', 'bag', 'play', str(tmp_path)]
    assert '--clock' in nodes['ros2'].cmd
    assert all(nodes[name].parameters['use_sim_time'] is True for name in FOUR)
    assert nodes['decoder'].remappings['video'] == '/camera/image/ffmpeg'


def test_the_transforms_of_a_bag_do_not_double_ours(tmp_path):
    cmd = resolve(input=str(tmp_path))['ros2'].cmd
    assert cmd[cmd.index('--exclude-topics') + 1:] == ['/tf']  # and /tf_static is played
    assert '/tf' not in resolve(input=str(tmp_path), bag_tf='true')['ros2'].cmd


def test_the_level_of_the_log_is_that_of_all_nodes():
    for node in resolve(log_level='debug').values():
        assert node.cmd[node.cmd.index('--log-level') + 1] == 'debug'


def test_use_sim_time_can_be_refused_for_a_bag():
    assert not resolve(input='x.mcap', use_sim_time='false')['slam'].parameters['use_sim_time']


def test_all_in_one_is_a_single_node_with_everything():
    nodes = resolve(all_in_one='true', input='/video', namespace='robot')
    assert list(nodes) == ['all_in_one']
    node = nodes['all_in_one']
    assert node.respawn
    assert '--standby' in node.cmd
    once = resolve(respawn='false')['slam']
    assert not once.respawn
    assert '--standby' not in once.cmd
    assert node.namespace == 'robot'
    assert node.remappings == {'video': '/video', 'camera_info': '/camera_info'}


def test_the_command_line_comes_after_the_parameter_file(tmp_path):
    node = resolve(params_file='mine.yaml', camera_info_url='camera.yaml')['decoder']
    files = [node.cmd[i + 1] for i, word in enumerate(node.cmd) if word == '--params-file']
    assert files[0] == 'mine.yaml'
    assert 'camera_info_url: camera.yaml' in Path(files[1]).read_text()


def test_every_executable_is_installed():
    for started in resolve().values():
        assert Path(started.cmd[0]).is_file()


def test_the_launch_file_loads_in_the_real_launch():
    pytest.importorskip('launch_ros')
    from launch.launch_description_sources import get_launch_description_from_python_launch_file
    description = get_launch_description_from_python_launch_file(str(LAUNCH_FILE))
    assert len(description.entities) == 15


def test_the_viewer_shows_the_frame_that_it_is_told():
    cmd = resolve(rviz='true', fixed_frame='map')['rviz2'].cmd
    assert cmd[cmd.index('-f') + 1] == 'map'
    assert 'rviz2' not in resolve()
