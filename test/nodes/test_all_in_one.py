import pytest

pytest.importorskip('rclpy')
pytest.importorskip('mv_slapse_msgs')

from mv_slapse.codec.encoding.encoder import write_video  # noqa: E402
from mv_slapse.fields import camera_from_message  # noqa: E402
from mv_slapse.nodes.all_in_one import AllInOneNode  # noqa: E402
from mv_slapse.storage.camera_info import write_camera  # noqa: E402
from mv_slapse_msgs.msg import (  # noqa: E402
    Correspondences,
    ObstacleArray,
    PlaneMap,
    PlaneObservations,
)
from nodes import clips  # noqa: E402
from nodes.bench import LATCHED  # noqa: E402
from std_srvs.srv import Trigger  # noqa: E402


def test_a_file_gives_messages_on_every_topic(bench, tmp_path):
    write_video(tmp_path / 'clip.mp4', clips.pictures(), clips.FPS)
    write_camera(tmp_path / 'camera.yaml', camera_from_message(clips.camera_info()))
    topics = {'correspondences': Correspondences, 'planes/observations': PlaneObservations,
              'planes/map': PlaneMap, 'obstacles': ObstacleArray}
    received = {topic: bench.listen(kind, topic, LATCHED if kind is PlaneMap else 100)
                for topic, kind in topics.items()}
    node = bench.start(AllInOneNode, source=str(tmp_path / 'clip.mp4'), source_rate=2.0,
                       camera_info_url=str(tmp_path / 'camera.yaml'), tf_wait=0.5,
                       stamp_origin='stream')
    assert bench.spin(lambda: 'ended' in str(node.health.status().values), 20)
    bench.spin(lambda: False, 0.3)
    stamps = {topic: [m.header.stamp.sec + m.header.stamp.nanosec * 1e-9 for m in messages]
              for topic, messages in received.items()}
    assert len(stamps['correspondences']) >= 2
    assert all(found == stamps['correspondences'] for found in stamps.values()), stamps
    assert bench.call(Trigger, '/all_in_one/reset').success
