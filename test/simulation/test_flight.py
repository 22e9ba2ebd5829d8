import cv2
from formulas import distort
from mv_slapse.geometry.camera import to_pixels
from mv_slapse.simulation.flight import FISHEYE, Flight, FlightSettings, MIDDLE, ROOM, WIDE
import numpy as np
import pytest


@pytest.mark.parametrize('seed', range(3))
def test_the_flight_stays_in_the_room_and_starts_at_the_world(seed):
    flight = Flight(settings=FlightSettings(seed=seed, speed=5.0))
    R, t = flight.pose(0)
    np.testing.assert_allclose(R, np.eye(3), atol=1e-12)
    np.testing.assert_allclose(t, 0, atol=1e-12)
    for i in range(0, 400, 10):
        place = flight._pose_in_room(i / 20)[1]
        assert np.all(np.abs(place - MIDDLE) < np.array(ROOM) / 2)


def test_the_mean_speed_is_about_the_one_asked_for():
    flight = Flight(settings=FlightSettings(speed=2.0))
    places = np.array([flight.pose(i)[1] for i in range(1000)])
    speed = np.linalg.norm(np.diff(places, axis=0), axis=1).mean() * 25
    assert speed == pytest.approx(2.0, rel=0.3)


@pytest.mark.parametrize('lens', [WIDE, FISHEYE])
def test_the_picture_shows_a_corner_of_the_room_where_the_lens_does(lens):
    """An edge between two quads of different shade lies where the lens projects it."""
    flight = Flight(lens, FlightSettings(noise=0.0, furniture=0))
    quads = flight.quads_in_camera(0)
    corners = quads.corners().reshape(-1, 3)
    seen = corners[(corners[:, 2] > 1)]
    ideal = to_pixels(flight.camera.K, seen)
    shown = distort(lens, to_pixels(lens.K, seen))
    for there, here in zip(ideal, shown, strict=True):
        if np.all((here > 1) & (here < (lens.width - 2, lens.height - 2))):
            column, row = np.round(here).astype(int)
            assert np.hypot(*(flight._map[row, column] - there)) < 2.5


def test_pictures_have_the_size_of_the_lens_and_a_pattern():
    flight = Flight(WIDE, FlightSettings(n_frames=2))
    first, second = flight.pictures()
    assert first.shape == (WIDE.height, WIDE.width)
    assert first.std() > 15
    moved = np.abs(first.astype(float) - second).mean()
    blurred = cv2.GaussianBlur(first, (0, 0), 3)
    assert 2 < moved < np.abs(first.astype(float) - np.roll(blurred, 40, 1)).mean()


@pytest.mark.parametrize('seed', [10, 15, 17])
def test_furniture_in_the_way_is_left_out(seed):
    settings = FlightSettings(seed=seed, furniture=8, n_frames=200)
    flight = Flight(settings=settings)
    boxes = flight.quads_in_camera(0).corners()[6:].reshape(-1, 24, 3)
    way = np.array([flight.pose(i)[1] for i in range(settings.n_frames)])
    R, _ = flight._start
    low, high = (limit(boxes @ R.T, axis=1)[:, None] for limit in (np.min, np.max))
    assert 0 < len(boxes) < 8
    assert not np.any(np.all((way @ R.T > low) & (way @ R.T < high), axis=2))
