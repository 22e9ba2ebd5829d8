"""What the camera would run into: each kind comes within reach of its way, and in time."""

from mv_slapse.simulation import traffic, truth
from mv_slapse.simulation.street import Street, StreetSettings
import numpy as np
import pytest

FPS = 10.0


def seen(kind, time, **settings):
    """Return the truth of a street's mover at a time [s], as if it covered half the picture."""
    street = Street(StreetSettings(seed=3, fps=FPS, n_frames=60, movers=(kind,), **settings))
    surface = np.full((480, 640), 0)
    surface[100:300, 200:400] = 1000
    return truth.mover_truths(street, round(FPS * time), surface,
                              truth.block_surfaces(surface))[0]


@pytest.mark.parametrize('kind', traffic.AHEAD)
def test_a_hazard_will_be_met_on_the_way_within_two_seconds(kind):
    found = seen(kind, 3.5 if kind == 'crossing_ahead' else 3.0)
    assert found.aside < 1.2
    assert 0.3 < found.time_to_contact < 2.5


@pytest.mark.parametrize('kind', traffic.LEADERS)
def test_a_leader_drives_ahead_at_its_speed(kind):
    found = seen(kind, 1.0, sway=0.0, vibration=0.0)
    speed = traffic.LEADERS[kind]
    np.testing.assert_allclose(np.linalg.norm(found.velocity), speed)
    np.testing.assert_allclose(found.closing, 10.0 - speed, atol=1e-3)
    assert 3.4 < found.time_to_contact < 4.0
    assert found.range == pytest.approx(found.closing * found.time_to_contact, rel=0.02)


def test_what_drives_in_the_next_lane_comes_no_nearer_than_its_side():
    found = seen('slower', 1.0, sway=0.0, vibration=0.0)
    np.testing.assert_allclose(found.aside, traffic.RIGHT_LANE - 0.9, atol=1e-3)


def test_what_goes_away_and_what_stands_before_a_standing_camera_is_never_met():
    assert seen('faster', 1.0).aside == np.inf
    assert seen('slower', 1.0, standstill=(0.0, 3.0)).aside == np.inf


def test_a_car_that_cuts_in_begins_in_the_next_lane_and_ends_in_the_own():
    lateral = [seen('cut_in', time, sway=0.0, vibration=0.0).position[0] for time in (0.0, 4.0)]
    np.testing.assert_allclose(lateral, [traffic.RIGHT_LANE, 0.0], atol=0.1)


def test_a_pedestrian_crosses_from_the_right():
    found = seen('pedestrian', 1.0, sway=0.0, vibration=0.0)
    assert found.velocity[0] == pytest.approx(-1.4, abs=0.01)
    assert found.position[0] > 3


def test_cars_may_stand_close_by():
    street = Street(StreetSettings(seed=3, parked=2, parking=3.0))
    side = next(plane for plane in street.planes if plane.name == 'parked car 0')
    assert side.corners[:, 0].min() > 1.5


def test_shadows_lie_on_the_road_and_change_nothing_else():
    plain, shaded = (Street(StreetSettings(seed=3, shadows=n)) for n in (0, 7))
    assert len(shaded.quads(0)) == len(plain.quads(0)) + 7
    assert shaded.names == plain.names
