"""Drawn traffic with known answers: a camera on a road, flat faces that drive, blocks on them."""

from dataclasses import dataclass, field, replace

from formulas import fit_moving_plane
from mv_slapse.geometry.blocks import COVERED
from mv_slapse.records import (
    CameraMotion,
    Extraction,
    Label,
    MapPlane,
    MotionStatus,
    ObstacleState,
    PlaneObservation,
    ScaleStatus,
    SceneEstimate,
    SegmentKind,
    TrackingStatus,
)
import numpy as np
from scipy.spatial.transform import Rotation

K = np.array([[600.0, 0, 320], [0, 600, 240], [0, 0, 1]])
WIDTH, HEIGHT, CAMERA_HEIGHT, DT = 640, 480, 1.65, 0.1
GRID = np.stack(np.meshgrid(np.arange(7.5, WIDTH, 16), np.arange(7.5, HEIGHT, 16)), -1).reshape(
    -1, 2)


@dataclass(frozen=True)
class Mover:
    """An upright rectangle on the road, its lower middle at start [m], driving at velocity(t)."""

    id: int
    start: tuple
    velocity: object
    size: tuple = (1.8, 1.5)
    yaw: float = 0.0

    def speed(self, time):
        v = self.velocity(time) if callable(self.velocity) else self.velocity
        return np.array([v[0], 0.0, v[1]])

    def base(self, time):
        steps = max(int(round(time / 0.01)), 0) if callable(self.velocity) else 0
        path = sum((self.speed(0.01 * (i + 0.5)) for i in range(steps)), np.zeros(3)) * 0.01
        if not callable(self.velocity):
            path = time * self.speed(time)
        return np.array([self.start[0], CAMERA_HEIGHT, self.start[1]]) + path

    def centre(self, time):
        return self.base(time) - [0, 0.5 * self.size[1], 0]

    def plane(self, time):
        normal = np.array([np.sin(self.yaw), 0, -np.cos(self.yaw)])
        return normal, -normal @ self.base(time)


@dataclass(frozen=True)
class Drive:
    """A camera that drives at speed(t) ahead and turns at omega, among movers."""

    movers: tuple
    speed: float = 10.0
    omega: float = 0.0
    sigma: float = 0.3
    scale_sigma: float = 0.02
    hidden: dict = field(default_factory=dict)
    label: Label = Label.MOVING
    ground_known = True

    def pose(self, time):
        """Return R_world_from_cam and t_world_from_cam; {W} is the camera at time 0."""
        R = Rotation.from_euler('y', self.omega * time).as_matrix()
        if abs(self.omega) < 1e-9:
            return R, np.array([0, 0, self.speed * time])
        radius, turn = self.speed / self.omega, self.omega * time
        return R, radius * np.array([1 - np.cos(turn), 0, np.sin(turn)])

    def motion(self, before, now):
        R0, t0 = self.pose(before)
        R1, t1 = self.pose(now)
        return R1.T @ R0, R1.T @ (t0 - t1)

    def blocks(self, mover, before, now, covered=COVERED):
        """Return centres (N, 2) of the blocks on a mover, exact matches (N, 2) and Z (N,).

        A block has the mover's vector from a share ``covered`` on, not only where half is.
        """
        R, t = self.pose(now)
        n, d = mover.plane(now)
        rays = np.c_[(GRID - K[:2, 2]) / np.diag(K)[:2], np.ones(len(GRID))] @ R.T
        depth = -(d + n @ t) / (rays @ n)
        X = t + depth[:, None] * rays
        along = np.array([np.cos(mover.yaw), 0, np.sin(mover.yaw)])
        at = X - mover.centre(now)
        slack = 16 * (0.5 - covered) * depth / K[0, 0]
        on = ((depth > 1) & (np.abs(at @ along) < 0.5 * mover.size[0] + slack)
              & (np.abs(at[:, 1]) < 0.5 * mover.size[1] + slack))
        R0, t0 = self.pose(before)
        back = X[on] - (mover.centre(now) - mover.centre(before))
        x = (back - t0) @ R0 @ K.T
        return GRID[on], x[:, :2] / x[:, 2:], depth[on]

    def scene(self, before, now, rng=None):
        """Return what the scene filter would say: exact pose, baseline with an error."""
        R, t = self.pose(now)
        error = 1 + (self.scale_sigma * rng.normal() if rng is not None else 0)
        velocity = (t - self.pose(before)[1]) / (now - before)
        ground = MapPlane(0, np.array([0.0, -1, 0]), CAMERA_HEIGHT, 1e-6 * np.eye(4),
                          np.zeros((0, 3)), 0, nanoseconds(now), 1, 100, True)
        twist = np.diag([(self.scale_sigma * max(self.speed, 0.1))**2] * 3 + [1e-8] * 3)
        return SceneEstimate(
            nanoseconds(now), TrackingStatus.OK, '', R, t, 1e-6 * np.eye(6), velocity,
            np.zeros(3), twist, ScaleStatus.METRIC, 'camera height', (ground,),
            error * np.linalg.norm(self.motion(before, now)[1]))

    def extraction(self, before, now, rng):
        """Return an Extraction whose moving planes are fitted to noisy vectors of each mover."""
        R, t = self.motion(before, now)
        baseline = np.linalg.norm(t)
        unit = baseline if baseline > 1e-9 else 1.0
        ground = np.array([0, -1, 0]) / CAMERA_HEIGHT * unit if self.ground_known else None
        planes, columns = [], []
        for mover in self.movers:
            if mover.id in self.hidden and self.hidden[mover.id](now):
                continue
            x, x_prev, _ = self.blocks(mover, before, now)
            sigma = np.full(len(x), max(self.sigma, 1e-3))
            x_prev = x_prev + self.sigma * rng.normal(size=x_prev.shape)
            block = np.full(x.shape, 16)
            fit = fit_moving_plane(x, x_prev, sigma, block, K, R, t / unit, ground)
            columns.append((x, x_prev, sigma, block, np.full(len(x), mover.id)))
            if fit is not None:
                planes.append(PlaneObservation(mover.id, self.label, fit.plane, fit.covariance,
                                               fit.t_d, fit.product, fit.scale_prior, False,
                                               len(x)))
        merged = [np.concatenate(c) for c in zip(*columns, strict=True)] if columns else [
            np.zeros((0, 2)), np.zeros((0, 2)), np.zeros(0), np.zeros((0, 2)), np.zeros(0)]
        status = MotionStatus.MOVING if baseline > 1e-9 else MotionStatus.STANDSTILL
        covariance = np.diag([1e-8] * 3 + [1e-6] * 3)
        return Extraction(
            nanoseconds(now), nanoseconds(before), WIDTH, HEIGHT, SegmentKind.PP, K,
            CameraMotion(status, R, t / unit, covariance), tuple(planes), '',
            merged[0].astype(np.float32), merged[1].astype(np.float32),
            merged[2].astype(np.float32), merged[3].astype(np.uint8),
            np.full(len(merged[0]), self.label, np.int8), merged[4].astype(np.int32))


class Groundless(Drive):
    """A drive whose map holds no ground plane."""

    ground_known = False

    def scene(self, before, now, rng=None):
        return replace(super().scene(before, now, rng), planes=())


def nanoseconds(time):
    return int(round(time * 1e9))


def usable(obstacles):
    """Return the obstacles that a planner may use."""
    return [o for o in obstacles if o.state is not ObstacleState.TENTATIVE]


def behind_a_car_of_the_same_speed(stamp, way=1):
    """Return a pair of a road, a car ahead at rest in the picture, and far trees above both.

    The camera drives ahead, or back where ``way`` is -1.
    """
    K, t = np.array([[700.0, 0, 320], [0, 700, 180], [0, 0, 1]]), -way * np.eye(3)[2]
    ground = np.array([0, -1 / 1.65, 0])
    x = np.stack(np.meshgrid(np.arange(7.5, 640, 16), np.arange(7.5, 360, 16)), -1).reshape(-1, 2)
    car = (np.abs(x[:, 0] - 320) < 60) & (x[:, 1] > 180) & (x[:, 1] < 290)
    road, trees = ~car & (x[:, 1] > 190), ~car & (x[:, 1] < 180) & (x[:, 1] > 60)
    rays = np.c_[(x - (320, 180)) / 700, np.ones(len(x))]
    X = rays / np.maximum(-rays @ ground, 1e-3)[:, None]
    x_prev = np.where(road[:, None], (X - t)[:, :2] / (X - t)[:, 2:] * 700 + (320, 180), x)
    kept = car | road | trees
    n = kept.sum()
    return Extraction(
        stamp, stamp - 1, 640, 360, SegmentKind.PP, K,
        CameraMotion(MotionStatus.MOVING, np.eye(3), t), (), '', x[kept].astype(np.float32),
        x_prev[kept].astype(np.float32), np.full(n, 0.3, np.float32),
        np.full((n, 2), 16, np.uint8), np.where(trees[kept], 2, 0).astype(np.int8),
        np.full(n, -1, np.int32)), car[kept], trees[kept], ground
