from dataclasses import replace

import pytest

pytest.importorskip('rclpy')
pytest.importorskip('mv_slapse_msgs')
pytest.importorskip('ffmpeg_image_transport_msgs')

import made_up  # noqa: E402
from mv_slapse import drawing, fields  # noqa: E402
from mv_slapse.fields import stamp_from_message  # noqa: E402
from mv_slapse.nodes.all_in_one import AllInOneNode  # noqa: E402
from mv_slapse.nodes.conversions import to_message  # noqa: E402
from mv_slapse.nodes.decoder import DecoderNode  # noqa: E402
from mv_slapse.records import Label, ObstacleState, ScaleStatus  # noqa: E402
from mv_slapse.ros_frames import RosFrames  # noqa: E402
from mv_slapse_msgs.msg import Correspondences, ObstacleArray, PlaneObservations  # noqa: E402
from nodes import clips  # noqa: E402
from nodes.video import Video  # noqa: E402
import numpy as np  # noqa: E402
from sensor_msgs.msg import Image  # noqa: E402

WIDTH, HEIGHT = clips.SIZE
FRAMES = RosFrames(camera='cam')


def pixels(msg):
    assert (msg.encoding, msg.step, msg.width, msg.height) == ('bgr8', 3 * WIDTH, WIDTH, HEIGHT)
    return np.frombuffer(msg.data, np.uint8).reshape(HEIGHT, WIDTH, 3).astype(int)


def test_all_in_one_draws_into_its_key_pictures_while_somebody_looks(bench):
    pairs = bench.listen(Correspondences, 'correspondences')
    video = Video(bench, AllInOneNode)
    video.connect()
    video.works()
    assert not video.node._decoding.overlay._pictures  # nobody looks: nothing is kept
    seen = bench.listen(Image, 'image_overlay')
    assert bench.spin(lambda: video.node.count_subscribers('image_overlay'))
    bench.spin(lambda: False, 0.3)
    seen.clear()
    video.send()
    assert bench.spin(lambda: len(seen) > 5 and len(pairs) > 5)
    bench.spin(lambda: False, 0.3)
    assert {stamp_from_message(msg.header.stamp) for msg in seen} <= {
        stamp_from_message(msg.header.stamp) for msg in pairs}
    shown = pixels(seen[-1])
    assert np.mean(np.ptp(shown, axis=2) > 30) > 0.1  # coloured blocks
    at = (stamp_from_message(seen[-1].header.stamp) - video.start) // 100_000_000
    given = clips.pictures()[at].ravel()
    assert np.corrcoef(shown.mean(axis=2).ravel(), given)[0, 1] > 0.8


@pytest.fixture
def watched(bench):
    """A decoder whose overlay somebody looks at; returns what is needed to tell it things."""
    seen = bench.listen(Image, 'image_overlay')
    pairs = bench.listen(Correspondences, 'correspondences')
    video = Video(bench, DecoderNode)
    video.connect()
    observations = bench.advertise(PlaneObservations, 'planes/observations')
    obstacles = bench.advertise(ObstacleArray, 'obstacles')
    video.works()
    assert bench.spin(lambda: len(pairs) > 3)
    return video, seen, [stamp_from_message(pair.header.stamp) for pair in pairs], (
        observations, obstacles)


def found(stamp):
    """Return observations that show one plane on all macroblocks."""
    n = (WIDTH // 16) * (HEIGHT // 16)
    record = made_up.extraction(np.random.default_rng(0), stamp=stamp)
    return to_message(PlaneObservations, fields.extraction_to_fields(replace(
        record, previous_stamp=stamp - 10**8, width=WIDTH, height=HEIGHT,
        macroblock_label=np.full(n, Label.STATIONARY, np.int8),
        macroblock_plane=np.zeros(n, np.int32)), FRAMES))


def moving(stamp):
    obstacle = replace(made_up.obstacle(np.random.default_rng(0), stamp=stamp),
                       state=ObstacleState.CONFIRMED, box=np.array([50.0, 40, 30, 20]))
    return to_message(ObstacleArray, fields.obstacles_to_fields(
        stamp, [obstacle], ScaleStatus.METRIC, FRAMES))


def test_the_decoder_draws_what_the_other_nodes_have_found(bench, watched):
    _, seen, stamps, (observations, obstacles) = watched
    observations.publish(found(stamps[1]))
    bench.spin(lambda: False, 0.2)
    assert seen == []  # it waits for the obstacles
    obstacles.publish(moving(stamps[1]))
    assert bench.spin(lambda: len(seen) == 1)
    assert stamp_from_message(seen[0].header.stamp) == stamps[1]
    assert seen[0].header.frame_id == 'cam'
    np.testing.assert_array_equal(pixels(seen[0])[50, 50], drawing.RED)  # the box's left side


def test_without_obstacles_it_draws_at_the_next_key_frame(bench, watched):
    _, seen, stamps, (observations, _) = watched
    for stamp in stamps[1:3]:
        observations.publish(found(stamp))
    assert bench.spin(lambda: len(seen) == 1)
    assert np.mean(np.ptp(pixels(seen[0]), axis=2) > 30) > 0.9


def test_the_decoder_subscribes_only_while_somebody_looks(bench, watched):
    video, *_ = watched
    for subscription in list(bench.peer.subscriptions):
        if subscription.topic_name == '/image_overlay':
            bench.peer.destroy_subscription(subscription)
    assert bench.spin(lambda: not video.node.count_subscribers('/planes/observations'))
    assert bench.spin(lambda: not video.node.count_subscribers('/obstacles'))
    video.send()
    bench.spin(lambda: False, 0.5)
    assert not video.node._decoding.overlay._pictures
