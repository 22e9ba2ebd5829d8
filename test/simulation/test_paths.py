from mv_slapse.simulation.paths import Path, SpeedProfile, steady, with_stop
import numpy as np
import pytest


def test_a_quarter_turn_to_the_right_ends_beside_its_start():
    place = Path(((5, 0), (10 * np.pi / 2, 0.1))).at(5 + 10 * np.pi / 2)
    np.testing.assert_allclose(place.position, (10, 15), atol=1e-12)
    assert place.heading == pytest.approx(np.pi / 2)
    np.testing.assert_allclose(place.beside(2), (10, 13), atol=1e-12)


@pytest.mark.parametrize('s', [-3.0, 2.0, 9.0, 24.0, 60.0])
def test_the_heading_is_the_direction_in_which_the_path_goes(s):
    path = Path(((5, 0), (15, -0.04), (10, 0.05)), origin=(1, 2), heading=0.3)
    step = (path.at(s + 1e-5).position - path.at(s - 1e-5).position) / 2e-5
    np.testing.assert_allclose(step, path.at(s).ahead, atol=1e-9)


def test_a_straight_has_stations_at_its_ends_only_and_an_arc_every_few_metres():
    path = Path(((12, 0), (20, 0.05)))
    np.testing.assert_allclose(path.stations(-5, 40), [-5, 0, 12, 16, 20, 24, 28, 32, 40])
    np.testing.assert_allclose(Path().stations(-5, 40), [-5, 40])


@pytest.mark.parametrize('profile', [
    steady(7.0), with_stop(8.0, 2.0, 3.0), with_stop(8.0, 0.0, 3.0), with_stop(8.0, 0.5, 3.0),
    SpeedProfile((1.0, 2.0), (0.0, -4.0))])
def test_distance_is_the_integral_of_speed(profile):
    times = np.linspace(-1, 8, 9001)
    speeds = np.array([profile.speed(t) for t in times])
    steps = (speeds[1:] + speeds[:-1]) / 2 * np.diff(times)
    expected = np.r_[0, np.cumsum(steps)]
    found = np.array([profile.distance(t) for t in times])
    np.testing.assert_allclose(found - found[0], expected, atol=2e-3)
    assert profile.distance(0.0) == 0


def test_a_stop_is_a_stop():
    profile = with_stop(8.0, 2.0, 3.0, ramp=1.0)
    assert profile.distance(3.0) == profile.distance(2.0)
    assert (profile.speed(0.9), profile.speed(2.5), profile.speed(4.1)) == (8.0, 0.0, 8.0)
