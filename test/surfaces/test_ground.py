"""The ground: its prior, its track, the learned mounting, and finding it."""

from dataclasses import replace

from canyon import CANYON, motion, views
import formulas
import ground_reference
from mv_slapse.config import ExtractionSettings
from mv_slapse.geometry import plane as plane_geometry
from mv_slapse.geometry.two_view import Pair
from mv_slapse.kernels.binding import compiled
from mv_slapse.motion.observations import BlockObservations, Depths
from mv_slapse.surfaces import ground, height
from mv_slapse.surfaces.ground import GroundPrior, GroundTrack, Mount, Ride
from numeric import jacobian
import numpy as np
import pytest

ROAD = CANYON[0]
UP = np.array([0, -1.0, 0])
RULES = ExtractionSettings(radius=96.0, max_uncertainty=0.2)
FRESH = GroundPrior(UP, 0.07)


def pitched(angle):
    return np.array([0, -np.cos(angle), np.sin(angle)])


def road_depths(rng, outliers=0.0, planes=CANYON, pixel_sigma=0.3):
    """Return depths of the canyon with errors of a pixel share, and the mask of all blocks."""
    scene = views(*motion('ahead'), planes=planes)
    near = scene.surface >= 0
    sigma = pixel_sigma / 100 * np.maximum(scene.rho[near], 0.05)
    n = near.sum()
    wrong = rng.uniform(size=n) < outliers
    rho = np.where(wrong, scene.rho[near] * rng.uniform(0.05, 1, n),
                   scene.rho[near] + sigma * rng.normal(size=n))
    depths = Depths(scene.pair.rays_cur[near], rho, np.maximum(sigma, 1e-6), scene.x_cur[near])
    return depths, scene.surface[near], wrong


def find(depths, free, prior, rng, lone=None, rules=RULES):
    return ground.find_ground(depths, free, prior, rules, rng.random((256, 10)), lone)


def test_no_mounting_leans_by_more_than_three_standard_deviations():
    mount = Mount(widest=0.07)
    assert mount.holds(pitched(0.2) / 1.65)
    assert not mount.holds(pitched(0.22) / 1.65)
    assert not mount.holds(-UP)


def test_a_mount_learns_the_pitch_from_the_course():
    mount, course = Mount(), np.array([0, np.sin(-0.05), np.cos(-0.05)])
    for _ in range(200):
        mount = mount.learned(course, 0.01)
    assert mount.normal @ course == pytest.approx(0, abs=1e-6)
    assert np.linalg.norm(mount.normal) == pytest.approx(1)
    np.testing.assert_allclose(mount.normal, [0, -np.cos(0.05), -np.sin(0.05)], atol=1e-6)
    assert mount.spread == pytest.approx(0.01)


def test_a_camera_that_climbs_and_sinks_keeps_a_wide_mount():
    mount = Mount(spread=0.01)
    for i in range(200):
        angle = 0.3 * (-1) ** i
        mount = mount.learned(np.array([0, np.sin(angle), np.cos(angle)]), 0.01)
    assert mount.spread == mount.widest == 0.07


def courses(pitch):
    """Return courses (N, 3) in cameras that look down by ``pitch`` (N,) [rad]."""
    return np.stack([np.zeros(len(pitch)), -np.sin(pitch), np.cos(pitch)], axis=1)


@pytest.mark.parametrize('pitch', [0.0, 0.35])
def test_a_camera_on_a_vehicle_rides_however_it_looks_down(rng, pitch):
    mount, rides = Mount(), []
    for course in courses(pitch + rng.normal(0, 0.02, 200)):
        mount = mount.learned(course, 0.01)
        rides.append(mount.rides)
    assert all(rides[60:])


def test_a_camera_that_rose_and_fell_flies_through_three_level_seconds(rng):
    mount = Mount()
    for course in courses(np.r_[0.5 * np.sin(0.3 * np.arange(40)), np.zeros(36)]):
        mount = mount.learned(course, 0.01)
    assert mount.spread < 0.03
    assert not mount.rides


def test_distance_counts_tilt_and_log_depth_in_standard_deviations():
    prior = GroundPrior(UP, 0.02, inverse_depth=0.5, spread=0.1)
    planes = np.array([0.5 * UP, 0.5 * pitched(0.04), 0.5 * np.exp(0.3) * UP, -0.5 * UP])
    distance = ground_reference.distance(prior, planes)
    np.testing.assert_allclose(distance[:3], [0, 4, 9], atol=1e-9)
    assert distance[3] > 1e4
    level = np.outer([0.1, 1, 9], UP)
    np.testing.assert_allclose(ground_reference.distance(FRESH, level), 0, atol=1e-9)


def test_information_is_half_the_hessian_of_the_distance():
    prior = GroundPrior(pitched(0.1), 0.02, inverse_depth=0.5, spread=0.1)
    mean, information = prior.information(0.5 * prior.normal)
    np.testing.assert_allclose(mean, 0.5 * prior.normal)

    def gradient(p):
        return jacobian(lambda q: ground_reference.distance(prior, q[None])[0], p, 1e-4)

    # The angle's arc cosine has no derivative at its centre: differentiate beside it.
    for direction in (prior.normal, [1.0, 0, 0], np.cross(prior.normal, [1, 0, 0])):
        step = 0.01 * np.linalg.norm(mean) * np.array(direction)
        expected = information @ step
        np.testing.assert_allclose(gradient(mean + step) / 2, expected,
                                   atol=0.05 * np.abs(expected).max())


def test_a_ground_of_unknown_depth_informs_of_its_direction_only():
    mean, information = FRESH.information(0.4 * pitched(0.02))
    np.testing.assert_allclose(information @ UP, 0, atol=1e-9)
    np.testing.assert_allclose(mean, 0.4 * UP)
    assert information[0, 0] == pytest.approx(1 / (0.4 * 0.07) ** 2)


@pytest.mark.parametrize('name', ['ahead', 'turning', 'backward'])
def test_the_predicted_ground_is_the_moved_one(name):
    R, t = motion(name)
    track = GroundTrack(Mount(spread=10.0, widest=10.0), 4, ROAD, 0.05)
    prior = track.prior(R, t, np.log(1.5), 0.01, 0.001)
    # One baseline is now 1.5 old ones, so n / d grows by that, and then the camera moves.
    expected = plane_geometry.transform(1.5 * ROAD, R, t)
    np.testing.assert_allclose(prior.normal * prior.inverse_depth, expected, atol=1e-6)
    assert prior.spread == pytest.approx(np.sqrt(0.05**2 + 0.01**2 + ground.HEIGHT_WOBBLE**2))


def test_the_mounting_pulls_the_predicted_normal():
    track = GroundTrack(Mount(spread=0.01), 4, 0.5 * pitched(0.1), 0.05)
    prior = track.prior(np.eye(3), np.array([0, 0, -1e-9]), 0.0, 0.01, 0.01)
    np.testing.assert_allclose(prior.normal, pitched(0.05), atol=1e-4)
    assert prior.tilt == pytest.approx(0.01 / np.sqrt(2))


def test_before_the_ground_is_found_only_the_mounting_is_known():
    prior = GroundTrack(Mount(spread=0.03)).prior(*motion('ahead'), 0.0, np.inf, 0.01)
    np.testing.assert_array_equal(prior.normal, UP)
    assert prior.tilt == 0.03
    assert np.isinf(prior.spread)


def test_a_ground_not_seen_is_forgotten_in_the_end():
    R, t = np.eye(3), np.array([0, 0, -1.0])
    track = GroundTrack(Mount()).seen(4, ROAD, 0.02**2 * np.outer(ROAD, ROAD))
    spreads = []
    while track.plane is not None and len(spreads) < 100:
        spreads.append(track.spread)
        track = track.missed(track.prior(R, t, 0.0, 0.02, 0.01))
    assert 5 < len(spreads) < 100
    assert np.all(np.diff(spreads) > 0)
    assert track.id == 4
    assert np.isinf(track.spread)


def test_the_mount_learns_most_from_the_first_courses():
    mount, course = Mount(), np.array([0, np.sin(-0.05), np.cos(-0.05)])
    for _ in range(4):
        mount = mount.learned(course, 0.01)
    assert abs(mount.normal @ course) < 0.25 * 0.05
    assert mount.spread < 0.05


def believed(log, spread):
    """Return a belief of a Gaussian height."""
    p = np.exp(-0.5 * np.square((height.GRID - log) / spread))
    return height.HeightBelief(p / p.sum())


def test_a_height_from_many_pairs_starts_a_ground():
    prior = FRESH.informed(believed(np.log(1.3), 0.03))
    assert prior.inverse_depth == pytest.approx(1 / 1.3, rel=1e-3)
    assert prior.spread == pytest.approx(np.hypot(0.03, height.BIAS), rel=0.1)
    assert FRESH.informed(believed(0.0, 0.5)) is FRESH


def test_a_ground_that_is_known_better_or_otherwise_is_left_alone():
    for prior in (GroundPrior(UP, 0.02, 1.0, 0.02), GroundPrior(UP, 0.02, 2.0, 0.15)):
        assert prior.informed(believed(0.0, 0.05)) is prior
    loose = GroundPrior(UP, 0.02, 1.1, 0.15).informed(believed(0.0, 0.03))
    assert loose.inverse_depth == pytest.approx(1, abs=1e-3)


def test_movers_are_told_by_the_farthest_ground_that_many_pairs_allow():
    seen, belief = np.array([0, -0.5, 0]), believed(np.log(2.0), 0.3)
    assert ground.for_movers(seen, FRESH, belief) == (seen, 1.0)
    floor, nearer = ground.for_movers(None, replace(FRESH, inverse_depth=0.4, spread=0.2), belief)
    assert nearer == 1
    np.testing.assert_allclose(floor, 0.4 * UP)
    floor, nearer = ground.for_movers(None, FRESH, belief)
    # Two standard deviations farther than 2, the common bias of all pairs among them.
    spread = np.hypot(0.3, 0.03)
    np.testing.assert_allclose(np.log(-floor[1]), -np.log(2) - 2 * spread, atol=0.01)
    assert np.log(nearer) == pytest.approx(4 * spread, abs=0.01)
    assert ground.for_movers(None, FRESH, believed(np.log(2.0), 1.1)) == (None, 1.0)


def test_a_variance_that_rounding_made_negative_is_none():
    track = ground.GroundTrack(ground.Mount()).seen(3, ROAD, -1e-12 * np.eye(3))
    assert (track.spread, track.tilt) == (0, 0)


def test_upright_informs_of_the_direction_only():
    prior = GroundPrior(UP, 0.02, 0.5, 0.05)
    mean, information = prior.upright(0.4 * pitched(0.02))
    np.testing.assert_allclose(information @ UP, 0, atol=1e-9)
    assert information[0, 0] == pytest.approx(1 / (0.4 * 0.02) ** 2)
    np.testing.assert_allclose(mean, 0.4 * UP)


def test_a_known_ground_is_seen_in_a_few_lone_blocks(rng):
    depths, surface, _ = road_depths(rng)
    few = np.flatnonzero(surface == 0)[::40][-10:]
    free, prior = np.zeros(len(depths), bool), GroundPrior(UP, 0.02, 1 / 1.6, 0.05)
    free[few] = True
    fit = find(depths, free, prior, rng, free)
    normal, depth = formulas.to_normal_depth(fit.plane)
    assert depth == pytest.approx(1.6, rel=0.03)
    assert find(depths, free, FRESH, rng, free) is None


def observed(depths, parallax):
    """Return right vectors that show some depths."""
    n = len(depths)
    pair = Pair(depths.rays, depths.rays, depths.x, np.full(n, 0.3), np.eye(3))
    no, yes = np.zeros(n, bool), np.ones(n, bool)
    return BlockObservations(pair, np.zeros(n), depths.rho, depths.sigma, depths.sigma, parallax,
                             yes, no, no, yes)


def surveyed(rng, prior, turn=0.0, n=120):
    """Return what `survey` makes of lone blocks, the second half of them wrong."""
    depths, surface, _ = road_depths(rng)
    lone = np.zeros(len(depths), bool)
    lone[rng.choice(np.flatnonzero(surface == 0), n, replace=False)] = True
    depths = depths[(surface > 0) | lone]
    lone = lone[(surface > 0) | lone]
    wrong = np.flatnonzero(lone)[n // 2:]
    rho = depths.rho.copy()
    rho[wrong] *= np.exp(rng.uniform(-2, 2, len(wrong)))
    depths = replace(depths, rho=rho)
    evidence = observed(depths, np.clip(500 * rho, 5, 50))
    result = ground.survey(evidence, depths.x, lone, prior, height.HeightBelief.blank(),
                           Ride(np.eye(3)[2], turn, 3.0))
    return *result, lone, wrong


def test_lone_blocks_on_the_road_are_told_from_wrong_ones(rng):
    belief, prior, road, lone, wrong = surveyed(rng, replace(FRESH, tilt=0.01))
    assert belief.log == pytest.approx(np.log(1.6), abs=0.08)
    assert prior.inverse_depth == pytest.approx(1 / 1.6, rel=0.08)
    assert not np.any(road & ~lone)
    assert road[wrong].mean() < 0.3
    assert (road.sum() - road[wrong].sum()) / 60 > 0.5


@pytest.mark.parametrize(('turn', 'learned'), [(0.02, True), (0.5, False)])
def test_what_lies_around_the_bend_tells_nothing_of_the_height(rng, turn, learned):
    # The nearest road is three ways off: after them the camera will look 1.5 rad to the side.
    belief, *_ = surveyed(rng, replace(FRESH, tilt=0.01), turn=turn)
    assert (belief.spread < 0.1) == learned


def test_the_road_is_found_exactly_without_noise(rng):
    depths, surface, _ = road_depths(rng, pixel_sigma=0.0)
    fit = find(depths, np.ones(len(depths), bool), FRESH, rng)
    np.testing.assert_allclose(fit.plane, ROAD, atol=1e-5)
    assert fit.is_ground
    assert np.mean(surface[fit.member] == 0) > 0.98


def test_forty_percent_wrong_vectors_cost_little(rng):
    depths, surface, wrong = road_depths(rng, outliers=0.4)
    fit = find(depths, np.ones(len(depths), bool), FRESH, rng)
    normal, depth = formulas.to_normal_depth(fit.plane)
    assert depth == pytest.approx(1.6, rel=0.02)
    assert normal @ UP > np.cos(np.radians(1))
    right = (surface == 0) & ~wrong
    assert fit.member[right].mean() > 0.7


def test_a_pitched_road_within_the_prior_is_found_and_a_wall_is_not(rng):
    tilted = pitched(0.08) / 1.6
    depths, _, _ = road_depths(rng, planes=[tilted])
    free = np.ones(len(depths), bool)
    fit = find(depths, free, FRESH, rng)
    assert fit.plane @ tilted / np.linalg.norm(tilted) ** 2 == pytest.approx(1, abs=0.03)
    walls, _, _ = road_depths(rng, planes=CANYON[1:3])
    fit = find(walls, np.ones(len(walls), bool), FRESH, rng)
    assert fit is None or FRESH.distance(fit.plane[None])[0] < 9


def test_what_lies_below_speaks_against_a_ground(rng):
    depths, surface, _ = road_depths(rng)
    # A table top above the road: fewer blocks agree with it than lie below.
    table = (surface == 0) & (rng.uniform(size=len(surface)) < 0.2)
    rho = np.where(table, 2 * depths.rho, depths.rho)
    prior = GroundPrior(UP, 0.02, 2 / 1.6, 0.02)
    mixed = replace(depths, rho=rho)
    assert find(mixed, np.ones(len(rho), bool), prior, rng) is None


def test_a_ground_nobody_knows_is_not_found_among_vectors_that_lie_anywhere(rng):
    depths, surface, _ = road_depths(rng)
    kept = np.flatnonzero(surface == 0)
    anywhere = depths.rho * np.exp(rng.uniform(0.3, 2, len(depths)))
    for share, is_found in ((0.35, True), (0.65, False)):
        wrong = rng.uniform(size=len(depths)) < share
        mixed = replace(depths, rho=np.where(wrong, anywhere, depths.rho))[kept]
        free = np.ones(len(kept), bool)
        assert (find(mixed, free, FRESH, rng) is not None) is is_found
        known = GroundPrior(UP, 0.02, 1 / 1.6, 0.05)
        assert find(mixed, free, known, rng) is not None


def test_too_few_blocks_are_no_ground(rng):
    depths, surface, _ = road_depths(rng)
    free = np.zeros(len(depths), bool)
    assert find(depths, free, FRESH, rng) is None
    free[np.flatnonzero(surface == 0)[-(RULES.min_macroblocks - 1):]] = True
    assert find(depths, free, FRESH, rng) is None
    assert find(depths[free[:0]], free[:0], FRESH, rng) is None


def test_a_road_whose_depths_are_all_blurred_is_no_ground(rng):
    depths, _, _ = road_depths(rng)
    blurred = replace(depths, sigma=0.2 * np.maximum(depths.rho, 0.01))
    with np.errstate(all='raise'):
        assert find(blurred, np.ones(len(depths), bool), FRESH, rng) is None


def test_a_road_far_from_where_it_was_is_not_believed(rng):
    depths, _, _ = road_depths(rng)
    elsewhere = GroundPrior(UP, 0.02, 2 / 1.6, 0.05)
    free = np.ones(len(depths), bool)
    assert find(depths, free, elsewhere, rng) is None


@pytest.mark.parametrize(('t', 'course'), [
    ([0.1, 0.05, -1.0], [-0.1, -0.05, 1.0]), ([0.1, 0.05, 1.0], [0.1, 0.05, 1.0]),
    ([1.0, 0, -0.2], [0, 0, 1]), ([0, 0, 0], [0, 0, 1])])
def test_the_course_is_where_the_camera_goes_or_comes_from_if_it_sees_that(t, course):
    np.testing.assert_allclose(ground.course_of(np.array(t, float)), course)


def test_the_road_lies_along_the_course_not_along_the_axis():
    rays = np.array([[-1.0, 0.3, 1.0], [0.5, 0.3, 1.0], [-0.3, 0.3, 1.0], [-0.3, 0.02, 1.0]])
    near, none = np.full(4, 0.2), np.zeros(4, bool)
    by_axis, by_course = (compiled.find_way(
        rays, near, 0.1 * near, 300 * rays[:, :2], ~none, none, near, UP, course, 0.0,
        ground.POLICY)[1] for course in (np.eye(3)[2], np.array([-0.3, 0.0, 1.0])))
    np.testing.assert_array_equal(by_axis, [False, True, True, False])
    np.testing.assert_array_equal(by_course, [True, False, True, False])


def test_cars_beside_the_road_do_not_teach_a_height_of_their_own(rng):
    """What rises is left out: without that a row of cars far below the camera is believed."""
    x = np.stack(np.meshgrid(np.arange(-160, 160, 16), np.arange(16, 80, 16)), -1).reshape(-1, 2)
    rays = np.c_[x / 400, np.ones(len(x))]
    rho = np.full(len(x), 0.06) * (1 + 0.03 * rng.standard_normal(len(x)))
    none, parallax = np.zeros(len(x), bool), rng.uniform(6, 12, len(x))
    sigma = 0.03 * rho
    spreads = []
    for shape in (rays[:, 1] / 0.1, np.ones(len(x))):
        depths = Depths(rays, rho * shape, sigma * shape, x + 500.0)
        belief, *_ = ground.survey(
            observed(depths, parallax), depths.x, none, replace(FRESH, tilt=0.01),
            height.HeightBelief.blank(), Ride(np.eye(3)[2], 0.0, 3.0))
        spreads.append(belief.spread)
    assert spreads[0] < 0.6
    assert spreads[1] > 1.5


def test_blocks_far_to_the_side_do_not_tilt_the_ground(rng):
    """A lawn beside the road, a hand higher, is outside the corridor."""
    up = np.array([0.0, -1.0, 0.0])
    x = np.stack(np.meshgrid(np.arange(-0.9, 0.9, 0.03), np.arange(0.1, 0.4, 0.03)), -1)
    rays = np.c_[x.reshape(-1, 2), np.ones(x.size // 2)]
    aside = np.abs(rays[:, 0]) > 2.6 * rays[:, 1]
    height = np.where(aside, 1.4, 1.65)
    rho = rays[:, 1] / height
    depths = Depths(rays, rho, 0.03 * rho, 500 * rays[:, :2] + 500)
    fit = find(depths, np.ones(len(rho), bool), GroundPrior(up, 0.07), rng)
    np.testing.assert_allclose(fit.plane, up / 1.65, atol=1e-3)
    assert not (fit.member & aside).any()
