from mv_slapse.errors import UsageError
from mv_slapse.simulation.street import Street, StreetSettings
from mv_slapse.simulation.surfaces import FIRST_MOVER, SKY
from mv_slapse.simulation.traffic import KINDS
import numpy as np
import pytest

VARIANTS = [{}, {'turn': 80.0}, {'turn': -60.0}, {'view': 90.0}, {'speed': -6.0},
            {'movers': KINDS, 'parked': 3}, {'standstill': (0.0, 3.0), 'pan': 90.0}]


@pytest.fixture(scope='module', params=VARIANTS, ids=str)
def street(request):
    return Street(StreetSettings(seed=4, **request.param))


def test_the_world_is_the_camera_of_the_first_frame(street):
    R, t = street.pose(0)
    np.testing.assert_array_equal(R, np.eye(3))
    np.testing.assert_array_equal(t, np.zeros(3))
    R_1, t_1 = street.pose(1)
    assert np.abs(R_1 - R).max() < 0.05
    assert np.linalg.norm(t_1) < 0.5


def test_every_corner_of_a_plane_lies_on_it(street):
    quads = street.quads(0)
    for plane in street.planes:
        corners = quads.corners()[quads.surface == plane.id].reshape(-1, 3)
        assert len(corners)
        np.testing.assert_allclose(corners @ plane.normal, -plane.depth, atol=1e-5)
        assert plane.depth >= 0
        assert np.linalg.norm(plane.normal) == pytest.approx(1)


def test_planes_are_distinct_and_many(street):
    rows = np.array([[*plane.normal, plane.depth] for plane in street.planes])
    gaps = np.abs(rows[:, None] - rows[None]).max(2) + 10 * np.eye(len(rows))
    assert gaps.min() > 1e-6
    assert len(rows) >= 10
    assert street.planes[0].name == 'ground'


def test_a_mover_moves_as_stated_and_the_rest_stands(street):
    i, j = 10, 13
    before, after = street.quads(i), street.quads(j)
    for id_ in np.unique(before.surface):
        on = before.surface == id_
        R, t = (np.eye(3), 0) if id_ < FIRST_MOVER else street.mover_motion(id_, i, j)
        expected = before.corners()[on] @ R.T + t
        np.testing.assert_allclose(after.corners()[on], expected, atol=1e-6)


def test_the_camera_sees_no_surface_from_within(street):
    for i in (0, street.settings.n_frames - 1):
        quads = street.quads_in_camera(i)
        near = quads.inverses()[:, :, 2] @ np.eye(3)   # of the ray along the optical axis
        u, v, w = near.T
        hit = (w > 0) & (u >= 0) & (u <= w) & (v >= 0) & (v <= w)
        assert w[hit & (quads.surface != SKY)].max(initial=0) < 1 / 1.5


def test_seeds_settle_the_street():
    quads = [Street(StreetSettings(seed=seed)).quads(7) for seed in (1, 1, 2)]
    np.testing.assert_array_equal(quads[0].corner, quads[1].corner)
    assert len(quads[0]) != len(quads[2]) or not np.allclose(quads[0].corner, quads[2].corner)


def test_a_bare_road_is_one_plane_below_the_sky():
    street = Street(StreetSettings(seed=4, houses=False, parked=0, movers=()))
    assert [plane.name for plane in street.planes] == ['ground']
    assert set(street.quads(0).surface.tolist()) == {street.planes[0].id, SKY}


def test_an_unknown_mover_is_refused_by_name():
    with pytest.raises(UsageError, match='tank'):
        Street(StreetSettings(movers=('tank',)))


def test_a_setting_out_of_bounds_is_refused_by_name():
    with pytest.raises(UsageError, match='camera_height'):
        StreetSettings(camera_height=0.0)
