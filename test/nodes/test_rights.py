"""What the nodes really open is what the policy for SROS2 allows them."""

import json
from pathlib import Path
import subprocess
import sys

import pytest

pytest.importorskip('rclpy')
pytest.importorskip('mv_slapse_msgs')
pytest.importorskip('ffmpeg_image_transport_msgs')

from ffmpeg_image_transport_msgs.msg import FFMPEGPacket  # noqa: E402
from mv_slapse.nodes.all_in_one import AllInOneNode  # noqa: E402
from mv_slapse.nodes.decoder import DecoderNode  # noqa: E402
from mv_slapse.nodes.obstacle_tracker import ObstacleTrackerNode  # noqa: E402
from mv_slapse.nodes.plane_extraction import PlaneExtractionNode  # noqa: E402
from mv_slapse.nodes.slam import SlamNode  # noqa: E402
from mv_slapse.tools import security_policy  # noqa: E402
from sensor_msgs.msg import Image  # noqa: E402

PAGE = (Path(__file__).parents[2] / 'docs' / 'topics.md').read_text(encoding='utf-8')
NODES = {'decoder': DecoderNode, 'plane_extraction': PlaneExtractionNode, 'slam': SlamNode,
         'obstacle_tracker': ObstacleTrackerNode, 'all_in_one': AllInOneNode}
SOMETIMES = {'/clock', '/parameter_events'}  # with use_sim_time, and in other client libraries


def resolved(names, node):
    return {name.replace('~', f'/{node}') if name[0] == '~' else '/' + name.lstrip('/')
            for name in names}


@pytest.mark.parametrize('name', NODES)
def test_a_node_opens_what_it_is_allowed_and_nothing_else(bench, name):
    bench.peer.create_publisher(FFMPEGPacket, 'video', 10)
    bench.listen(Image, 'image_overlay')  # with which the decoder reads what it draws
    bench.start(NODES[name])
    allowed = security_policy.rights(PAGE)[name]
    peer = bench.peer

    def opened():
        return [{topic for topic, _ in asked(name, '/')} for asked in (
            peer.get_publisher_names_and_types_by_node,
            peer.get_subscriber_names_and_types_by_node,
            peer.get_service_names_and_types_by_node)]

    wanted = [resolved(names, name) for names in (
        allowed.publish, allowed.subscribe, allowed.reply)]
    bench.spin(lambda: bench.peer.count_publishers('/diagnostics'))
    assert bench.spin(lambda: all(w - SOMETIMES <= o for w, o in zip(
        wanted, opened(), strict=True))), opened()
    assert [o - w for w, o in zip(wanted, opened(), strict=True)] == [set()] * 3


OPENED = """
import json
from mv_slapse.nodes import standby
place = standby._place([])
print(json.dumps([[topic for topic, _ in asked(place.get_name(), '/')] for asked in (
    place.get_publisher_names_and_types_by_node, place.get_subscriber_names_and_types_by_node,
    place.get_service_names_and_types_by_node)]))
"""


def test_a_process_that_waits_to_be_the_node_opens_what_each_node_may(ros_domain):
    said = subprocess.run([sys.executable, '-c', OPENED], capture_output=True, check=True,
                          timeout=60, text=True).stdout
    published, subscribed, replied = map(set, json.loads(said))
    assert published <= set(security_policy.PUBLISHED) | SOMETIMES
    assert subscribed | replied == set()
