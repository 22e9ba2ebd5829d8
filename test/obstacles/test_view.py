"""The camera's part in the obstacle filters: units, frames, speeds."""

from dataclasses import replace

from drawn_movers import CAMERA_HEIGHT, Drive, DT, Mover
from mv_slapse.geometry import plane as planes
from mv_slapse.obstacles.view import relative_motion, view_of
from mv_slapse.records import MotionStatus, ScaleStatus
from numeric import jacobian
import numpy as np
import pytest

DRIVE = Drive((Mover(1, (0, 20), (0, 5)),), omega=0.3, scale_sigma=0.0)


@pytest.fixture
def pair(rng):
    return DRIVE.extraction(0.4, 0.4 + DT, rng), DRIVE.scene(0.4, 0.4 + DT)


def test_lengths_are_in_map_units(pair):
    view = view_of(*pair, None)
    R, t = DRIVE.motion(0.4, 0.4 + DT)
    np.testing.assert_allclose(view.t_cur_from_prev, t)
    np.testing.assert_allclose(view.R_cur_from_prev, R)
    np.testing.assert_allclose(view.scene_velocity, t / DT)


def test_standing_camera_has_lengths_in_map_units_already(pair):
    extraction, scene = pair
    still = replace(extraction.motion, t_cur_from_prev=np.zeros(3),
                    status=MotionStatus.STANDSTILL)
    view = view_of(replace(extraction, motion=still), replace(scene, baseline=0.0), None)
    assert view.unit == 1.0
    assert not np.any(view.scene_velocity)
    assert not np.any(view.scene_covariance)


def test_unknown_motion_is_taken_from_the_poses(pair):
    extraction, scene = pair
    blind = replace(extraction, motion=replace(extraction.motion, status=MotionStatus.UNKNOWN,
                                               R_cur_from_prev=np.eye(3)))
    before = DRIVE.scene(0.4 - DT, 0.4)
    view = view_of(blind, scene, before)
    R, t = DRIVE.motion(0.4, 0.4 + DT)
    np.testing.assert_allclose(view.R_cur_from_prev, R, atol=1e-12)
    np.testing.assert_allclose(view.t_cur_from_prev, t, atol=1e-12)
    np.testing.assert_allclose(relative_motion(before, scene)[1], t, atol=1e-12)


def test_ground_is_under_the_camera(pair):
    ground = view_of(*pair, None).ground
    assert ground @ [0, CAMERA_HEIGHT, 7] == pytest.approx(-1)
    extraction, scene = pair
    assert view_of(extraction, replace(scene, planes=()), None).ground is None


def test_ground_out_of_sight_stays_where_the_camera_had_it(pair):
    extraction, scene = pair
    last = view_of(*pair, None)
    sunk = replace(scene, t_world_from_cam=scene.t_world_from_cam + (0.0, 1.0, 0.0))
    for unseen, height in ((0.1, CAMERA_HEIGHT - 1), (0.3, CAMERA_HEIGHT)):
        late = replace(sunk, stamp=scene.stamp + round(unseen * 1e9))
        ground = view_of(extraction, late, None, last).ground
        assert 1 / np.linalg.norm(ground) == pytest.approx(height)
    assert view_of(extraction, replace(late, planes=()), None, last).ground is None


def test_planes_change_frame_and_back_with_numerical_jacobians(pair, rng):
    view = view_of(*pair, None)
    plane = rng.normal(0, 0.1, 3)
    world, by_plane = view.plane_to_world(plane)
    np.testing.assert_allclose(world, planes.transform(plane, view.R_world_from_cam,
                                                       view.t_world_from_cam))
    np.testing.assert_allclose(by_plane, jacobian(lambda p: view.plane_to_world(p)[0], plane),
                               rtol=1e-4, atol=1e-5)
    back, by_world = view.plane_to_cam(world)
    np.testing.assert_allclose(back, plane)
    np.testing.assert_allclose(by_world @ by_plane, np.eye(3), atol=1e-9)


def test_point_of_a_plane_is_on_it_in_the_world(pair, rng):
    view = view_of(*pair, None)
    plane, ray = np.array([0.02, 0.01, -0.1]), np.array([0.2, 0.1, 1.0])
    X = ray / -(plane @ ray)
    assert view.plane_to_world(plane)[0] @ (
        view.R_world_from_cam @ X + view.t_world_from_cam) == pytest.approx(-1)


def test_a_plane_through_the_origin_stays_finite(pair):
    view = view_of(*pair, None)
    toward = view.R_world_from_cam.T @ view.t_world_from_cam
    plane = toward / (toward @ toward)
    world, by_plane = view.plane_to_world(plane)
    assert np.all(np.isfinite(world))
    assert np.all(np.isfinite(by_plane))


def test_speed_error_is_the_scene_filters_but_never_below_a_percent(pair):
    extraction, scene = pair
    sure = replace(extraction, motion=replace(extraction.motion, covariance=np.zeros((6, 6))))
    ahead = np.linalg.norm(view_of(*pair, None).scene_velocity)
    for variance, expected in ((0.25, 0.5), (1e-9, 0.01 * ahead)):
        unsure = replace(scene, twist_covariance=np.diag([variance] * 3 + [1e-8] * 3))
        view = view_of(sure, unsure, None)
        assert np.sqrt(np.trace(view.scene_covariance)) == pytest.approx(expected)


def along(covariance, view):
    """Return the standard deviation of the scene's speed as a share of it."""
    return np.sqrt(view.scene_velocity @ covariance @ view.scene_velocity) / np.sum(
        view.scene_velocity**2)


@pytest.mark.parametrize(('sigma', 'jump', 'expected'), [
    (0.02, 0.0, np.sqrt(6 * 1.0 / DT) * 0.02), (1e-5, 0.0, 0.01), (1e-5, 0.3, 0.3),
    (0.02, 5.0, 0.5), (np.inf, 0.0, 0.5)])
@pytest.mark.parametrize('status', [ScaleStatus.UNKNOWN, ScaleStatus.METRIC])
def test_a_wrong_scale_is_no_error_between_obstacle_and_scene(pair, status, sigma, jump,
                                                          expected):
    extraction, scene = pair
    last = replace(view_of(*pair, None), dt=2 * DT)
    extraction = replace(extraction, baseline_ratio=np.log(0.5) + jump,
                         baseline_ratio_sigma=sigma, motion=replace(
                             extraction.motion, covariance=np.zeros((6, 6))))
    speed = np.linalg.norm(last.scene_velocity)
    scene = replace(scene, scale_status=status,
                    twist_covariance=np.diag([(0.5 * speed)**2] * 3 + [1e-8] * 3))
    view = view_of(extraction, scene, None, last)
    assert along(view.scene_covariance, view) == pytest.approx(expected)
    aside = np.cross(view.scene_velocity, [0.0, 1.0, 0.0])
    np.testing.assert_allclose(view.scene_covariance @ aside, 0, atol=1e-9)
