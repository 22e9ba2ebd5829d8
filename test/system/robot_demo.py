"""Play the demo's street into the four nodes, as a robot would have it, and record what they say.

python robot_demo.py DEMO OUT    DEMO is the folder of `mv_slapse demo`
"""

from collections import Counter
from contextlib import contextmanager
from pathlib import Path
import shutil
import signal
import subprocess
import sys
import time

from mv_slapse.evaluation import trajectory as evaluation
from mv_slapse.fields import stamp_from_message
from mv_slapse.ros_frames import RosFrames
from mv_slapse.storage.bag_reader import BagReader
from mv_slapse.storage.camera_info import read_camera
from mv_slapse.storage.tum import read_trajectory, Trajectory
from mv_slapse.tools.bag import make_bag
from nodes import fake_launch
import numpy as np
import rclpy
from system.recorded import trajectory
from system.recorder import Recorder

ROOT = Path(__file__).resolve().parents[2]
LAUNCH_FILE = ROOT / 'mv_slapse' / 'launch' / 'mv_slapse.launch.py'
PLAYER = ROOT / 'test' / 'system' / 'player.py'
VIDEO = '/camera/image/ffmpeg'
TOPICS = {
    '/correspondences': 'mv_slapse_msgs/msg/Correspondences',
    '/planes/observations': 'mv_slapse_msgs/msg/PlaneObservations',
    '/planes/map': 'mv_slapse_msgs/msg/PlaneMap',
    '/planes/map_markers': 'visualization_msgs/msg/MarkerArray',
    '/planes/handover': 'mv_slapse_msgs/msg/PlaneHandover',
    '/odometry': 'nav_msgs/msg/Odometry', '/tf': 'tf2_msgs/msg/TFMessage',
    '/path': 'nav_msgs/msg/Path',
    '/obstacles': 'mv_slapse_msgs/msg/ObstacleArray',
    '/obstacles/points': 'sensor_msgs/msg/PointCloud2',
    '/obstacles/polygons': 'geometry_msgs/msg/PolygonInstanceStamped',
    '/obstacles/markers': 'visualization_msgs/msg/MarkerArray',
    '/image_overlay': 'sensor_msgs/msg/Image',
    '/diagnostics': 'diagnostic_msgs/msg/DiagnosticArray'}
LATCHED = ('/planes/map', '/planes/map_markers')
#: who reads what, the recorder included
READERS = {'/correspondences': 2, '/planes/observations': 4, '/odometry': 2, '/planes/map': 3,
           '/obstacles': 2}
PARAMETERS = """/**:
  ros__parameters:
    scene: {camera_height: 1.65}
    camera_frame: camera_optical
    base_from_camera: [0.0, 0.0, 1.65, -0.5, 0.5, -0.5, 0.5]
"""


@contextmanager
def nodes(folder: Path):
    """Start what the launch file starts for the topic of the video."""
    (folder / 'robot.yaml').write_text(PARAMETERS)
    started = fake_launch.resolve(LAUNCH_FILE, input=VIDEO, params_file=str(folder / 'robot.yaml'),
                                  camera_info_topic='/camera/camera_info', all_in_one='false')
    processes = [subprocess.Popen(one.cmd, cwd=folder, stderr=subprocess.STDOUT,
                                  stdout=(folder / f'{one.executable}.log').open('wb'))
                 for one in started]
    try:
        yield [one.executable for one in started]
    finally:
        for process in processes:
            process.send_signal(signal.SIGINT)
        for process in processes:
            process.wait(20)


def play(bag: Path, folder: Path) -> Counter:
    """Play a bag into the nodes, record, and return how many messages there were."""
    rclpy.init()
    try:
        with Recorder(folder / 'recorded', TOPICS, LATCHED) as recorder, nodes(folder):
            node = recorder.node
            if not recorder.spin(lambda: all(
                    node.count_subscribers(topic) >= n for topic, n in READERS.items()), 60):
                raise SystemExit(f'the nodes do not find one another, see the logs in {folder}')
            recorder.spin(lambda: False, 1.0)
            player = subprocess.Popen([sys.executable, PLAYER, bag, '1', '2'])
            recorder.spin(lambda: player.poll() is not None, 120)
            recorder.spin(lambda: recorder.silent_for(2), 30)
            return recorder.counts
    finally:
        rclpy.shutdown()


def said(recorded: BagReader) -> list[str]:
    """Return what each node said of its state, and from when on."""
    lines, last, begin = [], {}, None
    for _, msg in recorded.messages(['/diagnostics']):
        begin = begin or stamp_from_message(msg.header.stamp)
        for status in msg.status:
            if last.get(status.name) != status.message:
                last[status.name] = status.message
                at = (stamp_from_message(msg.header.stamp) - begin) / 1e9
                lines.append(f'{at:6.1f} s  {status.name:16}  {status.message}')
    return lines


def error(recorded: BagReader, truth: Trajectory) -> str:
    """Return how far the odometry is off."""
    frames = RosFrames(R_base_from_cam=RosFrames().R_base_from_cam,
                       t_base_from_cam=np.array([0.0, 0.0, 1.65]))
    found = trajectory(recorded, frames)
    figures = evaluation.figures(evaluation.evaluate(found, truth))
    return (f'{figures["n_poses"]} poses along {figures["distance_m"]:.1f} m are '
            f'{figures["ate_rigid_mean_percent"]:.2f} % off in the mean, after rigid alignment')


def main() -> int:
    demo, folder = (Path(name).resolve() for name in sys.argv[1:3])
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    truth, start = read_trajectory(demo / 'truth' / 'ground_truth.tum'), time.time_ns()
    camera = read_camera(demo / 'camera.yaml')
    make_bag(str(demo / 'video.mpg'), camera, truth, folder / 'bag', start)
    counts = play(folder / 'bag', folder)
    recorded = BagReader(folder / 'recorded')
    print(*said(recorded), sep='\n')
    print(*(f'{counts[topic]:6} messages on {topic}' for topic in TOPICS), sep='\n')
    moved = Trajectory(truth.stamps + start, truth.positions, truth.quaternions)
    print(error(recorded, moved))
    print(f'all of it: {folder}/recorded, the logs beside it; config/foxglove.json shows it')
    return 0 if counts['/odometry'] else 1


if __name__ == '__main__':
    sys.exit(main())
