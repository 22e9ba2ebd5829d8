from dataclasses import replace
import itertools

import cv2
from formulas import distort
from mv_slapse.geometry.camera import to_pixels
from mv_slapse.simulation.flight import (
    FISHEYE,
    Flight,
    FlightSettings,
    MIDDLE,
    ON_THE_GROUND,
    ROOM,
    SWAY,
    WIDE,
)
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


def steps(flight):
    """Return the speed [m/s] and the angle [rad] between frames (N - 1,)."""
    poses = [flight.pose(i) for i in range(flight.settings.n_frames)]
    place = np.array([t for _, t in poses])
    cosine = [(np.trace(a.T @ b) - 1) / 2 for (a, _), (b, _) in itertools.pairwise(poses)]
    return (np.linalg.norm(np.diff(place, axis=0), axis=1) * flight.settings.fps,
            np.arccos(np.clip(cosine, -1, 1)))


def test_a_flight_stops_and_hovers_when_it_is_told_to():
    flight = Flight(settings=FlightSettings(fps=20.0, n_frames=260, size=2.0, stops=(2.0,),
                                            hovers=(7.0,)))
    speed, angle = steps(flight)
    at = (np.arange(259) + 0.5) / 20
    stopped, hovering = (at > 2) & (at < 4), (at > 7) & (at < 10)
    assert max(speed[stopped].max(), angle[stopped].max()) < 1e-6
    assert 0 < speed[hovering].max() < 6 * SWAY
    assert np.median(angle[hovering]) > 0.003
    assert np.median(speed[(at > 4.8) & (at < 6)]) > 1


def test_a_flight_takes_off_from_the_ground_of_its_hall():
    flight = Flight(settings=FlightSettings(fps=20.0, n_frames=120, size=2.0, take_off=1.0))
    speed, _ = steps(flight)
    assert speed[:20].max() < 1e-6 < speed[22]
    places = np.array([flight._pose_in_room(i / 20)[1] for i in range(120)])
    assert places[0, 1] == pytest.approx(ON_THE_GROUND)
    assert np.all(np.abs(places[-1] - 2 * MIDDLE) < np.array(ROOM))
    assert places[-1, 1] < -3
    assert np.ptp(flight.quads_in_camera(0).corners()[:6].reshape(-1, 3) @ flight._start[0].T,
                  axis=0) == pytest.approx(2 * np.array(ROOM))


def test_little_light_and_a_long_exposure_darken_and_blur_what_turns():
    settings = FlightSettings(n_frames=2, noise=0.0, spin=2.0)
    bright, dark, blurred = (next(Flight(WIDE, change(settings)).pictures()).astype(float)
                             for change in (lambda s: s, lambda s: replace(s, light=0.5),
                                            lambda s: replace(s, shutter=0.03)))
    np.testing.assert_allclose(dark, bright / 2, atol=1.5)
    assert blurred.mean() == pytest.approx(bright.mean(), rel=0.02)
    assert np.abs(np.diff(blurred, axis=1)).mean() < 0.8 * np.abs(np.diff(bright, axis=1)).mean()
