"""What the obstacle filters know of the camera in one key frame, in map units."""

from dataclasses import dataclass
from functools import cached_property

from mv_slapse.changed import replace
from mv_slapse.config import SceneSettings, USUAL_HEIGHT
from mv_slapse.geometry.rotation import norm
from mv_slapse.records import Extraction, MotionStatus, ScaleStatus, SceneEstimate
import numpy as np

SPAN = 1.0  # [s] whose baselines tell the depth of an obstacle
UNSCALED_SPEED = 0.1  # a unit, 1 m/s or m/s^2, as a share of the camera's speed, without a scale
OUT_OF_SIGHT = 0.2  # [s] a pair or two without ground; up to then the map knows better
LEAST_SPEED_ERROR = 0.01  # share of the camera's speed, where anything claims to know better


@dataclass(frozen=True)
class View:
    """Camera of key frame k and its motion since key frame k-1."""

    K: np.ndarray  # (3, 3)
    R_world_from_cam: np.ndarray  # (3, 3)
    t_world_from_cam: np.ndarray  # (3,)
    R_cur_from_prev: np.ndarray  # (3, 3): motion of the pair
    t_cur_from_prev: np.ndarray  # (3,) [map unit]
    dt: float  # time of the pair [s]
    unit: float  # length of the pair's baseline [map unit]
    scene_velocity: np.ndarray  # (3,): of the still scene relative to the camera [map unit/s]
    scene_covariance: np.ndarray  # (3, 3): of it against that of obstacles [map unit/s]
    rotation_covariance: np.ndarray  # (3, 3): of R_cur_from_prev
    ground: np.ndarray | None  # (3,): ground plane n / d in the camera [1/map unit]
    ground_normal_covariance: np.ndarray  # (3, 3): of its unit normal in the camera
    size: np.ndarray  # (2,): width and height of the picture [px]
    is_metric: bool

    @cached_property
    def focal(self) -> np.ndarray:
        """Return fx, fy (2,) [px]."""
        return self.K.diagonal()[:2]

    @cached_property
    def speed_unit(self) -> float:
        """Return what to take for 1 m/s [map unit/s]: at free scale the camera drives 10 m/s."""
        speed = norm(self.scene_velocity)
        return 1.0 if self.is_metric or speed < 1e-6 else UNSCALED_SPEED * speed

    @property
    def metre(self) -> float:
        """Return what to take for 1 m [map unit], given a ground."""
        return 1.0 if self.is_metric else 1 / (USUAL_HEIGHT * norm(self.ground))

    def in_unit(self, unit: float, place: np.ndarray) -> 'View':
        """Return it in a unit that makes ``unit`` of its own; a place (3,) in {W} stays."""
        return replace(
            self, t_world_from_cam=place + unit * (self.t_world_from_cam - place),
            t_cur_from_prev=unit * self.t_cur_from_prev, unit=unit * self.unit,
            scene_velocity=unit * self.scene_velocity,
            scene_covariance=unit**2 * self.scene_covariance,
            ground=None if self.ground is None else self.ground / unit)

    def plane_to_cam(self, plane_world: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return a plane of {W} in the camera, upper half of (16), and the derivative (3, 3)."""
        R = self.R_world_from_cam
        return plane_moved(plane_world, R.T, -R.T @ self.t_world_from_cam)

    def plane_to_world(self, plane_cam: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return a plane of the camera in {W} and the derivative (3, 3)."""
        return plane_moved(plane_cam, self.R_world_from_cam, self.t_world_from_cam)


def view_of(extraction: Extraction, scene: SceneEstimate, before: SceneEstimate | None,
            last: View | None = None) -> View:
    """Return the View of a key frame; ``before`` and ``last`` are of the key frame before.

    The pair's own motion counts, with the scene filter's baseline as its length. Where the pair
    tells nothing the motion comes from the poses. A baseline of 0 (standing camera) leaves the
    pair without a unit; its lengths are then read as map units.
    """
    dt = max(1e-9 * (extraction.stamp - extraction.previous_stamp), 1e-6)
    unit = scene.baseline if scene.baseline > 1e-9 else 1.0
    motion = extraction.motion
    R, t = motion.R_cur_from_prev, unit * motion.t_cur_from_prev
    if motion.status is MotionStatus.UNKNOWN and before is not None:
        R, t = relative_motion(before, scene)
    velocity, covariance = t / dt, np.zeros((3, 3))
    if norm(velocity) > 1e-9:  # else the camera stands
        error = _speed_error(extraction, velocity, scene, dt, last) * velocity
        covariance = (unit / dt)**2 * motion.covariance[3:, 3:] + np.outer(error, error)
    return View(extraction.K, scene.R_world_from_cam, scene.t_world_from_cam, R, t, dt, unit,
                velocity, covariance, motion.covariance[:3, :3], *_ground(scene, last),
                np.array([extraction.width, extraction.height], float),
                scene.scale_status is ScaleStatus.METRIC)


def relative_motion(before: SceneEstimate, now: SceneEstimate) -> tuple[np.ndarray, np.ndarray]:
    """Return R_cur_from_prev and t_cur_from_prev between two poses."""
    R_cam_from_world = now.R_world_from_cam.T
    return (R_cam_from_world @ before.R_world_from_cam,
            R_cam_from_world @ (before.t_world_from_cam - now.t_world_from_cam))


def plane_moved(plane: np.ndarray, R: np.ndarray,
                t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return a plane n / d in another frame, X_b = R X_a + t, and the derivative (3, 3)."""
    rotated = R @ plane
    scale = 1 - rotated @ t
    # A plane through the other frame's origin has no n / d there: keep it far from infinite.
    scale = np.copysign(max(abs(scale), 1e-6), scale)
    return rotated / scale, (R + np.outer(rotated / scale, t @ R)) / scale


def _speed_error(extraction, velocity, scene, dt, last):
    """Return by what share of its speed the scene's may be wrong against those of obstacles.

    Both hang on one scale, so that its error, as of a free one that drifts, is shared. How well
    the last baselines compare is not, nor by how much the speed has jumped; nothing errs by more
    than the scene filter says.
    """
    ahead = scene.R_world_from_cam @ velocity / (velocity @ velocity)
    of_filter = np.sqrt(max(ahead @ scene.twist_covariance[:3, :3] @ ahead, 0.0))
    if last is None or not extraction.baseline_ratio_sigma < 1:
        compared = 1.0
    else:
        jump = extraction.baseline_ratio - np.log(dt / last.dt)
        compared = np.hypot(jump, np.sqrt(SceneSettings.depth_dependence * SPAN / dt)
                            * extraction.baseline_ratio_sigma)
    return float(max(min(of_filter, compared, 1.0), LEAST_SPEED_ERROR))


def _ground(scene, last):
    """Return the map's ground plane n / d in the camera, or None, and its normal's covariance.

    A ground that is out of sight stays where the camera had it last: by a course that is wrong by
    a degree a path would run into it within seconds.
    """
    R = scene.R_world_from_cam
    for plane in scene.planes:
        depth = plane.depth + plane.normal @ scene.t_world_from_cam
        if plane.is_ground and abs(depth) > 1e-6:
            unseen = 1e-9 * (scene.stamp - plane.last_stamp) > OUT_OF_SIGHT
            if unseen and last is not None and last.ground is not None:
                return last.ground, last.ground_normal_covariance
            return R.T @ plane.normal / depth, R.T @ plane.covariance[:3, :3] @ R
    return None, np.zeros((3, 3))
