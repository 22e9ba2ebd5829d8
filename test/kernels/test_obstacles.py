"""The kernels of obstacles against their formulas in numpy, on drawn states and regions."""

from types import SimpleNamespace

from mv_slapse.geometry.blocks import COVERED, MACROBLOCK
from mv_slapse.geometry.camera import to_rays
from mv_slapse.kernels.binding import compiled
from mv_slapse.obstacles import detection as rules
from mv_slapse.obstacles import motion_model as om
from mv_slapse.obstacles import redetection
import numpy as np
import obstacles_reference as reference
import pytest
from scipy.optimize import linear_sum_assignment
from scipy.spatial.transform import Rotation

K = np.array([[500.0, 0, 320], [0, 510, 240], [0, 0, 1]])
LIMIT = 9.2


def covariance(rng, n, scale=0.1):
    A = rng.normal(size=(n, n))
    return scale**2 * (A @ A.T + 0.1 * np.eye(n))


def state(rng):
    return np.r_[rng.normal(0, 0.2, 2), rng.normal(2.5, 0.4), rng.normal(0, 0.4, 3),
                 rng.normal(0, 0.4, 2)]


def turned(rng):
    return Rotation.from_rotvec(rng.normal(0, 0.03, 3)).as_matrix()


def camera(rng):
    return SimpleNamespace(
        K=K, R_cur_from_prev=turned(rng), t_cur_from_prev=rng.normal(0, 0.3, 3), dt=0.1,
        rotation_covariance=covariance(rng, 3, 1e-3), size=np.array([640.0, 480.0]),
        ground=np.array([0.02, -0.6, 0.01]))


def region(rng, many=12):
    """Return blocks of a lattice with holes and strays, some at the picture's edge."""
    cells = np.unique(rng.normal(rng.uniform(0, 30, 2), (3, 2), (many, 2)).astype(int), axis=0)
    return 16.0 * cells + 7.5, rng.choice([8.0, 16.0], (len(cells), 2))


def same(found, expected):
    assert (found is None) == (expected is None)
    for own, other in zip(found or (), expected or (), strict=True):
        np.testing.assert_allclose(own, other, rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize('seed', range(8))
def test_states_move_as_by_the_formula(seed):
    rng = np.random.default_rng(seed)
    mu, P, scene, wrong = state(rng), covariance(rng, 8), rng.normal(0, 4, 3), covariance(rng, 3)
    step = om.CameraStep(turned(rng), rng.normal(0, 0.5, 3), 0.1, scene, covariance(rng, 3))
    behind = step._replace(t_cur_from_prev=np.array([0, 0, -100.0]))
    for moved in (step, behind):
        same(om.predict(mu, moved, scene, wrong, 2.0),
             reference.predict(mu, moved, scene, wrong, 2.0))
    same(om.motion(mu, P, scene, wrong), reference.motion(mu, P, scene, wrong))
    for nearer in (0.0, 0.12):
        assert om.moving_statistic(mu, P, scene, wrong, nearer) == pytest.approx(
            reference.moving_statistic(mu, P, scene, wrong, nearer), rel=1e-9)


@pytest.mark.parametrize('seed', range(4))
def test_obstacles_are_published_as_by_the_formula(seed):
    rng = np.random.default_rng(seed)
    mu, P, extent = state(rng), covariance(rng, 8), np.array([200.0, 150, 120, 80])
    view = (K, turned(rng), rng.normal(0, 5, 3), rng.normal(0, 4, 3), covariance(rng, 3))
    foot = (300.0, 0.1, np.array([0.02, -0.6, 0.01]), covariance(rng, 3, 0.01))
    for some in (foot, None):
        same(compiled.obstacle_in_world(mu, P, extent, view, 0.03, some),
             reference.obstacle_in_world(mu, P, extent, view, 0.03, some))


@pytest.mark.parametrize('rows', [range(8), (0, 1, 6, 7), (0, 1, 3, 4, 5)])
def test_elements_are_corrected_as_by_the_formula(rng, rows):
    mu, z, P, R = state(rng), state(rng), covariance(rng, 8), covariance(rng, 8)
    rows = np.array(rows)
    same(compiled.correct_elements(mu, P, z, R, rows), reference.correct(mu, P, z, R, rows))
    S, off = (P + R)[np.ix_(rows, rows)], (z - mu)[rows]
    assert compiled.element_distance(mu, P, z, R, rows) == pytest.approx(
        off @ np.linalg.solve(S, off), rel=1e-9)


@pytest.mark.parametrize('seed', range(8))
def test_regions_have_the_outlines_of_the_formula(seed):
    rng = np.random.default_rng(seed)
    (x, block), (other, _), view = region(rng), region(rng, 40), camera(rng)
    box = reference.box_of(x, block)
    same([rules.box_of(x, block), rules.body_box(x, block)],
         [box, reference.body_box(x, block)])
    same([rules.bearing_covariance(box, block, view)],
         [reference.bearing_covariance(box, block, K, view.size)])
    for some in (other, x, x[::2] + 3):
        assert compiled.shared_cells(x, some, MACROBLOCK) == reference.shared_cells(x, some)


@pytest.mark.parametrize('seed', range(24))
def test_a_lower_edge_is_hollow_as_by_the_formula(seed):
    rng = np.random.default_rng(seed)
    n, (a, b) = rng.integers(3, 24), rng.uniform(-0.8, 0.8, 2)
    at = 16 * np.arange(n) + rng.uniform(0, 8)
    low = 300 + np.maximum(a * (at - at[n // 2]), b * (at - at[n // 2])) + rng.uniform(-4, 4, n)
    x = np.concatenate([np.c_[at, low - 8], np.c_[at, low - 24]])
    block = np.full(x.shape, 16.0)
    found = compiled.hollow(x, block, MACROBLOCK, 20.0, 2)
    assert found == pytest.approx(reference.hollow(x, block, 20.0, 2), nan_ok=True)


@pytest.mark.parametrize('seed', range(12))
def test_a_plane_keeps_its_largest_part(seed):
    rng = np.random.default_rng(seed)
    cells = np.unique(rng.integers(0, 12, (30, 2)), axis=0)
    x, block = (16 * cells + 7.5).astype(np.float32), np.full(cells.shape, 16, np.uint8)
    owner = rng.integers(3, 5, len(cells)).astype(np.int32)
    for number in (3, 4, 5):
        same(compiled.largest_part(x, block, owner, number, MACROBLOCK),
             reference.largest_part(x, block, owner, number))


@pytest.mark.parametrize('seed', range(12))
def test_regions_are_states_as_by_the_formula(seed):
    rng = np.random.default_rng(seed)
    (x, block), view, P = region(rng), camera(rng), covariance(rng, 6)
    plane = np.r_[rng.normal(0, 0.05, 2), rng.choice([-0.1, -0.1, 0.1]), rng.normal(0, 0.3, 3)]
    shown = (K, view.t_cur_from_prev, view.dt, view.size, 1.7)
    found = compiled.region_state(plane[:3], plane[3:], P, x, block, shown, rules.SHARES,
                                  om.SLOPE_LIMIT, COVERED)
    scale = np.repeat([1 / 1.7, 1.7], 3)
    same(found, reference.region_state(scale * plane, P * np.outer(scale, scale), x, block, view))
    z, R, box = state(rng), covariance(rng, 8), reference.box_of(x, block)
    about = z[:2] + rng.normal(0, 0.3, 2)
    same(compiled.state_about(z, R, about), reference.state_about(z, R, about))
    item = rules.Detection(1, z, R, True, x, block, None, None)
    for bias in (0.0, 0.3):
        blurred = rules.blurred(item, view, SimpleNamespace(vector_bias=bias))
        same([blurred.R], [reference.blurred(z, R, box, bias, view)])
    grounded, expected = rules._on_ground(item, view), reference.on_ground(z, R, x, block, view)
    assert grounded.has_depth
    assert (grounded.edge is None) == (expected is None)
    if expected is not None:
        same((grounded.z, grounded.R, grounded.edge), expected)


@pytest.mark.parametrize('seed', range(8))
def test_rates_are_found_again_as_by_the_formula(seed):
    rng = np.random.default_rng(seed)
    mu, P, view, (x, _) = state(rng), covariance(rng, 8), camera(rng), region(rng, 40)
    rays = to_rays(K, x)
    theta = np.r_[view.dt * mu[om.RATE], mu[om.SLOPE]]
    target, _ = reference.transfer(theta, rays, mu[:2], K, view.R_cur_from_prev)
    target = target + rng.normal(0, 0.5, target.shape)
    target[::4] += rng.choice([0.0, 30.0]) + rng.normal(0, 6, target[::4].shape)
    variance = rng.uniform(0.1, 0.5, len(x))
    found = compiled.redetect_rate(
        mu, view.dt**2 * P[om.RATE, om.RATE], rays, target, variance, view.dt,
        (K, view.R_cur_from_prev),
        (LIMIT, redetection.WEAK, redetection.ITERATIONS, redetection.COARSE))
    same(found, reference.redetected_rate(mu, P, rays, target, variance, view, LIMIT))


@pytest.mark.parametrize('shape', [(1, 1), (4, 4), (3, 6), (7, 2)])
def test_the_cheapest_assignment_is_found(rng, shape):
    for _ in range(30):
        cost = np.where(rng.uniform(size=shape) < 0.4, 1e6, rng.exponential(10, shape))
        found = compiled.cheapest_assignment(cost)
        rows = np.flatnonzero(found >= 0)
        expected = linear_sum_assignment(cost)
        assert len(set(found[rows])) == len(rows) == min(shape)
        assert cost[rows, found[rows]].sum() == pytest.approx(cost[expected].sum())
