"""(11)-(16) of [MVO] on drawn scenes: planes, speeds and places are those of the truth."""

from functools import partial

from compare import as_trajectory
from mv_slapse.evaluation import trajectory
from mv_slapse.evaluation.detection import grid_index
from mv_slapse.geometry import plane
from mv_slapse.geometry.camera import to_pixels, to_rays
from mv_slapse.simulation import drawn
from mv_slapse.simulation.street import Street, StreetSettings
from numeric import jacobian
import numpy as np
from papers import filters, obstacles, pipelines, two_views
import pytest

K = np.array([[500.0, 0, 320], [0, 510, 240], [0, 0, 1]])
R_WORLD, T_WORLD = filters.euler(np.array([0.1, -0.2, 0.05])), np.array([0.5, -0.2, 3.0])
STATE = np.array([0.01, 0.02, -0.08, 1.0, 0.3, 4.0])
DT = 0.1
# Blocks end at row 286; a tenth of the lowest counts. 12 m away that is the road's.
DOWN = (286 - 0.4 * 16 - K[1, 2]) / K[1, 1]
ROAD = np.array([0, -1 / (12 * DOWN), 0])


def on_plane(n, rng):
    """Return points (50, 3) with n @ X = -1."""
    X = rng.normal(0, 5, (50, 3))
    return X - np.outer((X @ n + 1) / (n @ n), n)


def test_jacobians_have_numerical_twins():
    for function in (lambda x: obstacles.moved(x, DT),
                     lambda x: obstacles.seen(x, R_WORLD, T_WORLD, DT)):
        np.testing.assert_allclose(function(STATE)[1], jacobian(lambda x, f=function: f(x)[0],
                                                                STATE), atol=1e-8)


def test_points_of_a_moving_plane_stay_on_it_and_are_seen_on_it(rng):
    X = on_plane(STATE[:3], rng) + DT * STATE[3:]
    later = obstacles.moved(STATE, DT)[0]
    np.testing.assert_allclose(X @ later[:3], -1)
    z = obstacles.seen(later, R_WORLD, T_WORLD, DT)[0]
    in_camera = (X - T_WORLD) @ R_WORLD
    np.testing.assert_allclose(in_camera @ z[:3], -1)
    before = (X - DT * STATE[3:] - T_WORLD) @ R_WORLD  # t_d: where they were, as of now
    np.testing.assert_allclose(in_camera + z[3:], before)


@pytest.fixture
def pair():
    """Blocks of an upright plane 12 m ahead that drives on: view, R, t, and truth of (16)."""
    R, t = filters.euler(np.array([0.01, 0.03, 0.005])), np.array([0.05, 0.01, -1.2])
    t_d = np.array([0.1, 0, -0.7])
    x = np.stack(np.meshgrid(np.arange(296, 392, 16), np.arange(230.0, 294, 16)), -1)
    X = to_rays(K, x.reshape(-1, 2)) * 12
    view = two_views.View(x.reshape(-1, 2), to_pixels(K, (X + t_d - t) @ R), K)
    return view, R, t, np.r_[0, 0, -1 / 12, t_d]


def test_a_pair_tells_the_product_and_the_road_the_distance(pair):
    view, R, t, truth = pair
    for given, sigma in ((ROAD, 16 / np.sqrt(12) / (K[1, 1] * DOWN)), (None, 1.0)):
        found = obstacles.observed(view, R, t, given, 0.2)
        np.testing.assert_allclose(np.outer(t - found.z[3:], found.z[:3]),
                                   np.outer(t - truth[3:], truth[:3]), atol=1e-6)
        if given is not None:
            np.testing.assert_allclose(found.z, truth, atol=1e-5)
        farther = np.r_[-found.z[:3], found.z[3:] - t]  # by ln Z, at the same rate
        assert farther @ found.information @ farther == pytest.approx(sigma**-2, rel=0.01)
        assert np.linalg.eigvalsh(found.information)[0] > 0
    assert np.linalg.norm(found.z[3:]) < np.linalg.norm(truth[3:])  # the smallest motion


def test_a_tilt_is_held_where_it_is_told(pair):
    view, R, t, _ = pair
    noise = np.random.default_rng(0).normal(0, 0.5, view.x_prev.shape)
    noisy = view._replace(x_prev=view.x_prev + noise)
    tilts = [np.abs(obstacles.observed(noisy, R, t, ROAD, 0.5, tilt).z[:2]).max()
             for tilt in (np.inf, 0.1)]
    assert tilts[1] < 0.1 * tilts[0]


def test_the_road_is_the_levellest_plane_below():
    planes = np.array([[0.0, -0.5, 0.05], [0, -0.6, 0.0], [0, 0.6, 0], [0.3, 0, 0]])
    np.testing.assert_array_equal(obstacles.road_of(planes), planes[1])
    assert obstacles.road_of(planes[2:]) is None
    assert obstacles.road_of(planes[:0]) is None


@pytest.mark.parametrize('speed', [0.0, 3.0])
def test_a_plane_that_stands_still_is_handed_to_the_scene(pair, speed):
    view, R, t, _ = pair
    X = to_rays(K, view.x_cur) * 12
    view = view._replace(x_prev=to_pixels(K, (X + [0, 0, -DT * speed] - t) @ R))
    made = pipelines.Mvo(Street(StreetSettings()).camera)
    made.scene = filters.Mvo(R.T, -R.T @ t, DT)
    made.scene.add_in_camera(7, ROAD)
    made._follow(pipelines.Pair(view, np.full(24, 0.2), None, DT, 5), two_views.Joint(
        R, t / np.linalg.norm(t), None, None), np.zeros(24, int))
    assert made.scene.ids == ([7] if speed else [7, 0])
    assert [row[:2] for row in made.found.obstacles] == [(5, 0)][:int(speed)]
    if not speed:
        depth = -1 / made.scene.in_camera()[1][2]
        assert depth == pytest.approx(12, rel=1e-3)


@pytest.mark.parametrize('name', ['slower', 'faster'])
def test_a_told_car_is_followed(name):
    street = Street(StreetSettings(seed=3, n_frames=65, movers=(name,)))
    rng, frames, car = np.random.default_rng(0), range(0, 64, 4), street.movers[0]
    pairs = {street.stamp(i + 4): drawn.draw(street, i, i + 4, rng, 0.25, 0.1) for i in frames}

    def movers_at(stamp):
        truth, grid = pairs[stamp], np.full(1200, -1)
        cell = grid_index(truth.correspondences.x_cur, 640, 480)
        grid[cell] = np.where(truth.surface == car.id, car.id, -1)
        return grid

    found = pipelines.run(partial(pipelines.Told, movers_at), street.camera,
                          [one.correspondences for one in pairs.values()])
    assert {row[1] for row in found.obstacles} == {car.id}
    path = as_trajectory([(street.stamp(i), *street.pose(i)) for i in (*frames, 64)])
    scale = trajectory.evaluate(as_trajectory(found.poses), path).alignment.scale
    R, t = street.R_world_from_street, street.t_world_from_street
    errors = []
    for row in found.obstacles[5:]:
        eye = street.ride.pose(row[0] * 1e-9)[1]
        face = car.face_towards(eye, row[0] * 1e-9)
        errors.append((np.linalg.norm(scale * np.array(row[6:9]) - R @ face.centre - t)
                       / np.linalg.norm(face.centre - eye),
                       np.linalg.norm(scale * np.array(row[9:12]) - R @ face.velocity)))
        assert np.isfinite(row[12]) == (name == 'slower')
    place, speed = np.median(errors, axis=0)
    assert len(errors) > 6
    assert place < 0.2
    assert speed < 0.8  # of 6 and 12 m/s


def test_a_plane_is_transformed_as_the_package_does_it():
    z, _ = obstacles.seen(STATE, R_WORLD, T_WORLD, DT)
    np.testing.assert_allclose(
        z[:3], plane.transform(STATE[:3], R_WORLD.T, -R_WORLD.T @ T_WORLD))
