"""Obstacles of the last key frame against annotated vehicles."""

from mv_slapse.evaluation import annotation
from mv_slapse.storage.tum import Trajectory
import numpy as np
import pytest

CONTENT = [{'bbox': {'left': 100, 'top': 50, 'right': 180, 'bottom': 110},
            'position': [20.0, 2.0], 'velocity': [-3.0, 0.5]}]
# The camera drives 1 m in 0.1 s along its axis, which is the world's x axis.
PATH = Trajectory(np.array([0, 100_000_000]), np.array([[4.0, 0, 0], [5.0, 0, 0]]),
                  np.tile([0, np.sqrt(0.5), 0, np.sqrt(0.5)], (2, 1)))


def obstacles(state='confirmed', stamp=100_000_000, x=100.0):
    """Return one obstacle 20 m ahead, 2 m to the right, 3 m/s slower than the camera."""
    row = {'stamp': stamp, 'id': 7, 'x': x, 'y': 50, 'width': 80, 'height': 60, 'px': 25.0,
           'py': 1.0, 'pz': -2.0, 'vx': 7.0, 'vy': 0.0, 'vz': -0.5}
    return {'state': np.array([state]), **{name: np.array([value]) for name, value in row.items()}}


def figures(table, is_metric=True):
    return annotation.figures(table, 100_000_000, PATH, annotation.vehicles(CONTENT), is_metric)


def test_an_obstacle_on_the_vehicle_has_no_error():
    found = figures(obstacles())
    assert (found['annotated_vehicles'], found['annotated_vehicles_met']) == (1, 1)
    assert found['annotated_position_error_percent'] == pytest.approx(0, abs=1e-9)
    assert found['annotated_velocity_error_m_s'] == pytest.approx(0, abs=1e-9)


def test_errors_are_relative_to_the_camera():
    table = obstacles()
    table['pz'] -= 2.0
    table['vx'] += 1.5
    found = figures(table)
    assert found['annotated_position_error_percent'] == pytest.approx(100 * 2 / np.hypot(20, 2))
    assert found['annotated_velocity_error_m_s'] == pytest.approx(1.5)


@pytest.mark.parametrize('table', [obstacles('tentative'), obstacles(stamp=0), obstacles(x=190.0)],
                         ids=['tentative', 'earlier', 'beside'])
def test_other_obstacles_do_not_meet_it(table):
    assert figures(table)['annotated_vehicles_met'] == 0


def test_without_metric_scale_there_are_no_errors():
    found = figures(obstacles(), is_metric=False)
    assert found['annotated_vehicles_met'] == 1
    assert found['annotated_position_error_percent'] is None
