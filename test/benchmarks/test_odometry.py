"""The odometries to compare with find the way along a street."""

from mv_slapse.geometry import rotation
from mv_slapse.simulation.render import Renderer
from mv_slapse.simulation.street import Street, StreetSettings
import numpy as np
import odometry
import pytest

STREET = Street(StreetSettings(n_frames=13, fps=15.0, width=480, height=352, focal=375.0,
                               movers=()))


@pytest.fixture(scope='module')
def images():
    return [frame.image for frame in Renderer(STREET).frames()]


@pytest.mark.parametrize('walk', [odometry.corner_tracking, odometry.orb_matching])
def test_a_drive_is_found(images, walk):
    def length(i, j):
        return np.linalg.norm(STREET.pose(j)[1] - STREET.pose(i)[1])

    poses = walk(images, STREET.camera.K, length)
    assert len(poses) > 3
    assert poses[-1].index > 9
    for pose in poses:
        R, t = STREET.pose(pose.index)
        R_start, t_start = STREET.pose(0)
        way = R_start.T @ (t - t_start)
        assert np.linalg.norm(pose.t - way) < 0.1 + 0.1 * np.linalg.norm(way)
        assert rotation.angle(pose.R.T @ R_start.T @ R) < 0.03


@pytest.mark.parametrize('walk', [odometry.corner_tracking, odometry.orb_matching])
def test_a_camera_at_rest_stays(images, walk):
    assert len(walk([images[0]] * 3, STREET.camera.K, lambda i, j: 1.0)) == 1
