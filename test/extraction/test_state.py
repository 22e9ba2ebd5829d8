"""What one pair leaves for the next."""

from dataclasses import replace

from mv_slapse.extraction.state import Memory
from mv_slapse.geometry import rotation
from mv_slapse.records import CameraMotion, Extraction, MotionStatus, SegmentKind
from mv_slapse.surfaces.block_map import BaselineRatio
from mv_slapse.surfaces.ground import GroundTrack, Mount
from mv_slapse.surfaces.plane_track import KnownPlanes
import numpy as np
import pytest

MEMORY = Memory(stamp=200, previous_stamp=100)


def pair(previous, stamp):
    return Extraction(stamp, previous, 640, 480, SegmentKind.PP, np.eye(3),
                      CameraMotion(MotionStatus.UNKNOWN))


def test_at_an_unchanged_speed_the_baseline_grows_with_the_time():
    assert MEMORY.log_ratio(pair(200, 400), BaselineRatio()) == (pytest.approx(np.log(2)), 0.15)


def test_a_ratio_that_is_seen_counts():
    assert MEMORY.log_ratio(pair(200, 400), BaselineRatio(0.3, 0.01)) == (0.3, 0.01)


def test_after_a_stop_any_ratio_may_be():
    log, sigma = replace(MEMORY, previous_stamp=None).log_ratio(pair(200, 300), BaselineRatio())
    assert log == 0.0
    assert sigma > 1.0


def test_a_turn_on_the_spot_turns_planes_and_forgets_places():
    R = rotation.exp(np.array([0.0, 0.1, 0.02]))
    wall, floor = np.array([-0.2, 0.0, -0.1]), np.array([0.0, -0.6, 0.05])
    memory = replace(MEMORY, ground=GroundTrack(Mount(), 0, floor, 0.1), movers=np.ones((2, 2)),
                     planes=KnownPlanes(wall[None], np.diag([1.0, 2.0, 3.0])[None],
                                        *np.ones((3, 1), int)))
    turned = memory.turned(300, R)
    point = np.array([1.0, 0.5, 8.0])
    assert turned.planes.plane[0] @ (R @ point) == pytest.approx(wall @ point)
    assert turned.ground.plane @ (R @ point) == pytest.approx(floor @ point)
    np.testing.assert_allclose(turned.planes.covariance[0], R @ np.diag([1.0, 2.0, 3.0]) @ R.T)
    assert turned.movers is None
    assert turned.stamp == 300
