"""Which boxes one vehicle may fill, from the corners of drawn vehicles."""

from dataclasses import replace
from types import SimpleNamespace

from mv_slapse.obstacles import footprint
from mv_slapse.obstacles.detection import Detection, Edge
from mv_slapse.records import Label, ScalePrior
import numpy as np
import pytest

K = np.array([[700.0, 0, 640], [0, 700, 360], [0, 0, 1]])
HEIGHT = 1.65
CAMERA = np.array([0.0, 0, 15])  # [m/s]


def view(**changes):
    fields = {'K': K, 'ground': np.array([0, -1 / HEIGHT, 0]), 'metre': 1.0,
              'size': np.array([1280.0, 720.0]), 'scene_velocity': -CAMERA,
              'scene_covariance': 0.01 * np.eye(3)}
    return SimpleNamespace(**fields | changes)


def whole(corners, velocity, depth=None, has_depth=True, speed_sigma=0.5, unit=1.0):
    """Return the detection of what lies between corners (x, z) [m] on the ground."""
    x, z = np.array(corners, float).T
    near = depth or z.min()
    columns = 700 * x / z + 640
    row = 360 + 700 * HEIGHT / near
    # Centres of the outermost blocks of an outline that is half a block too large at either end.
    centres = np.array([[columns.min(), row - 8], [columns.max(), row - 8]])
    middle = (centres.mean(axis=0) - (640, 360)) / 700
    rate = (np.r_[velocity[0], 0, velocity[1]] - CAMERA) / near
    state = np.r_[middle, np.log(near * unit), rate, 0, 0]
    R = np.diag(np.r_[1e-4, 1e-4, 1e-4, np.full(3, (speed_sigma / near)**2), 0.1, 0.1])
    return Detection(1, state, R, has_depth, centres, np.full((2, 2), 16.0),
                     ScalePrior.GROUND_CONTACT, Edge(row, 8.0, 50.0))


def vehicle(x, z, width=2.5, length=12.0):
    return [(x + a * width / 2, z + b * length) for a in (-1, 1) for b in (0, 1)]


CARS = vehicle(3.0, 20.0, 1.8, 4.5) + vehicle(6.5, 20.0, 1.8, 4.5)


@pytest.mark.parametrize('velocity', [(0, 14), (0, -10)], ids=['ahead', 'oncoming'])
@pytest.mark.parametrize('x', [0.0, -3.5, 7.0])
def test_a_bus_may_be_one_wherever_it_is(x, velocity):
    assert footprint.may_be_one(whole(vehicle(x, 12.0), velocity), view())


def test_cars_side_by_side_are_not_one():
    assert footprint.may_be_one(whole(CARS[:4], (0, 14)), view())
    assert not footprint.may_be_one(whole(CARS, (0, 14)), view())


def test_a_lorry_that_crosses_may_be_as_wide():
    assert footprint.may_be_one(whole(CARS, (8, 0)), view())


def test_of_unknown_heading_anything_may_be_one():
    assert footprint.may_be_one(whole(CARS, (0, 0.2)), view())


def test_of_unknown_distance_anything_may_be_one():
    assert footprint.may_be_one(whole(CARS, (0, 14), has_depth=False), view())
    assert footprint.may_be_one(whole(CARS, (0, 14)), view(ground=None))


def test_without_scale_it_goes_by_the_height_of_the_camera():
    free = view(metre=0.1, ground=np.array([0, -10 / HEIGHT, 0]), scene_velocity=-0.1 * CAMERA,
                scene_covariance=1e-4 * np.eye(3))
    assert footprint.may_be_one(whole(CARS[:4], (0, 14), unit=0.1), free)
    assert not footprint.may_be_one(whole(CARS, (0, 14), unit=0.1), free)


def blocks_above(*edges):
    """Return a detection of the blocks above lower edges (x from, x to, row, row) [px]."""
    x = [(at, first + (last - first) * (at - begin) / max(end - begin, 1) - 8 - up)
         for begin, end, first, last in edges for at in range(begin + 8, end, 16)
         for up in range(0, 64, 16)]
    whole_ = whole(CARS, (0, 14))
    return replace(whole_, x=np.array(x, float), block=np.full((len(x), 2), 16.0))


def test_buses_beside_each_other_are_two_where_the_edge_between_them_is_hollow():
    # The rear of the one 9.6 m away, and the side of the other from 9 to 4.6 m.
    found = footprint.bodies(blocks_above((560, 720, 480, 480), (720, 960, 488, 610)), view(), 4)
    near, far = found
    assert (near.id, far.id) == (1, ~1)
    assert near.x[:, 0].min() > far.x[:, 0].max()
    assert abs(far.x[:, 0].max() - 720) < 32
    assert np.exp(far.z[2]) == pytest.approx(9.6, rel=0.08)
    assert np.exp(near.z[2]) == pytest.approx(4.8, rel=0.08)  # its nearest two columns
    np.testing.assert_allclose(near.z[3:6], far.z[3:6])  # one motion, that of the region


@pytest.mark.parametrize('edges', [
    ((560, 960, 520, 520),),  # cars side by side at one distance
    ((560, 720, 520, 600), (720, 960, 600, 500)),  # a corner that points to the camera
    ((560, 576, 480, 480), (576, 960, 500, 610)),  # one has less than the fewest columns
], ids=['straight', 'bulging', 'narrow'])
def test_what_is_not_hollow_stays_one(edges):
    wide = blocks_above(*edges)
    assert not footprint.may_be_one(wide, view())
    assert footprint.bodies(wide, view(), 4) == [wide]


def test_what_may_be_one_vehicle_is_not_divided():
    edges = (560, 720, 480, 480), (720, 960, 488, 610)
    unknown = replace(blocks_above(*edges), R=whole(CARS, (0, 14), speed_sigma=20.0).R)
    assert footprint.bodies(unknown, view(), 4) == [unknown]


# A car ahead at 10 m, and one in the lane beside it at 22 m; a lorry's rear and its side.
NEAR, FAR = vehicle(-1.0, 10.0, 1.8, 4.5)[::2], vehicle(2.5, 22.0, 1.8, 4.5)[::2]
REAR, SIDE = [(-4.2, 12.0), (-1.7, 12.0)], [(-1.7, 16.0), (-1.7, 24.0)]


def scene_with(label, *surfaces):
    """Return an extraction whose blocks have a label below the second of two surfaces."""
    box = surfaces[1].box
    lowest = max(item.edge.row for item in surfaces)
    x, y = np.meshgrid(np.arange(box[0], box[0] + box[2], 8),
                       np.arange(surfaces[1].edge.row + 1, min(lowest, 700), 8))
    return SimpleNamespace(x_cur=np.c_[x.ravel(), y.ravel()], label=np.full(x.size, label))


def stand_apart(near, far, velocity, label=Label.STATIONARY, seen=None, **changes):
    surfaces = [whole(near, velocity, **changes), whole(far, velocity, **changes)]
    if np.ptp(far, axis=0)[1] > 0:  # its farther end is seen higher
        ends = surfaces[1].x - (0, 700 * HEIGHT) * np.c_[[0, 1 / far[0][1] - 1 / far[1][1]]]
        surfaces[1] = replace(surfaces[1], x=ends)
    return footprint.stand_apart(surfaces, scene_with(label, *surfaces), seen or view())


def test_cars_behind_each_other_stand_apart_where_the_road_shows_between_them():
    assert stand_apart(NEAR, FAR, (0, 14))
    assert not stand_apart(NEAR, FAR, (0, 14), Label.MOVING)
    assert not stand_apart(NEAR, FAR, (0, 14), Label.UNKNOWN)


def test_what_hides_all_the_road_below_is_any_part_of_a_vehicle():
    surfaces = [whole(NEAR, (0, 14)), whole(FAR, (0, 14))]
    nothing = SimpleNamespace(x_cur=np.zeros((0, 2)), label=np.zeros(0, int))
    assert not footprint.stand_apart(surfaces, nothing, view())


def test_cars_of_vague_depths_may_be_one():
    surfaces = [whole(NEAR, (0, 14)), whole(FAR, (0, 14))]
    vague = [replace(item, R=item.R + np.diag(np.r_[0, 0, 0.3**2, np.zeros(5)]))
             for item in surfaces]
    scene = scene_with(Label.STATIONARY, *surfaces)
    assert footprint.stand_apart(surfaces, scene, view())
    assert not footprint.stand_apart(vague, scene, view())


def test_rear_and_side_of_a_lorry_do_not_stand_apart():
    assert not stand_apart(REAR, SIDE, (0, 14))
    # That side and the rear of what drives in the next lane do.
    assert stand_apart([(-7.5, 12.0), (-5.0, 12.0)], SIDE, (0, 14))


def test_of_unknown_heading_or_distance_nothing_stands_apart():
    assert not stand_apart(NEAR, FAR, (0, 0.2))
    assert not stand_apart(NEAR, FAR, (0, 14), has_depth=False)
    assert not stand_apart(NEAR, FAR, (0, 14), seen=view(ground=None))
