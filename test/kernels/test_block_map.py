"""The block map's kernels against their formulas, block by block in numpy."""

from canyon import HEIGHT, K, motion, MOTIONS, views, WIDTH
import formulas
from mv_slapse.geometry import plane, rotation, two_view
from mv_slapse.kernels.binding import compiled
from mv_slapse.surfaces.block_map import columns, POLICY, WIDTHS
from numeric import jacobian
import numpy as np
import pytest
from scipy.linalg import block_diag

SIZE = np.array([WIDTH, HEIGHT])
CLOSE = 4  # nearest points, which count as a block's own
EXACT = POLICY | {'relief': 1e-9}


def pixels(points):
    return points[:, :2] / points[:, 2:3] * np.diag(K)[:2] + K[:2, 2]


def cells(x):
    """Return the macroblock (N,) of pixels, -1 outside of the picture."""
    place = np.floor((x + 0.5) / 16)
    inside = np.all((place >= 0) & (place < (WIDTH // 16, HEIGHT // 16)), axis=1)
    return np.where(inside, place[:, 1] * (WIDTH // 16) + place[:, 0], -1).astype(int)


def known_at(points, x):
    """Return what a map knows at one pixel: rho, variance, smooth."""
    seen = points[points[:, 2] > 0.05]
    seen = seen[np.all(np.abs(pixels(seen) + 0.5 - SIZE / 2) < SIZE / 2 + 32, axis=1)]
    at, z = pixels(seen), seen[:, 2]
    near = np.all(np.abs(np.floor((at + 0.5) / 16) - np.floor((x + 0.5) / 16)) <= 2, axis=1)
    square = np.where(near, np.sum((at - x)**2, axis=1), np.inf)
    order = np.argsort(square, kind='stable')
    order = order[square[order] < 32.0**2]
    if len(order) < CLOSE:
        return 0, np.inf, 0
    rho, variance = seen[order, 3] / z[order], seen[order, 4] / z[order]**2
    middle = np.median(rho[:3])
    same = np.abs(rho - middle) < POLICY['same_surface'] * abs(middle) + 2 * np.sqrt(variance)
    if same.sum() < CLOSE:
        return 0, np.inf, 0
    far = 1 + square[order] / POLICY['spread']**2
    weight = same / (far**2 * (variance + (POLICY['roughness'] * middle)**2 + 1e-12))
    weight /= weight.sum()
    J = np.c_[np.ones(len(order)), (at[order] - x) / 16]
    A, b = J.T @ (weight[:, None] * J) + np.diag([0, 0.05, 0.05]), J.T @ (weight * rho)
    found = np.linalg.solve(A, b)[0]
    if not abs(found - b[0]) < POLICY['slack'] * abs(b[0]):
        return 0, np.inf, 0
    ring = same & (np.arange(len(order)) >= CLOSE)
    return found, weight @ variance, rho[ring].mean() if ring.sum() >= 2 else b[0]


def moved(points, R, t):
    h = points[:, :3] @ R.T + points[:, 3:4] * t
    n = np.linalg.norm(h, axis=1)
    slope = 1 / n - points[:, 3] * (h @ t) / n**3
    rho = points[:, 3] / n
    return np.c_[h / n[:, None], rho,
                 slope**2 * points[:, 4] + (POLICY['inflation'] * rho)**2]


def fused(points, pair, known, R, t):
    """Return the points after a pair."""
    points = moved(points, R, t)
    rho, _ = two_view.inverse_depth(pair.rays_cur, pair.rays_prev, pair.focal, R, t)
    error = formulas.epipolar_error(pair.rays_cur, pair.rays_prev, pair.focal, R, t)
    good = np.abs(error / pair.sigma) < POLICY['epsilon']
    turned = pair.rays_prev @ R[2]
    ahead = turned + known[:, 0] * t[2]
    foretold = np.isfinite(known[:, 1]) & (ahead > 1e-6)
    before = known[:, 0] / ahead
    variance = (turned / ahead**2)**2 * np.where(foretold, known[:, 1], 0)
    typical = np.median(before[foretold])
    reach = np.linalg.norm((t[:2] - pair.rays_cur[:, :2] * t[2]) * pair.focal, axis=1)
    sigma = (1 - np.where(foretold, before, typical) * t[2])**2 * pair.sigma / reach
    block = cells(pixels(pair.rays_cur))
    first = {c: min(np.flatnonzero(good & (block == c)), key=lambda i: sigma[i])
             for c in np.unique(block[good & (block >= 0)])}
    cell = np.where(points[:, 2] > 0.05, cells(pixels(points)), -1)
    worst, kept = 1.5 * np.median(points[::3, 3]), np.ones(len(points), bool)
    for k in np.flatnonzero(cell >= 0):
        i = first.get(cell[k])
        if i is not None and foretold[i]:
            off, total = rho[i] - before[i], variance[i] + sigma[i]**2
            if off**2 < POLICY['gate'] * total:
                least = POLICY['least_gain'] * (sigma[i] < POLICY['sure'] * abs(before[i]))
                gain = max(variance[i] / total, least)
                length = np.linalg.norm(pair.rays_cur[i])
                share = points[k, 3] * length / before[i]
                points[k, 3] += gain * off * (share if 0.5 < share < 2 else 1) / length
                points[k, 4] *= ((1 - gain)**2 * variance[i] + (gain * sigma[i])**2) / variance[i]
            else:
                points[k, 4] *= POLICY['doubt']
        kept[k] = np.sqrt(points[k, 4]) < worst
    fresh = []
    for c in range(WIDTH * HEIGHT // 256):
        here = np.flatnonzero(kept & (cell == c))
        if len(here) > 1:
            order = np.argsort(points[here, 4] / points[here, 3]**2, kind='stable')
            kept[here[order[1:]]] = False
        i = first.get(c)
        if len(here) or i is None or not (sigma[i] < typical and rho[i] > -3 * sigma[i]):
            continue
        n = np.linalg.norm(pair.rays_cur[i])
        noise = sigma[i]**2 + (POLICY['first_relief'] * rho[i])**2
        fresh.append(np.r_[pair.rays_cur[i] / n, rho[i] / n, noise / n**2])
    return np.concatenate([points[kept], np.array(fresh).reshape(-1, 5)])


@pytest.fixture(params=MOTIONS)
def scene(rng, request):
    return views(*motion(request.param), rng, sigma=0.3, outliers=0.1)


def points_of(scene, rng, share=0.02):
    """Return points (M, 5) in camera k-1, noisy, some of them behind and some out of view."""
    solid = (scene.surface >= 0) & (rng.random(len(scene.rho)) < 0.8)
    X = (scene.points[solid] - scene.t) @ scene.R
    X = np.concatenate([X, X + rng.normal(0, 0.05, X.shape), rng.normal(0, 5, (50, 3))])
    n = np.linalg.norm(X, axis=1)
    rho = (1 + share * rng.normal(size=len(n))) / n
    return np.c_[X / n[:, None], rho, (share / n + 1e-4)**2]


def known_of(points, pair):
    return compiled.map_at(points, pair.x_prev, K, SIZE, POLICY)


def test_depths_between_points(scene, rng):
    points = points_of(scene, rng)
    found = known_of(points, scene.pair)
    expected = np.array([known_at(points, x) for x in scene.pair.x_prev])
    np.testing.assert_allclose(found, expected, rtol=1e-9)
    assert 0.4 < np.mean(np.isfinite(found[:, 1])) < 1


def test_a_map_after_a_pair(scene, rng):
    points = points_of(scene, rng)
    known = known_of(points, scene.pair)
    found = compiled.fuse_map(points, columns(scene.pair), known,
                              np.r_[scene.R.ravel(), scene.t], (K, SIZE), POLICY)
    expected = fused(points, scene.pair, known, scene.R, scene.t)
    np.testing.assert_allclose(found, expected, rtol=1e-8, atol=1e-14)
    assert len(points) != len(found)


def exact(name):
    """Return a pair without errors, and what a map without errors knows of it."""
    scene = views(*motion(name))
    before = np.array([plane.transform(one, scene.R.T, -scene.R.T @ scene.t)
                       for one in scene.planes])
    rho = np.where(scene.surface < 0, 0, -np.sum(scene.pair.rays_prev * before[scene.surface],
                                                 axis=1))
    return scene, np.c_[rho, np.full(len(rho), 1e-6), rho]


@pytest.mark.parametrize('name', MOTIONS)
def test_the_motion_that_depths_tell_is_the_true_one(name):
    scene, known = exact(name)
    start = np.r_[(rotation.exp(np.array([0.003, -0.002, 0.001])) @ scene.R).ravel(),
                  1.1 * scene.t + (0.02, 0.01, 0)]
    R, t, *_, cost = compiled.fit_to_map(columns(scene.pair), known,
                                         np.array([np.r_[np.eye(3).ravel(), -scene.t], start]),
                                         WIDTHS, EXACT)
    np.testing.assert_allclose(R, scene.R, atol=1e-7)
    np.testing.assert_allclose(t, scene.t, atol=1e-5)
    assert cost < 1e-6


def slopes(pair, R_0, t_0, rho):
    """Return the numerical derivatives of pixels by (w, t) (N, 2, 6) and by inverse depth (N, 2).

    ``rho`` (N,) are inverse depths in camera k-1.
    """
    def place(R, t, rho):
        """Return pixels (2 N,) in camera k."""
        X = pair.rays_prev @ R.T + rho[:, None] * t
        return (X[:, :2] / X[:, 2:] * pair.focal).ravel()

    J = jacobian(lambda e: place(rotation.exp(e[:3]) @ R_0, t_0 + e[3:], rho), np.zeros(6))
    g = jacobian(lambda e: place(R_0, t_0, rho + e[0]), np.zeros(1))
    return J.reshape(-1, 2, 6), g.reshape(-1, 2)


@pytest.mark.parametrize('name', MOTIONS)
def test_its_information_is_that_of_the_numerical_derivative(name):
    scene, known = exact(name)
    pair = scene.pair
    pair.sigma[:] = 0.3
    J, g = slopes(pair, scene.R, scene.t, known[:, 0])
    C = 0.3**2 * np.eye(2) + known[:, 1, None, None] * g[:, :, None] * g[:, None]
    expected = np.einsum('nik,nij,njl->kl', J, np.linalg.inv(C), J)
    start = np.r_[scene.R.ravel(), scene.t][None]
    *_, A, covariance, length, _ = compiled.fit_to_map(columns(pair), known, start, WIDTHS,
                                                       EXACT)
    np.testing.assert_allclose(A, expected, rtol=1e-4, atol=1e-6 * np.abs(expected).max())
    unit = jacobian(lambda e: (scene.t + e) / np.linalg.norm(scene.t + e), np.zeros(3))
    D = block_diag(np.eye(3), unit)
    np.testing.assert_allclose(covariance, D @ np.linalg.inv(A) @ D.T, rtol=1e-4,
                               atol=1e-6 * covariance.max())
    along = np.sum(g * g, axis=1)
    assert length == pytest.approx(np.sum(known[:, 0]**2 * along / (
        0.3**2 + known[:, 1] * along)), rel=1e-4)


@pytest.mark.parametrize('side', [-1, 1])
@pytest.mark.parametrize('name', MOTIONS)
def test_beyond_infinity_the_whole_error_of_an_unknown_depth_counts(name, side, rng):
    """Half of the blocks are not known, and by a hair on one side of infinity."""
    scene, known = exact(name)
    pair, hidden = scene.pair, rng.random(len(known)) < 0.5
    pair.sigma[:] = np.where(hidden, 3.0, 0.3)  # the others hold the motion where it is
    X_prev = (pair.rays_cur - side * 1e-5 * scene.t)[hidden] @ scene.R
    pair.rays_prev[hidden] = X_prev / X_prev[:, 2:]
    known[hidden] = 0, np.inf, 0
    J, g = slopes(pair, scene.R, scene.t, known[:, 0])
    open_ = POLICY['weak'] * np.median(known[~hidden, 0]) if side > 0 else 0
    variance = np.where(hidden, open_**2, known[:, 1])
    C = (pair.sigma**2)[:, None, None] * np.eye(2) + (
        variance[:, None, None] * g[:, :, None] * g[:, None])
    expected = np.einsum('nik,nij,njl->kl', J, np.linalg.inv(C), J)
    start = np.r_[scene.R.ravel(), scene.t][None]
    A = compiled.fit_to_map(columns(pair), known, start, WIDTHS[-2:], EXACT)[2]
    np.testing.assert_allclose(A, expected, rtol=1e-3, atol=1e-4 * np.abs(expected).max())


@pytest.mark.parametrize('name', MOTIONS)
def test_depths_joined_with_the_map(name, rng):
    scene, known = exact(name)
    solid = scene.surface >= 0
    pair, known, unit = scene.pair[solid], known[solid], 1.7  # [map unit] of the baseline
    own = scene.rho[solid] * (1 + 0.03 * rng.normal(size=solid.sum()))
    sigma = 0.03 * scene.rho[solid]
    known[:, 0] *= (1 + 0.02 * rng.normal(size=len(known))) / unit
    known[:, 1] = (0.02 * known[:, 0])**2
    known[::7, 1] = np.inf
    known[::11, 0] *= 3  # contradicts
    t = unit * scene.t

    def ahead(rho):
        """Return what a depth of the map is in camera k [1/baseline]."""
        return unit * rho / (pair.rays_prev @ scene.R[2] + rho * t[2])

    before = ahead(known[:, 0])
    slope = np.diag(jacobian(lambda e: ahead(known[:, 0] + e), np.zeros(len(known))))
    variance = (slope**2 * known[:, 1] + (POLICY['drift'] * before)**2
                + POLICY['alike'] * sigma**2)
    good = np.isfinite(known[:, 1])
    good &= (before - own)**2 < POLICY['gate'] * (variance + sigma**2)
    gain = np.where(good, sigma**2 / (sigma**2 + np.where(good, variance, 1)), 0)
    rho, less = compiled.join_map(own, sigma, known, pair.rays_prev, scene.R, t, POLICY)
    np.testing.assert_allclose(rho, own + gain * np.where(good, before - own, 0), rtol=1e-7)
    np.testing.assert_allclose(less, sigma * np.sqrt(1 - gain), rtol=1e-6)
    assert 0.7 < good.mean() < 0.9
    assert np.std(rho[good] / scene.rho[solid][good]) < 0.9 * np.std(own / scene.rho[solid])


@pytest.mark.parametrize('name', MOTIONS)
def test_the_length_that_a_map_tells(name, rng):
    scene, known = exact(name)
    known[:, :2] *= (1 / 1.7, 1)  # the map's unit is 1.7 baselines
    known[rng.random(len(known)) < 0.1, 1] = np.inf
    pair = scene.pair
    rho, per_pixel = two_view.inverse_depth(pair.rays_prev, pair.rays_cur, pair.focal, scene.R.T,
                                            -scene.R.T @ scene.t)
    sure = np.isfinite(known[:, 1]) & (known[:, 0] > 0) & (per_pixel * pair.sigma < 0.3 * rho)
    n, length = compiled.told_length(columns(pair), known, scene.R, scene.t, 0.3)
    assert n == sure.sum() > 100
    assert length == pytest.approx(np.median(rho[sure] / known[sure, 0]), rel=1e-9)
    assert length == pytest.approx(1.7, rel=1e-6)


def test_wrong_arguments_are_named():
    with pytest.raises(ValueError, match='fit_to_map: there must be a start'):
        compiled.fit_to_map(columns(views(*motion('ahead')).pair), exact('ahead')[1],
                            np.zeros((0, 12)), WIDTHS, POLICY)
    with pytest.raises(ValueError, match='map_at: points'):
        compiled.map_at(np.zeros((3, 4)), np.zeros((1, 2)), K, SIZE, POLICY)
