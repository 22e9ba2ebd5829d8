"""Which blocks tell nothing sure of the camera's motion, in scenes that one can check by hand."""

from mv_slapse.geometry import two_view
from mv_slapse.geometry.camera import to_rays
from mv_slapse.movers import possibly_dynamic
from mv_slapse.records import (
    CameraMotion,
    Extraction,
    Label,
    MotionStatus,
    PlaneObservation,
    SegmentKind,
)
import numpy as np
import pytest

K = np.array([[500.0, 0, 319.5], [0, 500.0, 239.5], [0, 0, 1]])
FORWARD = np.array([0.0, 0.0, -1.0])  # the camera moves on by one baseline
GROUND = np.array([0.0, -0.8, 0.0])  # 1.25 baselines below it
LATTICE = np.stack(np.mgrid[7.5:640:16, 7.5:480:16], 2).reshape(-1, 2)


def before(x, depth, moved=(0.0, 0.0, 0.0)):
    """Return where points seen at x, at a depth, were one pair ago, if they moved meanwhile."""
    X = to_rays(K, x) * np.reshape(depth, (-1, 1)) - FORWARD - np.array(moved)
    return (X / X[:, 2:] @ K.T)[:, :2]


def depths_of(x, x_prev):
    rays = to_rays(K, x)
    rho, per_pixel = two_view.inverse_depth(rays, to_rays(K, x_prev), np.diag(K)[:2], np.eye(3),
                                            FORWARD)
    return rays, rho, 0.3 * per_pixel


def test_what_drives_ahead_on_the_road_looks_farther_than_the_road():
    x = np.array([[320.0, 300.0], [320.0, 340.0], [100.0, 300.0], [320.0, 200.0]])
    road = 1.25 / to_rays(K, x)[:, 1]
    depth = np.where(road > 0, road, 30.0)
    for speed, expected in ((0.0, []), (0.5, [0, 1, 2]), (1.0, [0, 1, 2]), (-0.5, [])):
        pair = depths_of(x, before(x, depth, (0.0, 0.0, speed)))
        found = possibly_dynamic.below(*pair, GROUND)
        assert np.flatnonzero(found).tolist() == expected


def test_an_unsure_ground_calls_less_below_it():
    x = np.array([[320.0, 340.0]])
    pair = depths_of(x, before(x, 1.25 / to_rays(K, x)[:, 1] * 1.6))
    assert possibly_dynamic.below(*pair, GROUND).all()
    assert not possibly_dynamic.below(*pair, GROUND, 0.2).any()


@pytest.fixture
def ahead():
    """Return a pair in which a car drives ahead, as fast as the camera, before a far facade."""
    x = LATTICE
    car = np.all((x > (250, 240)) & (x < (390, 330)), axis=1)
    depth = np.where(car, 6.0, 100.0)
    shown = before(x, depth)
    shown[car] = before(x[car], 6.0, -FORWARD)
    observed = PlaneObservation(100_000, Label.MOVING, np.array([0, 0, -1 / 6]), np.eye(6),
                                -FORWARD, np.outer(np.zeros(3), [0, 0, -1 / 6]))
    return Extraction(
        1, 0, 640, 480, SegmentKind.PP, K,
        CameraMotion(MotionStatus.MOVING, np.eye(3), FORWARD), (observed,),
        x_cur=x.astype(np.float32), x_prev=shown.astype(np.float32),
        sigma=np.full(len(x), 0.3, np.float32), block=np.full((len(x), 2), 16, np.uint8),
        label=np.where(car, Label.MOVING, Label.INFINITY).astype(np.int8),
        plane_id=np.where(car, 100_000, -1).astype(np.int32))


def parallax_of(shown):
    return np.linalg.norm(shown.x_cur - shown.x_prev, axis=1).astype(float)


def test_around_a_mover_only_what_moves_as_it_does_is_doubtful(ahead):
    found = possibly_dynamic.like_movers(ahead, parallax_of(ahead))
    x, far = ahead.x_cur, ahead.label == Label.INFINITY
    still = np.linalg.norm(ahead.x_cur - ahead.x_prev, axis=1)
    near_top = far & (np.abs(x[:, 0] - 320) < 60) & (x[:, 1] > 180) & (x[:, 1] < 230)
    assert near_top.sum() > 10
    assert found[near_top].all()
    assert not found[(x[:, 1] < 100) | (np.abs(x[:, 0] - 320) > 120)].any()
    assert not found[still > 2].any()
    assert not found[ahead.label == Label.MOVING].any()


def test_nothing_is_doubtful_without_movers(ahead):
    ahead = Extraction(**{**vars(ahead), 'planes': ()})
    assert not possibly_dynamic.like_movers(ahead, parallax_of(ahead)).any()


def test_blocks_that_come_from_a_mover_are_held(ahead):
    grid = possibly_dynamic.painted(ahead)
    x = np.array([[320.0, 280.0], [260.0, 300.0], [200.0, 280.0], [320.0, 100.0], [-40.0, 280.0]])
    assert possibly_dynamic.taken(grid, x).tolist() == [True, True, False, False, False]
    assert not possibly_dynamic.taken(None, x).any()


def test_movers_that_fill_the_picture_are_not_left_out():
    held = np.arange(100) < 60
    assert np.array_equal(possibly_dynamic.without(held), ~held)
    assert possibly_dynamic.without(np.arange(100) < 80).all()
    assert possibly_dynamic.without(np.arange(20) < 12).all()
