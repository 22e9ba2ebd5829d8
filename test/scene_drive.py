"""A camera that drives through a canyon: its extractions, and the filter's errors on them."""

from canyon import CANYON, K, turn_between, views
from mv_slapse.config import SceneSettings
from mv_slapse.geometry import plane as plane_geometry
from mv_slapse.geometry import rotation
from mv_slapse.records import (
    CameraMotion,
    Extraction,
    Label,
    MotionStatus,
    PlaneObservation,
    SegmentKind,
)
from mv_slapse.scene import state as scene_state
from mv_slapse.scene.filter import SceneFilter
from mv_slapse.scene.state import Pose
import numpy as np
from scipy.spatial.transform import Rotation

DT, SPEED, YAW_RATE, HEIGHT = 0.1, 8.0, 0.05, 1.6
METRIC = SceneSettings(camera_height=HEIGHT)
GROUND = 0


class Canyon:
    """A street of metres, its true poses and what each key frame pair would show of it."""

    def __init__(self, rng=None, sigma=0.0, yaw_rate=YAW_RATE, way=lambda time: SPEED * time):
        self.rng, self.sigma, self.yaw_rate, self.way = rng, sigma, yaw_rate, way

    def pose(self, k):
        """Return R_world_from_cam, t_world_from_cam at key frame k, on an arc."""
        radius = SPEED / self.yaw_rate
        turn = self.way(k * DT) / radius
        return Rotation.from_euler('y', turn).as_matrix(), radius * np.array(
            [1 - np.cos(turn), 0, np.sin(turn)])

    def motion(self, k):
        """Return R_cur_from_prev, t_cur_from_prev of the pair (k - 1, k)."""
        (R0, t0), (R1, t1) = self.pose(k - 1), self.pose(k)
        return R1.T @ R0, R1.T @ (t0 - t1)

    def planes(self, k):
        """Return the planes n / d in the camera of key frame k [1/m]."""
        R, t = self.pose(k)
        return np.array([plane_geometry.transform(p, R.T, -R.T @ t) for p in CANYON])

    def extraction(self, k, ratio=True):
        """Return what the pair (k - 1, k) shows, in units of its baseline."""
        R, t = self.motion(k)
        baseline = np.linalg.norm(t)
        planes = self.planes(k) * baseline
        drawn = views(R, t / baseline, self.rng, self.sigma, planes=planes)
        seen = [PlaneObservation(i, Label.STATIONARY, plane, 1e-4 * plane @ plane * np.eye(3),
                                 is_ground=i == GROUND, n_macroblocks=int(np.sum(
                                     drawn.surface == i)))
                for i, plane in enumerate(planes)]
        n = len(drawn.x_cur)
        before = np.linalg.norm(self.motion(k - 1)[1])
        known = {}
        if ratio and k > 1 and before > 0:
            known = {'baseline_ratio': np.log(baseline / before), 'baseline_ratio_sigma': 0.002}
        label = np.where(drawn.surface < 0, Label.INFINITY, Label.STATIONARY)
        return Extraction(
            stamp(k), stamp(k - 1), 640, 480, SegmentKind.PP, K,
            CameraMotion(MotionStatus.MOVING, R, t / baseline, forward=True), tuple(seen), '',
            drawn.x_cur.astype(np.float32), drawn.x_prev.astype(np.float32),
            np.full(n, max(self.sigma, 0.05), np.float32), np.full((n, 2), 16, np.uint8),
            label.astype(np.int8), drawn.surface.astype(np.int32), **known)

    def blank(self, k, status=MotionStatus.UNKNOWN, reason='the packet was lost'):
        """Return an extraction of the pair (k - 1, k) that shows no motion."""
        return Extraction(stamp(k), stamp(k - 1), 640, 480, SegmentKind.BROKEN, K,
                          CameraMotion(status), reason=reason)


def stamp(k):
    return round(k * DT * 1e9)


def driven(canyon, n, settings=METRIC, filter_=None, first=1, **how):
    """Return the estimates of key frames first to n."""
    filter_ = filter_ or SceneFilter(settings)
    return [filter_.step(canyon.extraction(k, **how))[0] for k in range(first, n + 1)]


def position_errors(canyon, estimates, first=1, scale=1.0):
    return [np.linalg.norm(scale * e.t_world_from_cam - canyon.pose(first + i)[1])
            for i, e in enumerate(estimates)]


def turn_errors(canyon, estimates, first=1):
    return [turn_between(e.R_world_from_cam, canyon.pose(first + i)[0])
            for i, e in enumerate(estimates)]


def assert_is_covariance(P):
    np.testing.assert_allclose(P, P.T, atol=1e-12)
    assert np.linalg.eigvalsh(P).min() > -1e-9


def between_two_poses(rng):
    """Return a state of the scene filter with any two poses, and no plane yet."""
    state = scene_state.start(np.array([0, -1.0, 0]), 1.0, 0.1, 0.05)
    state.previous = Pose(rotation.exp(rng.normal(0, 0.5, 3)), rng.normal(0, 3, 3))
    state.current = Pose(state.previous.R @ rotation.exp(rng.normal(0, 0.05, 3)),
                         state.previous.t + rng.normal(0, 1, 3))
    return state
