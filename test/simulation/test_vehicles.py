from dataclasses import replace

from mv_slapse.simulation.paths import Path, steady, with_stop
from mv_slapse.simulation.vehicles import Car, Ride
import numpy as np
import pytest

BEND = Path(((5, 0), (40, 0.03)))


@pytest.fixture
def car():
    return Car(1000, 'car', BEND, 3.0, 10.0, steady(6.0), (0, 0, 0))


@pytest.fixture
def ride(rng):
    return Ride(BEND, with_stop(8.0, 2.0, 3.0), 1.65, 0.8, 80.0, 0.0, (0.0, 0.0, 0.0), 1.0,
                rng.uniform(0, 6, (3, 3)))


@pytest.mark.parametrize('eye', [(0, -1.65, 0), (60, -1.65, 80), (30, -1.65, 0)])
def test_the_velocity_of_a_face_is_how_its_centre_moves(car, eye):
    eye, h = np.array(eye, float), 1e-5
    before, now, after = (car.face_towards(eye, 1.0 + dt) for dt in (-h, 0, h))
    moved = (after.centre - before.centre) / (2 * h)
    np.testing.assert_allclose(moved, now.velocity, atol=1e-7)
    assert np.linalg.norm(now.velocity) > 4


@pytest.mark.parametrize('eye', [(0, -1.65, 0), (60, -1.65, 80), (30, -1.65, 0)])
def test_the_face_towards_the_camera_is_one_of_the_box_and_faces_it(car, eye):
    face = car.face_towards(np.array(eye, float), 1.0)
    centres = car.quads(1.0).corners().mean(1)
    assert np.linalg.norm(centres - face.centre, axis=1).min() < 1e-9
    assert face.normal @ (np.array(eye) - face.centre) > 0


def test_a_car_stands_on_the_ground_and_has_its_size(car):
    corners = car.quads(1.0).corners().reshape(-1, 3)
    assert corners[:, 1].max() == pytest.approx(0, abs=1e-12)
    assert corners[:, 1].min() == pytest.approx(-1.5)
    R, t = car.pose(1.0)
    np.testing.assert_allclose(np.ptp((corners - t) @ R, 0), (1.8, 1.5, 4.2))


def test_a_camera_that_stands_is_still(ride):
    (R, t), (R_later, t_later) = ride.pose(2.1), ride.pose(2.9)
    np.testing.assert_array_equal(R, R_later)
    np.testing.assert_array_equal(t, t_later)
    assert np.abs(ride.pose(1.0)[0] - ride.pose(1.1)[0]).max() > 1e-4


def test_a_camera_looks_where_it_goes(ride):
    ride = replace(ride, vibration=0.0)
    step = ride.pose(1.0)[1] - ride.pose(0.999)[1]
    np.testing.assert_allclose(ride.pose(1.0)[0][:, 2], step / np.linalg.norm(step), atol=1e-2)
    assert ride.pose(1.0)[1][1] == -1.65


def test_a_pan_turns_the_camera_on_the_spot(ride):
    ride = replace(ride, pan=(2.0, 3.0, 0.5))
    turn = ride.pose(2.0)[0].T @ ride.pose(3.0)[0]
    assert np.arctan2(turn[0, 2], turn[0, 0]) == pytest.approx(0.5)
    np.testing.assert_array_equal(ride.pose(2.0)[1], ride.pose(3.0)[1])
