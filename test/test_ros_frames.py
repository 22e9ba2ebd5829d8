import made_up
from mv_slapse import ros_frames
from mv_slapse.ros_frames import Pose, RosFrames, Twist
import numpy as np
from numpy.testing import assert_allclose
import pytest
from scipy.spatial.transform import Rotation


@pytest.fixture
def frames(rng) -> RosFrames:
    return RosFrames(R_base_from_cam=made_up.rotation(rng), t_base_from_cam=rng.normal(size=3),
                     R_odom_from_start=made_up.rotation(rng), t_odom_from_start=rng.normal(size=3))


@pytest.fixture
def pose(rng) -> Pose:
    return Pose(made_up.rotation(rng), rng.normal(size=3), made_up.covariance(rng, 6))


def numeric(function, x, step=1e-6):
    columns = [(function(x + e) - function(x - e)) / (2 * step) for e in np.eye(len(x)) * step]
    return np.stack(columns, axis=-1)


def test_what_lies_ahead_right_and_below_does_so_in_odom():
    ahead, right, below = ros_frames.points_to_odom(np.eye(3)[[2, 0, 1]], RosFrames())
    assert_allclose([ahead, right, below], [[1, 0, 0], [0, -1, 0], [0, 0, -1]])


def test_a_pose_moves_the_points_of_the_base_to_where_the_camera_sees_them(rng, frames, pose):
    X_cam = rng.normal(size=(5, 3))
    X_base = X_cam @ frames.R_base_from_cam.T + frames.t_base_from_cam
    moved = ros_frames.pose_to_odom(pose, frames)
    assert_allclose(X_base @ moved.R.T + moved.t,
                    ros_frames.points_to_odom(X_cam @ pose.R.T + pose.t, frames))


def test_the_first_pose_of_the_base_is_the_start_in_odom(frames):
    first = ros_frames.pose_to_odom(Pose(np.eye(3), np.zeros(3)), frames)
    assert_allclose(first.R, frames.R_odom_from_start, atol=1e-12)
    assert_allclose(first.t, frames.t_odom_from_start, atol=1e-12)
    usual = ros_frames.pose_to_odom(Pose(np.eye(3), np.zeros(3)), RosFrames(
        R_base_from_cam=frames.R_base_from_cam, t_base_from_cam=frames.t_base_from_cam))
    assert_allclose(usual.R, np.eye(3), atol=1e-12)
    assert_allclose(usual.t, 0, atol=1e-12)


def test_a_pose_comes_back_with_its_covariance(frames, pose):
    back = ros_frames.pose_to_world(ros_frames.pose_to_odom(pose, frames), frames)
    assert_allclose(back.R, pose.R, atol=1e-12)
    assert_allclose(back.t, pose.t)
    assert_allclose(back.covariance, pose.covariance, atol=1e-9)


def test_the_covariance_of_a_pose_follows_its_numerical_jacobian(frames, pose):
    moved = ros_frames.pose_to_odom(pose, frames)

    def error(e):
        R = Rotation.from_rotvec(e[3:]).as_matrix() @ pose.R
        bent = ros_frames.pose_to_odom(Pose(R, pose.t + e[:3]), frames)
        return np.r_[bent.t - moved.t, Rotation.from_matrix(bent.R @ moved.R.T).as_rotvec()]

    J = numeric(error, np.zeros(6))
    assert_allclose(moved.covariance, J @ pose.covariance @ J.T, atol=1e-5)


def test_the_twist_is_the_derivative_of_the_pose_of_the_base(rng, frames, pose):
    velocity, omega = rng.normal(size=(2, 3))

    def base_at(time):
        R = pose.R @ Rotation.from_rotvec(omega * time).as_matrix()
        return ros_frames.pose_to_odom(Pose(R, pose.t + velocity * time), frames)

    step = 1e-5
    before, now, after = base_at(-step), base_at(0), base_at(step)
    twist = ros_frames.twist_to_base(Twist(velocity, omega), pose.R, frames)
    assert_allclose(twist.linear, now.R.T @ (after.t - before.t) / (2 * step), atol=1e-7)
    turned = Rotation.from_matrix(before.R.T @ after.R).as_rotvec()
    assert_allclose(twist.angular, turned / (2 * step), atol=1e-7)


def test_a_twist_comes_back_with_its_covariance(rng, frames, pose):
    twist = Twist(*rng.normal(size=(2, 3)), made_up.covariance(rng, 6))
    there = ros_frames.twist_to_base(twist, pose.R, frames)
    back = ros_frames.twist_to_world(there, pose.R, frames)
    assert_allclose(back.linear, twist.linear)
    assert_allclose(back.angular, twist.angular)
    assert_allclose(back.covariance, twist.covariance, atol=1e-9)


def test_a_plane_keeps_its_points_in_either_form(rng, frames):
    normal, depth = rng.normal(size=3), 2.0
    X = rng.normal(size=(6, 3))
    X -= ((X @ normal + depth) / (normal @ normal))[:, None] * normal
    X_odom = ros_frames.points_to_odom(X, frames)
    moved = ros_frames.normal_depth_to_odom(normal, depth, np.eye(4), frames)
    assert_allclose(X_odom @ moved[0] + moved[1], 0, atol=1e-12)
    assert_allclose(X_odom @ ros_frames.plane_to_odom(normal / depth, frames), -1)


def test_plane_covariances_follow_their_numerical_jacobians(rng, frames):
    plane, P = rng.normal(0, 0.2, 3), made_up.covariance(rng, 6)
    J = np.zeros((6, 6))
    J[:3, :3] = numeric(lambda p: ros_frames.plane_to_odom(p, frames), plane)
    J[3:, 3:] = frames.R_odom_from_world
    moved = ros_frames.plane_velocity_covariance_to_odom(plane, P, frames)
    assert_allclose(moved, J @ P @ J.T, rtol=1e-5, atol=1e-6)

    def both(x):
        normal, depth, _ = ros_frames.normal_depth_to_odom(x[:3], x[3], np.eye(4), frames)
        return np.r_[normal, depth]

    x, P = rng.normal(size=4), made_up.covariance(rng, 4)
    J = numeric(both, x)
    moved = ros_frames.normal_depth_to_odom(x[:3], x[3], P, frames)[2]
    assert_allclose(moved, J @ P @ J.T, atol=1e-6)
