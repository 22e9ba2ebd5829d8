"""Between {W} and the frames of ROS: the one place where optical axes become z-up axes.

``{W}`` is the first key frame's camera with optical axes (x right, y down, z forward); ``odom`` is
the base's pose at that moment (x forward, y left, z up, REP-103). With B the pose of the camera on
the base, X_base = B X_cam, a point moves by X_odom = B X_W, and a pose by conjugation:
T_odom_from_base = B T_world_from_cam B^-1. Where nothing is known of the base it is the camera
itself with turned axes, and B is the fixed rotation R_BODY_FROM_OPTICAL. Where odom begins
elsewhere (on the ground, see ``level``; at a given pose), S is the base's pose in odom at that
moment: X_odom = S B X_W.

Every conversion has its inverse, and carries covariances by its Jacobian.
"""

from dataclasses import dataclass, field

from mv_slapse.geometry.rotation import skew
import numpy as np

R_BODY_FROM_OPTICAL = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])


@dataclass(frozen=True)
class RosFrames:
    """Names of the frames, and the camera on the base."""

    odom: str = 'odom'  # frame ids
    base: str = 'camera_link'
    camera: str = 'camera_optical'  # the optical frame of the pictures
    # X_base = R X_cam + t, (3, 3), (3,) [m or map unit]
    R_base_from_cam: np.ndarray = field(default_factory=R_BODY_FROM_OPTICAL.copy)
    t_base_from_cam: np.ndarray = field(default_factory=lambda: np.zeros(3))
    # pose in odom of the base at the first key frame, (3, 3), (3,)
    R_odom_from_start: np.ndarray = field(default_factory=lambda: np.eye(3))
    t_odom_from_start: np.ndarray = field(default_factory=lambda: np.zeros(3))
    is_base_known: bool = False  # whether anybody has told the camera's place on the base

    @property
    def R_odom_from_world(self) -> np.ndarray:
        """Rotation (3, 3) from {W} to odom."""
        return self.R_odom_from_start @ self.R_base_from_cam

    @property
    def t_odom_from_world(self) -> np.ndarray:
        """Place (3,) of {W}'s origin in odom."""
        return self.R_odom_from_start @ self.t_base_from_cam + self.t_odom_from_start

    def inverse(self) -> 'RosFrames':
        """Return the frames that undo these: what maps {W} to odom then maps odom to {W}."""
        R, b = self.R_base_from_cam.T, self.t_base_from_cam
        R_start, t_start = self.R_odom_from_start.T, self.t_odom_from_start
        return RosFrames(self.camera, self.camera, self.base, R, -R @ b, R @ R_start @ R.T,
                         R @ (R_start @ (b - t_start) - b))


@dataclass(frozen=True)
class Pose:
    """A rigid motion X_to = R X_from + t."""

    R: np.ndarray  # (3, 3)
    t: np.ndarray  # (3,)
    # (6, 6): of (t, w), the rotation as exp(w) R: about the axes of the frame the pose is given in
    covariance: np.ndarray = field(default_factory=lambda: np.zeros((6, 6)))


ORIGIN = Pose(np.eye(3), np.zeros(3))


@dataclass(frozen=True)
class Twist:
    """Velocities; linear and angular [unit/s, rad/s], covariance (6, 6) in this order."""

    linear: np.ndarray
    angular: np.ndarray
    covariance: np.ndarray = field(default_factory=lambda: np.zeros((6, 6)))


def pose_to_odom(world_from_cam: Pose, frames: RosFrames) -> Pose:
    """Return the pose of the base in odom of a pose of the camera in {W}."""
    B, A = frames.R_base_from_cam, frames.R_odom_from_world
    lever = -world_from_cam.R @ (B.T @ frames.t_base_from_cam)  # from camera to base, in {W}
    J = np.zeros((6, 6))
    J[:3, :3] = J[3:, 3:] = A
    J[:3, 3:] = -A @ skew(lever)
    return Pose(A @ world_from_cam.R @ B.T,
                A @ (world_from_cam.t + lever) + frames.t_odom_from_world,
                J @ world_from_cam.covariance @ J.T)


def pose_to_world(odom_from_base: Pose, frames: RosFrames) -> Pose:
    """Return the pose of the camera in {W} of a pose of the base in odom."""
    return pose_to_odom(odom_from_base, frames.inverse())


def twist_to_base(twist: Twist, R_world_from_cam: np.ndarray, frames: RosFrames) -> Twist:
    """Return the twist of the base in its own axes.

    ``twist`` is the camera's: linear in {W}, angular in the camera. The pose's own error is
    left out of the covariance.
    """
    J = _twist_jacobian(R_world_from_cam, frames)
    both = J @ np.r_[twist.linear, twist.angular]
    return Twist(both[:3], both[3:], J @ twist.covariance @ J.T)


def twist_to_world(twist: Twist, R_world_from_cam: np.ndarray, frames: RosFrames) -> Twist:
    """Return the camera's twist (linear in {W}, angular in the camera) of the base's."""
    J = np.linalg.inv(_twist_jacobian(R_world_from_cam, frames))
    both = J @ np.r_[twist.linear, twist.angular]
    return Twist(both[:3], both[3:], J @ twist.covariance @ J.T)


def points_to_odom(X_world: np.ndarray, frames: RosFrames) -> np.ndarray:
    """Return points (..., 3) of {W} in odom."""
    return vectors_to_odom(X_world, frames) + frames.t_odom_from_world


def points_to_world(X_odom: np.ndarray, frames: RosFrames) -> np.ndarray:
    """Return points (..., 3) of odom in {W}."""
    return vectors_to_world(np.asarray(X_odom, float) - frames.t_odom_from_world, frames)


def vectors_to_odom(v_world: np.ndarray, frames: RosFrames) -> np.ndarray:
    """Return directions or velocities (..., 3) of {W} in odom."""
    return np.asarray(v_world, float) @ frames.R_odom_from_world.T


def vectors_to_world(v_odom: np.ndarray, frames: RosFrames) -> np.ndarray:
    """Return directions or velocities (..., 3) of odom in {W}."""
    return np.asarray(v_odom, float) @ frames.R_odom_from_world


def state_covariance_to_odom(covariance: np.ndarray, frames: RosFrames) -> np.ndarray:
    """Return the covariance (6, 6) in odom of (position, velocity) in {W}."""
    J = np.kron(np.eye(2), frames.R_odom_from_world)
    return J @ covariance @ J.T


def normal_depth_to_odom(normal: np.ndarray, depth: float, covariance: np.ndarray,
                         frames: RosFrames) -> tuple[np.ndarray, float, np.ndarray]:
    """Return normal (3,), depth and their covariance (4, 4) in odom of a plane of {W}."""
    R, t = frames.R_odom_from_world, frames.t_odom_from_world
    J = np.zeros((4, 4))
    J[:3, :3], J[3, :3], J[3, 3] = R, -t @ R, 1
    moved = J @ (*normal, depth)
    covariance = J @ covariance @ J.T
    # Along the normal there is none, which rounding would make less.
    covariance.flat[::5] = np.maximum(covariance.diagonal(), 0.0)
    return moved[:3], float(moved[3]), covariance


def plane_to_odom(plane: np.ndarray, frames: RosFrames) -> np.ndarray:
    """Return n/d (3,) in odom of a plane n/d of {W}."""
    turned = frames.R_odom_from_world @ plane
    return turned / (1 - turned @ frames.t_odom_from_world)


def plane_velocity_covariance_to_odom(plane: np.ndarray, covariance: np.ndarray,
                                      frames: RosFrames) -> np.ndarray:
    """Return the covariance (6, 6) in odom of (plane n/d, velocity) in {W}."""
    R, t = frames.R_odom_from_world, frames.t_odom_from_world
    scale = 1 - (R @ plane) @ t
    of_plane = R / scale + np.outer(R @ plane, t @ R) / scale**2
    J = np.block([[of_plane, np.zeros((3, 3))], [np.zeros((3, 3)), R]])
    return J @ covariance @ J.T


def _twist_jacobian(R_world_from_cam: np.ndarray, frames: RosFrames) -> np.ndarray:
    B = frames.R_base_from_cam
    t_cam_from_base = -B.T @ frames.t_base_from_cam
    return np.block([[B @ R_world_from_cam.T, -B @ skew(t_cam_from_base)],
                     [np.zeros((3, 3)), B]])
