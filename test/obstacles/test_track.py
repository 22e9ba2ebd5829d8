"""One track: outline, edges, hand-over and time to contact against definitions."""

from dataclasses import replace

from drawn_movers import Drive, DT, K, Mover, nanoseconds
from mv_slapse.config import ObstacleSettings
from mv_slapse.kernels.binding import compiled
from mv_slapse.obstacles import motion_model as om
from mv_slapse.obstacles import track as tracks
from mv_slapse.obstacles.detection import (
    blurred,
    body_box,
    box_of,
    detections,
    joined,
    tiles,
    TURN_SHARE,
)
from mv_slapse.obstacles.view import view_of
from mv_slapse.records import ObstacleState
from numeric import jacobian
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

SETTINGS = ObstacleSettings()
DRIVE = Drive((Mover(1, (-3, 22), (0, -8)),), scale_sigma=0.0, sigma=0.05)


class Moment:
    """Extraction, view and detection of a drive at a time."""

    def __init__(self, now, rng, drive=DRIVE):
        self.extraction = drive.extraction(now - DT, now, rng)
        self.view = view_of(self.extraction, drive.scene(now - DT, now), None)
        self.detection = detections(self.extraction, self.view, SETTINGS)[0]
        self.step = om.CameraStep(self.view.R_cur_from_prev, self.view.t_cur_from_prev, DT,
                                  self.view.scene_velocity, self.view.scene_covariance)

    def track(self):
        return tracks.start(self.detection, self.extraction, self.view, 7)


def test_prediction_moves_the_blocks_to_where_the_obstacle_will_be(rng):
    first, second = Moment(0.3, rng), Moment(0.4, rng)
    track = first.track()
    before = track.x.copy()
    assert track.predict(second.step, second.view, SETTINGS)
    # Where the same points of the car are in the next picture, by the exact geometry.
    mover = DRIVE.movers[0]
    depth = mover.base(0.3)[2] - DRIVE.pose(0.3)[1][2]
    X = depth * (np.c_[before, np.ones(len(before))] @ np.linalg.inv(K).T)
    X = X + mover.speed(0) * DT - (DRIVE.pose(0.4)[1] - DRIVE.pose(0.3)[1])
    expected = X @ K.T
    np.testing.assert_allclose(track.x, expected[:, :2] / expected[:, 2:], atol=1.2)
    assert np.abs(expected[:, :2] / expected[:, 2:] - before).max() > 6
    assert np.all(track.block > 16)


def test_time_to_contact_is_depth_over_closing_speed(rng):
    moment = Moment(0.5, rng)
    depth = DRIVE.movers[0].base(0.5)[2] - DRIVE.pose(0.5)[1][2]
    found, variance = moment.track().time_to_contact()
    assert found == pytest.approx(depth / 18, rel=0.1)
    assert 0 < np.sqrt(variance) < 0.5


def test_a_car_ahead_moves_where_baselines_compare(rng):
    moment = Moment(0.5, rng, Drive((Mover(1, (0, 10), (0, 9)),), scale_sigma=0.0, sigma=0.05))
    scene = moment.view.scene_velocity
    found = []
    for sigma in (1.0, 0.1):
        view = replace(moment.view, scene_covariance=sigma**2 * np.outer(scene, scene))
        track = moment.track()
        track.witness(moment.extraction, view, moment.detection)
        found.append(track.evidence[-1].statistic)
    assert found[0] < 11.3 < found[1]


def test_a_receding_obstacle_has_no_contact(rng):
    drive = Drive((Mover(1, (0, 10), (0, 14)),))
    assert Moment(0.5, rng, drive).track().time_to_contact() == (np.inf, np.inf)


def test_handover_has_the_covariance_of_plane_and_velocity(rng):
    moment = Moment(0.5, rng)
    track, view = moment.track(), moment.view

    def state(mu):
        cartesian, _ = om.to_cartesian(mu)
        velocity = view.R_world_from_cam @ (cartesian[3:6] - view.scene_velocity)
        return np.r_[view.plane_to_world(om.plane(mu))[0], velocity]
    by_state = jacobian(state, track.mu)
    expected = by_state @ track.P @ by_state.T
    expected[3:, 3:] += view.scene_covariance
    handover = track.handover(moment.extraction.stamp, view)
    scale = np.sqrt(np.outer(np.diag(expected), np.diag(expected)))
    np.testing.assert_allclose(handover.covariance / scale, expected / scale, atol=1e-3)
    np.testing.assert_allclose(handover.plane, state(track.mu)[:3])
    assert not np.any(handover.velocity)


@pytest.mark.parametrize('factor', [0.5, 2.0])
def test_a_track_goes_on_as_another_with_the_depth_that_is_better_known(rng, factor):
    track, other = Moment(0.3, rng).track(), Moment(0.4, rng).track()
    known, outlines = track.mu.copy(), (other.extent, track.extent)
    other.mu[2] += 0.3
    other.P[2, 2] = factor * track.P[2, 2]
    track.continue_as(other)
    np.testing.assert_array_equal(track.mu, other.mu if factor < 1 else known)
    np.testing.assert_array_equal(track.x, other.x)
    assert track.extent is outlines[int(factor > 1)]
    assert (track.id, track.last_seen) == (7, other.last_seen)
    assert track.evidence[-1] == other.evidence[-1]
    assert len(track.evidence) == (1 if factor < 1 else 2)
    assert (track.edge is other.edge) == (track.drift is other.drift) == (factor < 1)


def test_a_state_that_is_wrong_comes_back_and_one_wrong_detection_does_little(rng):
    moment = Moment(0.5, rng)
    track, item = moment.track(), moment.detection
    track.P[:2, :2] = 1e-4 * np.eye(2)
    wrong = replace(item, z=item.z + np.r_[0.5, 0, np.zeros(6)])
    distances = []
    for _ in range(4):
        track.update(wrong, moment.extraction, moment.view, SETTINGS)
        distances.append(wrong.z[0] - track.mu[0])
    assert distances[0] > 0.45
    assert distances[-1] < 0.25


def test_surfaces_of_one_vehicle_are_seen_about_the_middle_of_all_blocks(rng):
    moment = Moment(0.5, rng)
    whole, view = moment.detection, moment.view
    left = whole.x[:, 0] < np.median(whole.x[:, 0]) - 1
    halves = [replace(whole, x=whole.x[part], block=whole.block[part]) for part in (left, ~left)]
    found = joined(halves, view)
    np.testing.assert_allclose(found.box, whole.box)
    np.testing.assert_allclose(found.z, whole.z, atol=1e-9)
    assert joined(halves[:1], view) is halves[0]


def test_another_middle_of_a_plane_has_the_numerical_derivative(rng):
    moment = Moment(0.5, rng)
    item = replace(moment.detection, z=moment.detection.z + rng.normal(0, 0.1, 8))
    centre = item.z[om.BEARING] + 0.05

    def state(z):
        return compiled.state_about(np.r_[item.z[om.BEARING], z], item.R, centre)[0][2:]
    J = jacobian(state, item.z[2:])
    expected = J @ item.R[2:, 2:] @ J.T
    moved, R = compiled.state_about(item.z, item.R, centre)
    np.testing.assert_allclose(R[2:, 2:], expected, rtol=1e-5, atol=1e-6 * np.abs(expected).max())
    # The plane and its velocity are the same.
    np.testing.assert_allclose(om.plane(moved), om.plane(item.z))
    speed = [np.exp(z[2]) * z[om.RATE] for z in (item.z, moved)]
    np.testing.assert_allclose(*speed)


def edge_evidence(track, detection, **changed):
    return track._depth_evidence(replace(detection, **changed), 1e-9)


def test_a_jump_of_the_edge_puts_it_between_the_two_rows(rng):
    moment = Moment(0.5, rng)
    track, detection = moment.track(), moment.detection
    edge = detection.edge
    track.edge = edge._replace(row=edge.row - 16)
    found = edge_evidence(track, detection)
    # Eight rows higher up the ground is seen at f h / (drop - 8).
    assert np.exp(found.z[2] - detection.z[2]) == pytest.approx(edge.drop / (edge.drop - 8))
    assert found.R[2, 2] == pytest.approx((tracks.EDGE.crossing_sigma / edge.drop)**2)


@pytest.mark.parametrize('side', [-1, 1])
def test_a_prediction_outside_its_block_is_drawn_to_the_block(rng, side):
    moment = Moment(0.5, rng)
    track, detection = moment.track(), moment.detection
    track.mu[2] += side * 0.5
    found = edge_evidence(track, detection)
    bound = detection.edge.log_depth(detection.z[2], -side * detection.edge.half)
    assert found.z[2] == pytest.approx(bound)
    assert abs(found.z[2] - detection.z[2]) < abs(track.mu[2] - detection.z[2])


def test_an_edge_that_stays_says_what_it_said(rng):
    moment = Moment(0.5, rng)
    assert edge_evidence(moment.track(), moment.detection).z[2] == moment.detection.z[2]


def test_repeating_a_detection_does_not_make_its_depth_certain(rng):
    moment = Moment(0.5, rng, Drive((Mover(1, (0, 15), (0, 10)),)))
    track = moment.track()
    sigma = np.sqrt(track.P[2, 2])
    for _ in range(20):
        track.predict(moment.step, moment.view, SETTINGS)
        track.update(moment.detection, moment.extraction, moment.view, SETTINGS)
    assert np.sqrt(track.P[2, 2]) > 0.4 * sigma


def test_a_manoeuvre_raises_the_noise_of_the_prediction():
    calm, braking = (tracks_after(lambda t, a=a: (0, 10 - a * t)) for a in (0, 6))
    assert braking._unrest() > 3 * calm._unrest()


def tracks_after(velocity):
    """Return the track of a car ahead after a second."""
    rng = np.random.default_rng(1)
    drive = Drive((Mover(1, (0, 12), velocity),), scale_sigma=0.0)
    track = Moment(0.1, rng, drive).track()
    for now in np.arange(0.2, 1.05, DT):
        moment = Moment(now, rng, drive)
        track.predict(moment.step, moment.view, SETTINGS)
        track.update(moment.detection, moment.extraction, moment.view, SETTINGS)
    return track


def lattice(columns, rows):
    return 16 * np.array([(column, row) for column in columns for row in rows], float) + 8


@pytest.mark.parametrize('stray', [(4, 1), (-1, 3), (2, -1), (0, 4)])
def test_a_single_block_that_joins_a_body_does_not_widen_its_box(stray):
    body = lattice(range(4), range(5)) if stray[1] in (1, 3) else lattice(range(5), range(4))
    x = np.r_[body, lattice([stray[0]], [stray[1]])]
    block = np.full(x.shape, 16.0)
    np.testing.assert_array_equal(body_box(x, block), box_of(body, block[:-1]))
    assert np.any(box_of(x, block) != box_of(body, block[:-1]))


@pytest.mark.parametrize('growth', [0.97, 1.03, 1.1])
def test_a_body_box_moves_on_with_the_blocks(growth):
    x = np.r_[lattice(range(6), [2, 3]), lattice([2, 3], [0, 1])]
    moved = (4.3, -2.7) + growth * x
    block = np.full(x.shape, growth * 16)
    np.testing.assert_allclose(body_box(moved, block), box_of(moved, block))
    # A whole row more is one block in six, of which rounding or a rounded size makes no two.
    stray = np.r_[moved, (4.3, -2.7) + growth * lattice([2], [4])]
    for size in (growth * 16, growth * 16 + 0.5):
        sizes = np.full(stray.shape, size)
        np.testing.assert_allclose(body_box(stray, sizes), box_of(moved, sizes[:-1]), atol=0.6)


def test_a_place_without_a_rate_leaves_the_rate_and_its_drift(rng):
    first, second = Moment(0.3, rng), Moment(0.4, rng)
    track = first.track()
    assert track.predict(second.step, second.view, SETTINGS)
    track.drift, predicted = np.array([1.0, -2.0, 3.0]), track.mu[om.RATE].copy()
    shifted = second.detection.z + np.r_[0, 0, 0, 1.0, -1.0, 1.0, 0, 0]
    track.update(replace(second.detection, z=shifted, has_depth=False, has_rate=False),
                 second.extraction, second.view, SETTINGS)
    np.testing.assert_array_equal(track.drift, [1.0, -2.0, 3.0])
    assert (len(track.evidence), track.last_seen) == (1, first.extraction.stamp)
    track.confirmed = True
    assert track.obstacle(second.extraction.stamp,
                          second.view).state is ObstacleState.COASTING
    np.testing.assert_allclose(track.mu[om.RATE], predicted, atol=0.1)


def test_a_place_that_disagrees_does_not_unsettle_the_rate(rng):
    moment = Moment(0.5, rng)
    track = moment.track()
    track.evidence[-1] = track.evidence[-1]._replace(nis=1e4, dof=6)
    before = track.P[om.RATE, om.RATE].copy()
    away = moment.detection.z + np.r_[0.5, 0.5, np.zeros(6)]
    track.update(replace(moment.detection, z=away, has_depth=False, has_rate=False),
                 moment.extraction, moment.view, SETTINGS)
    assert np.all(np.diag(track.P)[om.RATE] <= np.diag(before) * (1 + 1e-9))


def test_cabins_gaps_and_small_blocks_are_in_the_box_of_a_body():
    # A bonnet and a boot of one row, a cabin of two, half as wide; a column without a vector.
    x = np.r_[lattice([0, 1, 3, 4], [2]), lattice([1, 3], [0, 1])]
    block = np.full(x.shape, 16.0)
    np.testing.assert_array_equal(body_box(x, block), [0, 0, 80, 48])
    quarters = np.concatenate([x + offset for offset in 4.0 * np.array(
        [(-1, -1), (-1, 1), (1, -1), (1, 1)])])
    np.testing.assert_array_equal(body_box(quarters, np.full(quarters.shape, 8.0)),
                                  [0, 0, 80, 48])


def test_an_obstacle_is_published_without_the_block_that_joined_it(rng):
    moment = Moment(0.5, rng)
    item, track = moment.detection, moment.track()
    before = track.obstacle(0, moment.view)
    joins = replace(item, x=np.r_[item.x, [item.box[:2] + (item.box[2] + 8, 8)]],
                    block=np.r_[item.block, [[16, 16]]])
    track.update(joins, moment.extraction, moment.view, SETTINGS)
    assert track.box(moment.view)[2] == pytest.approx(item.box[2] + 16)
    after = track.obstacle(0, moment.view)
    np.testing.assert_allclose(after.box, before.box)
    known = tracks.start(item, moment.extraction, moment.view, 7)
    known.mu, known.P = track.mu, track.P
    np.testing.assert_allclose(after.outline, known.obstacle(0, moment.view).outline)


def again(track, moment, item, times=1):
    """Update a track by one detection at successive stamps."""
    for _ in range(times):
        later = replace(moment.extraction, stamp=track.last_seen + nanoseconds(DT))
        track.update(item, later, moment.view, SETTINGS)


def part(item, share):
    """Return a detection of a share of an obstacle's blocks only, those on the left."""
    left = item.x[:, 0] <= np.quantile(item.x[:, 0], share)
    return replace(item, x=item.x[left], block=item.block[left])


def test_an_outline_is_that_of_several_detections(rng):
    moment = Moment(0.5, rng)
    item, track = moment.detection, moment.track()
    whole, half = item.box, part(item, 0.5).box
    assert half[2] <= 0.6 * whole[2]
    np.testing.assert_allclose(track.body(moment.view), whole)
    again(track, moment, item, 20)
    again(track, moment, part(item, 0.5))
    np.testing.assert_allclose(track.box(moment.view), half)
    share = 1 - np.exp(-DT / (tracks.OUTLINE_TIMES * SETTINGS.correlation_time))
    np.testing.assert_allclose(track.body(moment.view), whole + share * (half - whole))
    # What stays so is the outline; of two detections in all each tells half of it.
    again(track, moment, part(item, 0.5), 60)
    np.testing.assert_allclose(track.body(moment.view), half, atol=0.1)
    young = moment.track()
    again(young, moment, part(item, 0.5))
    np.testing.assert_allclose(young.body(moment.view), (whole + half) / 2)


def test_an_outline_that_the_picture_cuts_is_the_newest_across_but_not_down(rng):
    moment = Moment(0.5, rng)
    item, track = moment.detection, moment.track()
    again(track, moment, item, 20)
    cut = replace(item, x=item.x - (item.box[0], 10.0))
    again(track, moment, cut)
    share = 1 - np.exp(-DT / (tracks.OUTLINE_TIMES * SETTINGS.correlation_time))
    np.testing.assert_allclose(track.body(moment.view),
                               item.box + (-item.box[0], -10 * share, 0, 0))


def test_an_outline_moves_on_and_grows_with_the_blocks(rng):
    first, second = Moment(0.3, rng), Moment(0.4, rng)
    track = first.track()
    track.update(part(first.detection, 0.5), first.extraction, first.view, SETTINGS)
    extent, box = track.extent.copy(), box_of(track.x, track.block)
    assert track.predict(second.step, second.view, SETTINGS)
    moved = box_of(track.x, track.block)
    growth = moved[2] / box[2]
    assert growth > 1.02
    np.testing.assert_allclose(track.extent[2:], growth * extent[2:])
    np.testing.assert_allclose(track.extent[:2], moved[:2] + growth * (extent - box)[:2])


def test_an_obstacle_without_an_outline_in_the_picture_is_gone(rng):
    first, second = Moment(0.3, rng), Moment(0.4, rng)
    track = first.track()
    track.extent = track.extent - (track.extent[0] + track.extent[2] + 50, 0, 0, 0)
    assert not track.predict(second.step, second.view, SETTINGS)


@pytest.mark.parametrize('size', [(90.0, 40.0), (5.0, 200.0), (16.0, 16.0)])
def test_tiles_fill_a_box_with_blocks_like_macroblocks(size):
    box = np.r_[-3.0, 7.0, size]
    x, block = tiles(box)
    np.testing.assert_allclose(box_of(x, block), box)
    np.testing.assert_allclose(body_box(x, block), box)
    assert block.prod(axis=1).sum() == pytest.approx(np.prod(size))
    assert np.all(block[:, np.array(size) >= 16] > 10)
    assert np.all(block < 24)


def test_a_turn_of_the_camera_blurs_the_rate_by_a_share_of_it(rng):
    moment = Moment(0.5, rng)
    item, view = moment.detection, replace(moment.view, rotation_covariance=np.zeros((3, 3)))
    angle, focal = 0.1, K[0, 0]
    turn = Rotation.from_rotvec((0, angle, 0)).as_matrix()
    still, turned = (blurred(item, replace(view, R_cur_from_prev=R), SETTINGS).R[om.RATE, om.RATE]
                     for R in (np.eye(3), turn))
    x = item.z[0]
    shift = abs(np.tan(np.arctan(x) - angle) - x)  # of the middle, which is near the horizon
    expected = (TURN_SHARE * shift / view.dt)**2
    np.testing.assert_allclose(turned[0, 0] - still[0, 0], expected, rtol=0.02)
    size = min(item.box[2:]) / 2
    np.testing.assert_allclose(turned[2, 2] - still[2, 2], expected * (focal / size)**2, rtol=0.02)
