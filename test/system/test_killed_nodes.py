"""A node that is killed while a street is driven: what the others keep, and what comes again."""

import pytest

pytest.importorskip('rclpy')
pytest.importorskip('mv_slapse_msgs')
pytest.importorskip('ffmpeg_image_transport_msgs')

from mv_slapse.scene.scale.height import ENOUGH  # noqa: E402
import numpy as np  # noqa: E402
import rclpy  # noqa: E402
from reliability import kills  # noqa: E402

ORDER = ('plane_extraction', 'slam')
LONGEST_PAIR = 4.0  # [m]: 0.4 s at 10 m/s


@pytest.fixture(scope='module')
def outcomes(data, ros_domain, tmp_path_factory):
    """Kill one node after another in one drive; return what came of each."""
    folder, found = tmp_path_factory.mktemp('killed'), {}
    rclpy.init()
    drive, line = kills.Drive(), kills.Line(folder)
    try:
        for name in ORDER:
            assert drive.ready()
            drive.begin()
            found[name] = kills.killed(drive, line, name, True)
    finally:
        codes = line.stop()
        drive.node.destroy_node()
        rclpy.shutdown()
    assert codes == [0] * 4
    return found, (folder / 'obstacle_tracker.log').read_text()


def test_trajectory_and_map_go_on_where_the_extraction_was_killed(outcomes):
    found, _ = outcomes
    assert found['plane_extraction'].same
    assert found['plane_extraction'].missed < 5  # what was driven without a view is predicted


def test_slam_begins_again_at_the_origin_and_says_so(outcomes):
    found, log = outcomes
    assert not found['slam'].same
    # metres are known, and poses come, with the third pair; the fourth is the first heard at most
    assert np.linalg.norm(found['slam'].where) < LONGEST_PAIR * (ENOUGH + 1)
    assert 'slam began anew' in log
