"""The kernels of movers against their formulas in numpy, on drawn streets with wrong vectors."""

import bodies_reference
import movers_reference as reference
from mv_slapse.evaluation.detection import grid_index
from mv_slapse.geometry.blocks import grid_centres, grid_shape
from mv_slapse.geometry.camera import to_rays, UP
from mv_slapse.kernels.binding import compiled
from mv_slapse.motion.observations import Depths
from mv_slapse.movers import body, moving_plane, outlines, reference_depth, regions, score
from mv_slapse.movers.identity import History, Judged, LIFETIME, Memory
from mv_slapse.movers.mask import vote
from mv_slapse.movers.moving_plane import View
from mv_slapse.movers.reference_depth import Past
from mv_slapse.records import CameraMotion, Extraction, Label, MotionStatus, SegmentKind
from mv_slapse.simulation.drawn import draw
from mv_slapse.simulation.street import Street, StreetSettings
import numpy as np
import pytest

SIZE = 640, 480


def drawn_pair(rng, stands=False):
    """Return the blocks of a street with movers, its camera and its ground."""
    street = Street(StreetSettings(seed=2, movers=('faster', 'oncoming'), n_frames=60))
    drawn = draw(street, 24, 30, rng, 0.3, 0.1)
    found, (R0, t0), (R1, t1) = drawn.correspondences, street.pose(24), street.pose(30)
    t = R1.T @ (t0 - t1)
    n = len(found)
    departure = np.where(rng.uniform(size=n) < 0.1, rng.choice([5.0, -1.4], n), 0.0)
    pair = regions._Pair(
        *(np.ascontiguousarray(values, float) for values in (
            found.x_cur, found.x_prev, found.block, found.sigma)), departure,
        np.where(drawn.surface > 3, 7, -1).astype(np.int32), drawn.outlier)
    t = np.zeros(3) if stands else t / np.linalg.norm(t)
    view = View(street.camera.K, np.ascontiguousarray(R1.T @ R0), t)
    return pair, view, np.array([0.0, -1 / 1.65, 0.0])


@pytest.fixture(params=[False, True], ids=['drives', 'stands'])
def scene(request, rng):
    """Return a pair, its camera, its ground, and the regions of blocks that move alike."""
    pair, view, ground = drawn_pair(rng, request.param)
    ground = np.zeros(3) if request.param else ground
    return pair, view, ground, regions._Alike(*pair, *compiled.moving_regions(
        pair, view, ground, 1.0, regions.RULES), len(pair.x))


def test_blocks_are_joined_as_by_the_formula(scene):
    pair, view, ground, alike = scene
    expected = reference.moving_regions(pair, view, ground, 1.0, regions.RULES)
    assert len(alike.first) >= 3
    for own, other in zip(alike[len(pair):-1], expected, strict=True):
        np.testing.assert_allclose(own, other, rtol=1e-9, atol=1e-9)


def test_bodies_are_those_of_the_formula(rng):
    pair, view, ground = drawn_pair(rng)
    alike = regions._Alike(*pair, *compiled.moving_regions(
        pair, view, ground, 1.0, regions.RULES), len(pair.x))
    n, x, under = len(pair.x), pair.x, alike.under
    rho = under * rng.normal(1, 0.1, n)
    for left, foot, share in ((100, 330, 0.6), (300, 300, 0.4), (450, 400, 0.75)):
        own = (x[:, 0] > left) & (x[:, 0] < left + 80) & (x[:, 1] < foot)
        rho[own] = share * under[own].max() * rng.normal(1, 0.1, own.sum())
    field = alike._replace(members=np.zeros(0, int), first=np.zeros(0, int), rho=rho,
                           noise=0.1 * np.abs(under), fits=rng.uniform(size=n) < 0.9)
    view = view._replace(t=np.array([0.1, 0.0, -1.0]))
    before = body.Bodies(np.geomspace(0.02, 0.5, 32), rng.uniform(0, 4, (32, 40)))
    rules = body.RULES._replace(widest=2.0, lane=body.RULES.lane / 1.65)
    depths, told = bodies_reference.grid_of(view, ground, SIZE, before, rules)
    assert 0.05 < np.mean(told > 0) < 0.95
    expected, lasting = bodies_reference.bodies(field, depths, told, rules)
    (members, first), evidence, *found = compiled.with_bodies(field, view, ground, SIZE,
                                                              tuple(before), rules)
    assert len(expected) >= 2
    for own, (other, _) in zip(reference.split(members, first), expected, strict=True):
        np.testing.assert_array_equal(own, other)
    np.testing.assert_allclose(evidence, [one for _, one in expected], rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(found[0], depths / np.linalg.norm(ground), rtol=1e-12)
    np.testing.assert_allclose(found[1], lasting, rtol=1e-9, atol=1e-9)


def test_no_blocks_are_no_regions(scene):
    pair, view, ground, _ = scene
    nothing = regions._Pair(*(column[:0] for column in pair))
    assert not any(map(len, compiled.moving_regions(nothing, view, ground, 1.0, regions.RULES)))


def test_each_surface_is_fitted_as_by_the_formula(scene):
    pair, view, ground, alike = scene
    at, rules = alike.members, moving_plane.Rules()
    fit = moving_plane.Surfaces(*compiled.fit_moving_surfaces(
        pair.x[at], pair.x_prev[at], pair.sigma[at], alike.first, view, -UP, rules))
    for i, member in enumerate(reference.split(at, alike.first)):
        theta, covariance, centre, inlier, variance = reference.fit_one(
            pair.x[member], pair.x_prev[member], pair.sigma[member], view, -UP,
            rules)
        np.testing.assert_allclose(fit.theta[i], theta, rtol=1e-8, atol=1e-10)
        np.testing.assert_allclose(fit.centre[i], centre, atol=1e-12)
        np.testing.assert_array_equal(fit.inlier[alike.rows(i)], inlier)
        if np.isfinite(fit.variance[i]):
            assert fit.variance[i] == pytest.approx(variance)
            np.testing.assert_allclose(fit.covariance[i], covariance, rtol=1e-7, atol=1e-12)
        else:
            assert np.mean(inlier) < 0.5


def test_each_surface_is_settled_as_by_the_formula(scene):
    pair, view, ground, alike = scene
    fit, rules = regions._fitted(alike, view, regions.KnownGround()), moving_plane.Rules()
    priors = []
    blocks = (alike.x, alike.block, alike.members, alike.first)
    for i in range(len(alike.first)):
        for floor in (ground, None):
            own = compiled.settle_surface(fit, blocks, i, view, floor, rules)
            expected = reference.settled(fit, alike, i, view, floor, rules)
            assert (own is None) == (expected is None)
            for mine, other in zip(own or (), expected or (), strict=True):
                np.testing.assert_allclose(mine, other, rtol=1e-11, atol=1e-13)
            priors += [] if own is None else [own[4]]
    assert set(priors) == ({True, False} if np.any(ground) else {False})


def test_only_regions_that_there_are_are_settled(scene):
    pair, view, ground, alike = scene
    fit = regions._fitted(alike, view, regions.KnownGround())
    blocks = (alike.x, alike.block, alike.members, alike.first)
    with pytest.raises(ValueError, match='settle_surface: there must be such a region'):
        compiled.settle_surface(fit, blocks, len(alike.first), view, None, moving_plane.Rules())
    beyond = (*blocks[:2], alike.members + len(pair.x), alike.first)
    with pytest.raises(ValueError, match='settle_surface: members must be blocks'):
        compiled.settle_surface(fit, beyond, 0, view, None, moving_plane.Rules())


def test_regions_are_scored_as_by_the_formula(scene):
    pair, view, ground, alike = scene
    ground = ground if np.any(ground) else None
    known = regions.KnownGround(ground, np.array([0.0, -1.0, 0.0]))
    fit = regions._fitted(alike, view, known)
    outline = outlines.outlines(alike, view.K, ground, known.level, 1.65)
    told = np.zeros((2, len(alike.first)))
    own, left, lasts = score.scores(fit, outline, view, alike, 1.0, tuple(told))
    assert np.any(own > 5)
    np.testing.assert_allclose(
        own, np.where(np.isfinite(fit.variance), reference.scores(
            fit, outline, view.K, view.t, alike, 1.0, score.RULES), 0.0), atol=1e-7)
    assert np.all(left <= 0)
    assert not lasts.any()


def test_moving_regions_grow_as_by_the_formula(scene, rng):
    pair, view, _, alike = scene
    moving = np.argsort(-alike.size)[:3]
    products = rng.normal(0, 0.01, (3, 3, 3))
    members, first = compiled.grown(pair, alike, moving, products, view, regions.RULES)
    expected = reference.grown(pair, alike, moving, products, view, regions.RULES)
    assert len(members) > alike.size[moving].sum()
    for own, other in zip(reference.split(members, first), expected, strict=True):
        np.testing.assert_array_equal(own, other)


def extraction_of(pair, stamp=100_000_000, planes=None):
    n = len(pair.x)
    return Extraction(
        stamp, stamp - 100_000_000, *SIZE, SegmentKind.PP, np.eye(3),
        CameraMotion(MotionStatus.MOVING), x_cur=pair.x.astype(np.float32),
        x_prev=pair.x_prev.astype(np.float32), sigma=pair.sigma.astype(np.float32),
        block=pair.block.astype(np.uint8), label=np.zeros(n, np.int8),
        plane_id=np.full(n, -1, np.int32) if planes is None else planes.astype(np.int32))


def test_histories_follow_the_vectors_as_by_the_formula(rng):
    pair, _, _ = drawn_pair(rng)
    n = len(pair.x)
    old = Memory().after(extraction_of(pair), Judged(
        pair.x, pair.x_prev, pair.block, rng.normal(size=n), rng.normal(size=n),
        rng.integers(-1, 4, n)), 9)
    before, id_ = reference.inherited(old, extraction_of(pair, 2 * 10**8), LIFETIME)
    found = old.inherited(extraction_of(pair, 2 * 10**8))
    assert np.isfinite(before).any()
    np.testing.assert_array_equal(found.score, before)
    np.testing.assert_array_equal(found.id, id_)


@pytest.mark.parametrize('middle', [-0.25, 0.5])
def test_regions_sum_their_better_halves_and_keep_the_id_of_most(scene, rng, middle):
    pair, _, _, alike = scene
    n, size = len(pair.x), len(alike.first)
    given = np.where(rng.uniform(size=n) < 0.4, rng.normal(middle, 1, n), np.nan)
    before = History(given, -given, np.where(rng.uniform(size=n) < 0.4, rng.integers(3, 5, n), -1))
    now, leaves = rng.normal(size=(2, size))
    plane = pair.plane_id
    told = regions._Scores(*compiled.histories(alike, now, leaves, before, plane, -1,
                                               regions.RULES))
    for i, member in enumerate(reference.split(alike.members, alike.first)):
        known = np.sort(given[member][np.isfinite(given[member])])
        enough = 3 * len(known) >= len(member)
        stood = np.sum(known > 0) < 0.4 * len(known)
        was = known[0 if stood else len(known) // 2:].mean() if enough else 0.0
        assert told.total[i] == pytest.approx(now[i] + 0.85 * was)
        np.testing.assert_array_equal(told.score[member], told.total[i])
        ids = before.id[member][before.id[member] >= 0]
        if 3 * len(ids) >= len(member):
            assert told.known[i] == np.bincount(ids).argmax()
        assert told.moved[i] == (3 * len(ids) >= len(member))
    outside = np.setdiff1d(np.arange(n), alike.members)
    kept = np.where(alike.ground_like, 0.0, 0.85 * np.nan_to_num(given))
    np.testing.assert_allclose(told.score[outside], kept[outside])


@pytest.mark.parametrize(('share', 'expected'), [(0.25, 15.0), (0.35, 21.0), (0.45, 54.0),
                                                (0.6, 60.0)])
def test_a_wall_does_not_move_as_some_of_its_blocks_were_a_car_before_it(scene, share, expected):
    pair, _, _, alike = scene
    n, size = len(pair.x), len(alike.first)
    largest = np.argmax(alike.size)
    member = alike.members[alike.rows(largest)]
    assert len(member) >= 20
    score = np.zeros(n)
    score[member[:round(share * len(member))]] = 60.0
    told = regions._Scores(*compiled.histories(
        alike, np.zeros(size), np.zeros(size), History(score, 0 * score, np.full(n, -1)),
        np.full(n, -1, np.int32), -1, regions.RULES))
    assert told.total[largest] == pytest.approx(0.85 * expected, rel=0.12)


def test_departures_are_as_by_the_formula(rng):
    K, n = np.array([[500.0, 0, 319.5], [0, 500, 239.5], [0, 0, 1]]), 4000
    X = rng.uniform((-8, -5, 11), (8, 5, 12), (n, 3))
    past = Past(rng.integers(0, 5 * 10**8, n), X)
    x = rng.uniform(0, SIZE, (1500, 2))
    patch = np.sin(x / 50).prod(axis=1) > 0.3  # has gone, all else stands, some of it nearer
    rho = 1 / rng.normal(np.where(patch, 14.0, 11.3), 0.2)
    depths = Depths(to_rays(K, x), rho, 0.06 * rho * rng.uniform(size=len(x)), x)
    ground, rules = np.array([0, -1 / 3.0, 0]), reference_depth.RULES
    own = compiled.departures(past, depths, ground, K, 6 * 10**8, *SIZE, rules)
    expected = reference.departures(past, depths, ground, K, 6 * 10**8, SIZE, rules)
    assert np.sum(own > 0) > 50
    assert np.sum(own < 0) > 50
    np.testing.assert_allclose(own, expected, atol=1e-12)


def test_macroblocks_are_labelled_by_area(rng):
    n = 3000
    x = rng.uniform(-20, 700, (n, 2))
    pair = regions._Pair(x, x, rng.choice([8.0, 16.0], (n, 2)), np.ones(n), *[None] * 3)
    extraction = extraction_of(pair, planes=rng.integers(-1, 5, n))
    extraction.label[:] = rng.choice([*Label], n)
    for own, other in zip(vote(extraction, extraction.x_cur),
                          reference.votes(extraction, extraction.x_cur), strict=True):
        np.testing.assert_array_equal(own, other)


@pytest.mark.parametrize('first', [[1], [0, 0], [0, 4], [0, -1]])
def test_regions_that_do_not_follow_each_other_are_refused(first, rng):
    x = rng.uniform(0, 100, (4, 2))
    with pytest.raises(ValueError, match='fit_moving_surfaces: first must rise'):
        compiled.fit_moving_surfaces(x, x, np.ones(4), np.array(first),
                                     View(np.eye(3), np.eye(3), np.zeros(3)), -UP,
                                     moving_plane.Rules())


def members(rng):
    """Return vectors of a mover that grows, some wrong, and which blocks of a picture it has."""
    n = 60
    x = rng.uniform(0, 600, (n, 2)).astype(np.float32)
    member = rng.uniform(size=n) < 0.5
    shown = 1.03 * x + np.array([4.0, -2.0]) + rng.normal(0, 0.3, (n, 2))
    shown[::9] += rng.uniform(-60, 60, (len(shown[::9]), 2))
    return x, shown.astype(np.float32), member


def test_a_mover_moves_in_the_picture_as_by_the_formula(rng):
    x, shown, member = members(rng)
    found = compiled.motion_in_picture(x, shown, member, 4, 3.0, 20.0)
    at = x[member].astype(float)
    vector = shown[member] - at
    shift, centre = np.median(vector, axis=0), at.mean(axis=0)
    off, left = at - centre, vector - shift
    length = np.linalg.norm(left, axis=1)
    good = length <= 3.0 * np.median(length) + 1.0
    assert not good.all()
    growth = np.sum((off * left)[good]) / (np.sum(off[good]**2) + 20.0**2)
    assert np.allclose(found, [*centre, *shift, growth], rtol=1e-9)
    assert growth == pytest.approx(0.03, abs=0.01)
    assert compiled.motion_in_picture(x, shown, member, member.sum() + 1, 3.0, 20.0) is None
    assert compiled.motion_in_picture(x, 9 * x, member, 4, 3.0, 20.0)[4] == 0.5


def test_macroblocks_move_on_as_by_the_formula(rng):
    width, height = 250, 100  # those at the edges are cut
    n = np.prod(grid_shape(width, height))
    seen = rng.choice([-1, 300, 700, 1000, 1001], n)
    motion = np.array([90.0, 40.0, 21.0, -9.0, 0.1])
    centres = grid_centres(width, height)
    origin = grid_index(centres + motion[2:4] + motion[4] * (centres - motion[:2]), width, height)
    expected = np.where(origin >= 0, seen[origin], -1)
    expected[(expected > 1000) | (1000 - expected >= 500)] = -1
    assert {-1, 700, 1000} == set(expected)
    assert np.array_equal(compiled.carry_cells(seen, motion, width, height, 1000, 500), expected)


def test_blocks_around_movers_are_like_them_as_by_the_formula(rng):
    n, ids = 400, np.array([100_000, 100_001])
    x = rng.uniform(0, 400, (n, 2)).astype(np.float32)
    plane_id = np.full(n, -1, np.int32)
    H = np.array([[1.02, 0.001, 3], [0.002, 1.01, -2], [1e-5, -1e-5, 1]]) + 0.01 * np.array(
        [np.zeros((3, 3)), [[0, 0, 500], [0, 0, 0], [0, 0, 0]]])
    for id_, (left, top) in zip(ids, ((60, 200), (200, 100)), strict=True):
        plane_id[np.all((x > (left, top)) & (x < (left + 60, top + 50)), axis=1)] = id_
    shown = np.c_[x, np.ones(n)] @ H[0].T
    shown = (shown[:, :2] / shown[:, 2:] + rng.normal(0, 1.0, (n, 2))).astype(np.float32)
    parallax = rng.uniform(0, 8, n)
    expected = np.zeros(n, bool)
    for id_, one in zip(ids, H, strict=True):
        low, high = x[plane_id == id_].min(axis=0) - 16, x[plane_id == id_].max(axis=0) + 16
        tall = high[1] - low[1]
        low, high = low - (0, 1.0 * tall), high + (0, 0.3 * tall)
        near = np.all((x >= low) & (x <= high), axis=1) & (plane_id < 0)
        to = np.c_[x, np.ones(n)] @ one.T
        error = np.linalg.norm(to[:, :2] / to[:, 2:] - shown, axis=1)
        expected |= near & (error < 1.0 + 0.12 * parallax)
    found = compiled.blocks_like_movers(x, shown, plane_id, parallax, ids, H.reshape(-1, 9),
                                        (1.0, 0.3), (1.0, 0.12))
    assert 5 < expected.sum() < 100
    assert np.array_equal(found, expected)
