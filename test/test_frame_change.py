import made_up
from mv_slapse.frame_change import step_in
from mv_slapse.pipeline import Step
from mv_slapse.ros_frames import Pose
import numpy as np
import pytest


@pytest.fixture
def moved():
    rng = np.random.default_rng(0)
    pose = Pose(made_up.rotation(rng), rng.normal(size=3), 0.01 * np.eye(6))
    step = Step(made_up.correspondences(rng), made_up.extraction(rng), made_up.scene(rng),
                (made_up.obstacle(rng),), (made_up.handover(rng),))
    return pose, step, step_in(step, pose)


def test_every_place_is_moved_and_every_direction_turned(moved):
    pose, step, other = moved
    before, after = step.obstacles[0], other.obstacles[0]
    for name in ('position', 'outline'):
        np.testing.assert_allclose(getattr(after, name),
                                   getattr(before, name) @ pose.R.T + pose.t)
    np.testing.assert_allclose(after.velocity, pose.R @ before.velocity)
    np.testing.assert_allclose(other.scene.t_world_from_cam,
                               pose.R @ step.scene.t_world_from_cam + pose.t)
    np.testing.assert_allclose(other.scene.R_world_from_cam, pose.R @ step.scene.R_world_from_cam)
    np.testing.assert_allclose(other.scene.velocity_world, pose.R @ step.scene.velocity_world)
    np.testing.assert_allclose(other.handovers[0].velocity, pose.R @ step.handovers[0].velocity)


def test_what_lies_on_a_plane_still_does(moved):
    pose, step, other = moved
    for before, after in ((step.obstacles[0], other.obstacles[0]),
                          (step.handovers[0], other.handovers[0])):
        point = -before.plane / (before.plane @ before.plane)
        assert after.plane @ (pose.R @ point + pose.t) == pytest.approx(-1)
    plane, there = step.scene.planes[0], other.scene.planes[0]
    point = -plane.depth * plane.normal
    assert there.normal @ (pose.R @ point + pose.t) + there.depth == pytest.approx(0, abs=1e-9)


def test_how_unsure_the_frame_is_adds_to_the_pose(moved):
    pose, step, other = moved
    turned = np.kron(np.eye(2), pose.R)
    added = other.scene.pose_covariance - turned @ step.scene.pose_covariance @ turned.T
    arm = np.linalg.norm(other.scene.t_world_from_cam - pose.t)
    assert np.trace(added[:3, :3]) == pytest.approx(0.01 * (3 + 2 * arm**2))


def test_what_the_camera_saw_stays():
    rng = np.random.default_rng(1)
    step = Step(made_up.correspondences(rng), made_up.extraction(rng), made_up.scene(rng), (), ())
    moved = step_in(step, Pose(np.eye(3), np.ones(3)))
    assert moved.extraction is step.extraction
    assert moved.correspondences is step.correspondences
