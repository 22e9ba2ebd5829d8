import pytest


@pytest.fixture
def bench(ros_domain):
    """ROS with a peer node for the node under test; skips where ROS is absent."""
    pytest.importorskip('rclpy')
    pytest.importorskip('mv_slapse_msgs')
    from nodes import bench as module
    with module.bench() as made:
        yield made
