"""The scene filter on drives with known truth: trajectory, scale, loss, standstill, hand-over."""

from dataclasses import replace

import canyon as canyon_views
import formulas
from mv_slapse.config import SceneSettings
from mv_slapse.evaluation.consistency import unexplained_step
from mv_slapse.geometry import rotation
from mv_slapse.records import (
    Label,
    PlaneHandover,
    ScaleStatus,
    TrackingStatus,
)
from mv_slapse.scene import plane_map as scene_map
from mv_slapse.scene.filter import SceneFilter
from mv_slapse.scene.progress import PATIENCE
from mv_slapse.scene.scale.height import ENOUGH
from mv_slapse.scene.update import stationary
from numeric import jacobian
import numpy as np
import pytest
from scene_drive import (
    assert_is_covariance,
    Canyon,
    driven,
    GROUND,
    METRIC,
    position_errors,
    SPEED,
    stamp,
    turn_errors,
)

WALL = 1


def test_without_noise_the_trajectory_is_exact():
    canyon = Canyon()
    estimates = driven(canyon, 30)
    assert max(position_errors(canyon, estimates)) < 0.02
    assert max(turn_errors(canyon, estimates)) < 1e-3
    last = estimates[-1]
    assert all(e.status is TrackingStatus.OK for e in estimates[ENOUGH - 1:])
    R = canyon.pose(30)[0]
    np.testing.assert_allclose(last.velocity_world, SPEED * R[:, 2], atol=0.3)
    np.testing.assert_allclose(last.omega_cam, [0, canyon.yaw_rate, 0], atol=0.01)
    assert last.baseline == pytest.approx(0.1 * SPEED, rel=0.01)
    assert (last.scale_status, last.scale_source) == (ScaleStatus.METRIC, 'camera height')


def test_one_linearisation_at_the_motion_seen_is_nearly_enough():
    canyon = Canyon()
    estimates = driven(canyon, 10, replace(METRIC, iterations=1))
    assert max(position_errors(canyon, estimates)) < 0.02


def test_pose_covariance_is_about_the_axes_of_the_world():
    canyon, filter_ = Canyon(yaw_rate=0.6), SceneFilter(METRIC)
    last = driven(canyon, 15, filter_=filter_)[-1]
    state = filter_._state

    def pose(e):
        moved = state.moved(e).current
        return np.r_[moved.t, rotation.log(moved.R @ state.current.R.T)]

    J = jacobian(pose, np.zeros(state.size))
    scale = np.sqrt(np.diag(last.pose_covariance))
    np.testing.assert_allclose(last.pose_covariance / np.outer(scale, scale),
                               J @ state.error.total @ J.T / np.outer(scale, scale), atol=1e-4)


def test_with_noise_the_trajectory_stays_within_a_bound(rng):
    canyon = Canyon(rng, 0.4)
    estimates = driven(canyon, 40, replace(METRIC, relief=0.0))  # its surfaces are planes
    assert max(position_errors(canyon, estimates)) < 0.01 * SPEED * 4  # 1 % of 32 m
    assert np.degrees(max(turn_errors(canyon, estimates))) < 0.3
    here, there = estimates[-1].t_world_from_cam, canyon.pose(40)[1]
    for plane in estimates[-1].planes[:3]:
        normal, depth = formulas.to_normal_depth(canyon.planes(0)[plane.id])
        assert canyon_views.angle_between(plane.normal, normal) < np.radians(1.0)
        assert plane.normal @ here + plane.depth == pytest.approx(normal @ there + depth, rel=0.05)
        assert_is_covariance(plane.covariance)


def test_without_camera_height_the_first_translation_is_the_unit():
    canyon = Canyon()
    estimates = driven(canyon, 30, SceneSettings())
    assert estimates[0].baseline == pytest.approx(1.0, abs=1e-3)
    assert max(position_errors(canyon, estimates, scale=0.1 * SPEED)) < 0.1
    assert estimates[-1].scale_status is ScaleStatus.UNKNOWN
    assert estimates[-1].scale_source == 'first translation'


def test_known_planes_carry_the_scale_where_no_ratio_is_known():
    canyon = Canyon()
    estimates = driven(canyon, 20, SceneSettings(), ratio=False)
    assert estimates[-1].baseline == pytest.approx(1.0, abs=0.05)
    assert estimates[-1].status is TrackingStatus.OK


def test_errors_have_the_size_that_the_covariance_says():
    settings = replace(METRIC, relief=0.0, depth_bias=0.01, dependence=1.5)
    distances = []
    for seed in range(12):
        canyon = Canyon(np.random.default_rng(seed), 0.4)
        last = driven(canyon, 15, settings)[-1]
        R, t = canyon.pose(15)
        error = np.r_[t - last.t_world_from_cam, rotation.log(R @ last.R_world_from_cam.T)]
        distances.append(error @ np.linalg.solve(last.pose_covariance, error))
        assert_is_covariance(last.pose_covariance)
        assert_is_covariance(last.twist_covariance)
    # Six degrees of freedom. Height and scale are held by priors wider than this noise.
    assert 0.5 < np.mean(distances) < 9


def test_planes_that_all_contradict_the_map_are_no_support(rng):
    canyon, filter_ = Canyon(rng, 0.3), SceneFilter(METRIC)
    driven(canyon, 10, filter_=filter_)
    statuses = []
    for k in range(11, 24):
        extraction = canyon.extraction(k)
        factor = 3.0 if k % 2 else 1 / 3
        wrong = tuple(replace(p, plane=factor * p.plane) for p in extraction.planes
                      if not p.is_ground)
        estimate, _ = filter_.step(replace(extraction, planes=wrong))
        statuses.append(estimate.status)
    assert statuses[:10] == [TrackingStatus.PREDICTED] * 10
    assert statuses[-1] is TrackingStatus.LOST
    assert 'contradict the map' in estimate.reason
    found = driven(canyon, 43, filter_=filter_, first=24)
    assert found[-1].status is TrackingStatus.OK


def test_before_the_first_motion_it_is_initialising_at_the_origin():
    canyon, filter_ = Canyon(), SceneFilter(METRIC)
    first = filter_.step(canyon.blank(1, reason='11 motion vectors'))[0]
    assert (first.status, first.reason) == (TrackingStatus.INITIALISING, '11 motion vectors')
    np.testing.assert_array_equal(first.t_world_from_cam, 0)
    np.testing.assert_array_equal(first.R_world_from_cam, np.eye(3))


def test_a_plane_that_moves_is_handed_to_the_tracker():
    canyon, filter_ = Canyon(), SceneFilter(METRIC)
    driven(canyon, 5, filter_=filter_)
    extraction = canyon.extraction(6)
    planes = [replace(p, label=Label.MOVING) if p.id == WALL else p for p in extraction.planes]
    estimate, leaving = filter_.step(replace(extraction, planes=tuple(planes)))
    assert [(h.id, h.to_label, h.stamp) for h in leaving] == [(WALL, Label.MOVING, stamp(6))]
    np.testing.assert_allclose(leaving[0].plane, canyon.planes(0)[WALL], atol=2e-3)
    assert WALL not in [plane.id for plane in estimate.planes]


def test_a_plane_that_has_come_to_rest_joins_the_map():
    canyon, filter_ = Canyon(), SceneFilter(METRIC)
    driven(canyon, 5, filter_=filter_)
    plane = np.array([0, 0, -1 / 20])
    joining = PlaneHandover(stamp(6), 70, Label.STATIONARY, plane, np.zeros(3), 1e-6 * np.eye(6))
    leaving = replace(joining, id=71, to_label=Label.MOVING)
    estimate, _ = filter_.step(canyon.extraction(6), [joining, leaving])
    found = {plane.id: plane for plane in estimate.planes}
    assert 71 not in found
    np.testing.assert_allclose(found[70].normal, [0, 0, -1], atol=1e-6)
    assert found[70].depth == pytest.approx(20, abs=1e-3)


def without(extraction, id_):
    """Return an extraction that does not show a plane."""
    return replace(extraction, planes=tuple(p for p in extraction.planes if p.id != id_),
                   plane_id=np.where(extraction.plane_id == id_, -1, extraction.plane_id))


@pytest.mark.parametrize('seen', [scene_map.WELL_SEEN - 1, scene_map.WELL_SEEN])
def test_planes_without_support_are_forgotten_after_their_lifetime_unless_well_seen(seen):
    canyon, filter_ = Canyon(), SceneFilter(replace(METRIC, plane_lifetime=0.35))
    driven(canyon, seen, filter_=filter_)
    ids = []
    for k in range(seen + 1, seen + 6):
        estimate, _ = filter_.step(without(canyon.extraction(k), WALL))
        ids.append([plane.id for plane in estimate.planes])
    held = seen >= scene_map.WELL_SEEN
    assert [WALL in seen for seen in ids] == [True, True, True, held, held]


def length_after_a_gap(rng, gap):
    """Return the last baseline over the true one; the camera brakes while no plane is in view."""
    canyon = Canyon(rng, 0.3, way=lambda t: SPEED * (t if t < 1 else 1 + 0.7 * (t - 1)))
    filter_ = SceneFilter(SceneSettings(plane_lifetime=0.35))
    for k in range(1, 10 + gap + 5):
        extraction = canyon.extraction(k, ratio=False)
        for id_ in range(4) if 10 <= k < 10 + gap else ():
            extraction = without(extraction, id_)
        estimate, _ = filter_.step(extraction)
    return estimate.baseline / 0.7


def test_planes_that_come_back_into_view_bring_the_scale_back(monkeypatch):
    gap = 8
    kept = [length_after_a_gap(np.random.default_rng(seed), gap) for seed in range(4)]
    np.testing.assert_allclose(kept, 1, atol=0.03)
    monkeypatch.setattr(scene_map, 'WELL_SEEN', 100)
    given_up = length_after_a_gap(np.random.default_rng(0), gap)
    assert given_up > 1.2


def test_a_ground_that_contradicts_the_map_is_not_believed_at_once():
    canyon, filter_ = Canyon(), SceneFilter(METRIC)
    driven(canyon, 10, filter_=filter_)
    for k in range(11, 11 + PATIENCE):
        extraction = canyon.extraction(k)
        floor = extraction.planes[GROUND]
        wrong = replace(floor, plane=1.6 * floor.plane)
        estimate, _ = filter_.step(replace(extraction, planes=(wrong, *extraction.planes[1:])))
        assert np.linalg.norm(estimate.t_world_from_cam - canyon.pose(k)[1]) < 0.1


def test_a_wall_that_contradicts_the_map_takes_its_place_only_if_it_goes_on():
    canyon, filter_ = Canyon(), SceneFilter(METRIC)
    driven(canyon, 10, filter_=filter_)
    shares = []
    for k in range(11, 12 + PATIENCE):
        extraction = canyon.extraction(k)
        floor, wall, *others = extraction.planes
        bare = without(extraction, wall.id)  # its blocks would mend it
        wrong = replace(wall, plane=1.6 * wall.plane)
        estimate, _ = filter_.step(replace(bare, planes=(floor, wrong, *others)))
        plane = next(plane for plane in estimate.planes if plane.id == wall.id)
        depth = plane.depth + plane.normal @ estimate.t_world_from_cam
        shares.append(depth * np.linalg.norm(wall.plane) / estimate.baseline)
    np.testing.assert_allclose(shares[:PATIENCE], 1, atol=0.02)
    assert shares[PATIENCE] == pytest.approx(1 / 1.6, abs=0.02)


def test_with_no_known_plane_and_no_ratio_the_length_is_predicted():
    canyon, filter_ = Canyon(), SceneFilter(SceneSettings())
    driven(canyon, 10, SceneSettings(), filter_)
    bare = replace(canyon.extraction(11, ratio=False), planes=())
    estimate, _ = filter_.step(bare)
    assert estimate.status is TrackingStatus.PREDICTED
    assert 'its length is predicted' in estimate.reason
    assert canyon_views.turn_between(estimate.R_world_from_cam, canyon.pose(11)[0]) < 2e-3


def without_ground(extraction, label=Label.UNKNOWN):
    """What a pair shows whose lower half, with this label, makes no plane."""
    low = extraction.x_cur[:, 1] > extraction.K[1, 2]
    return replace(extraction, planes=extraction.planes[1:],
                   plane_id=np.where(low, -1, extraction.plane_id),
                   label=np.where(low, label, extraction.label).astype(np.int8))


def test_until_the_ground_is_found_the_covariance_holds_that_lengths_are_guessed():
    canyon, filter_ = Canyon(), SceneFilter(METRIC)
    for k in range(1, 6):
        guessed, _ = filter_.step(without_ground(canyon.extraction(k), Label.STATIONARY))
    length = np.linalg.norm(guessed.t_world_from_cam)
    along = guessed.t_world_from_cam / length
    sigma = np.sqrt(along @ guessed.pose_covariance[:3, :3] @ along)
    assert 0.2 * length < sigma < 0.25 * length
    found = driven(canyon, 5 + ENOUGH, filter_=filter_, first=6)[-1]
    assert found.scale_status is ScaleStatus.METRIC
    # The ground's length goes back along ratios, each unsure by 1 %.
    assert np.sqrt(along @ found.pose_covariance[:3, :3] @ along) < 0.051 * length


def test_a_ground_found_later_makes_the_scale_metric():
    canyon, filter_ = Canyon(), SceneFilter(METRIC)
    for k in range(1, 6):
        estimate, _ = filter_.step(without_ground(canyon.extraction(k)))
        assert estimate.status is TrackingStatus.INITIALISING
        assert 'the ground' in estimate.reason
    assert estimate.scale_status is ScaleStatus.UNKNOWN
    assert estimate.baseline == pytest.approx(1.0, abs=0.05)
    last = driven(canyon, 15, filter_=filter_, first=6)[-1]
    assert last.scale_status is ScaleStatus.METRIC
    # Outlines have changed their unit too: the wall ends where the street does, after 30 m.
    wall = next(plane for plane in last.planes if plane.id == WALL)
    assert wall.outline[:, 2].max() < 31
    assert np.linalg.norm(last.t_world_from_cam - canyon.pose(15)[1]) < 0.2


def test_a_ground_found_after_more_than_a_second_leaves_what_was_published():
    canyon, filter_ = Canyon(), SceneFilter(METRIC)
    early = [filter_.step(without_ground(canyon.extraction(k)))[0] for k in range(1, 16)]
    assert {e.status for e in early[11:]} == {TrackingStatus.OK}
    later = driven(canyon, 30, filter_=filter_, first=16)
    assert unexplained_step([*early, *later]) == 0
    for k, estimate in enumerate(later[ENOUGH - 1:], 15 + ENOUGH):
        assert estimate.scale_status is ScaleStatus.METRIC
        error = canyon.pose(k)[1] - estimate.t_world_from_cam
        assert error @ np.linalg.solve(estimate.pose_covariance[:3, :3], error) < 14.2


def test_the_filter_sees_what_stands_and_what_is_far_and_nothing_else():
    extraction = Canyon().extraction(3)
    label = extraction.label.copy()
    label[extraction.plane_id == GROUND] = Label.MOVING
    label[1::6] = Label.UNKNOWN
    pair, plane_id = stationary(replace(extraction, label=label))
    used = (label == Label.STATIONARY) | (label == Label.INFINITY)
    np.testing.assert_array_equal(pair.x_prev, extraction.x_prev[used])
    np.testing.assert_array_equal(plane_id, extraction.plane_id[used])


def test_what_touches_a_mover_and_is_on_no_plane_is_left_out():
    extraction = Canyon().extraction(3)
    label, plane_id = extraction.label.copy(), extraction.plane_id.copy()
    cell = (extraction.x_cur // 16).astype(int)
    label[np.all(cell == (20, 15), axis=1)] = Label.MOVING
    label[np.all(cell == (21, 16), axis=1)] = Label.STATIONARY
    label[np.all(cell == (22, 15), axis=1)] = Label.STATIONARY
    plane_id[np.all(np.abs(cell - (20, 15)) <= 2, axis=1)] = -1
    plane_id[np.all(cell == (19, 15), axis=1)] = WALL
    pair, _ = stationary(replace(extraction, label=label, plane_id=plane_id))
    kept = {tuple(x) for x in pair.x_prev}
    seen = {tuple(at) for at, x in zip(cell, extraction.x_prev, strict=True) if tuple(x) in kept}
    touching = {(x, y) for x in (19, 20, 21) for y in (14, 15, 16)} & {tuple(c) for c in cell}
    assert touching & seen == {(19, 15)}
    assert (22, 15) in seen


def test_what_stands_among_vectors_that_mostly_do_not_is_left_out_but_on_a_plane():
    extraction = Canyon().extraction(3)
    cell = (extraction.x_cur // 16).astype(int)
    around = np.flatnonzero(np.all(np.abs(cell - (10, 18)) <= 2, axis=1))
    middle = np.flatnonzero(np.all(cell == (10, 18), axis=1))[0]
    others = np.setdiff1d(around, middle)
    assert len(others) == 24

    def is_used(n_astray, on_plane=False):
        label, plane_id = extraction.label.copy(), extraction.plane_id.copy()
        label[around], plane_id[around] = Label.STATIONARY, -1
        label[others[:n_astray]] = Label.UNKNOWN
        plane_id[middle] = GROUND if on_plane else -1
        pair, _ = stationary(replace(extraction, label=label, plane_id=plane_id))
        return bool(np.any(np.all(pair.x_prev == extraction.x_prev[middle], axis=1)))

    assert is_used(12)
    assert not is_used(13)
    assert is_used(24, on_plane=True)


def test_a_road_that_may_slope_is_less_sure_of_its_normal():
    spread = []
    for slope in (0.0, 0.05):
        canyon, filter_ = Canyon(), SceneFilter(SceneSettings(ground_slope=slope))
        driven(canyon, 10, filter_=filter_)
        ground = filter_.step(canyon.blank(11))[0].planes[GROUND]
        spread.append(np.trace(ground.covariance[:3, :3]))
    assert spread[1] - spread[0] > 0.05**2 * 0.8  # over 0.8 m


def test_a_metric_plane_out_of_view_is_known_less_with_the_way():
    free = replace(METRIC, camera_height=0.0)
    for settings, grows in ((METRIC, True), (replace(METRIC, relief=0.0), False), (free, False)):
        canyon, filter_ = Canyon(), SceneFilter(settings)
        before = driven(canyon, 10, filter_=filter_)[-1].planes[WALL].covariance[3, 3]
        # The plane stays where it is in {W}, and nothing is seen for 1.6 m.
        for k in (11, 12):
            wall = filter_.step(canyon.blank(k))[0].planes[WALL]
        added = wall.covariance[3, 3] - before
        assert (added > 0.9 * 0.03**2 * wall.depth * 1.6) == grows


def test_the_same_extractions_give_the_same_bits():
    runs = [driven(Canyon(np.random.default_rng(4), 0.4), 10) for _ in range(2)]
    for one, two in zip(*runs, strict=True):
        np.testing.assert_array_equal(one.t_world_from_cam, two.t_world_from_cam)
        np.testing.assert_array_equal(one.pose_covariance, two.pose_covariance)
