"""The competitor of [MVO]: monocular SLAM by an EKF with 1-point RANSAC, Civera et al. 2010.

Constant velocity, points as inverse depths (6 numbers each), corners, and the two updates of
1-point RANSAC: a single match tells the whole state, those that then fit are taken in, and
matches that the better state explains are rescued. As published but for two things: corners are
tracked from picture to picture (Lucas-Kanade) and must end in the ellipse that the filter
predicts, where the authors search a warped patch of the first picture; and a rotation's error is
a vector, not four numbers of a quaternion, which is the same to first order. The first inverse
depths are the unit.
"""

from collections.abc import Iterable
from dataclasses import dataclass

import cv2
from mv_slapse.geometry import rotation
import numpy as np
from odometry import Pose

CAMERA = 12  # place, turn, velocity, angular velocity: errors in {W}, camera, {W}, camera


@dataclass(frozen=True)
class Tuning:
    """What the filter is told; unit: about the depth of the first points; time in pictures."""

    points: int = 80  # that are followed at once
    spacing: int = 24  # [px] between corners
    pixel: float = 1.0  # standard deviation of a match [px]
    gate: float = 9.21  # of a match, chi-square of two degrees of freedom: 99 %
    depth: float = 1.0  # inverse depth of the first points, and its standard deviation
    speed: float = 0.1  # standard deviation of the first velocity
    acceleration: float = 0.01
    turn: float = 0.02  # [rad] of the first angular velocity
    angular: float = 0.01  # [rad] its change
    confidence: float = 0.99  # that one of the matches tried was right


class OnePointEkf:
    """The filter; ``step`` takes the matches of one picture."""

    def __init__(self, K: np.ndarray, tuning: Tuning = Tuning()):
        """Start at the origin."""
        self.K, self.tuning = K, tuning
        self.R, self.r, self.v, self.w = np.eye(3), np.zeros(3), np.zeros(3), np.zeros(3)
        self.points = np.zeros((0, 6))  # anchor (3), azimuth, elevation, inverse depth
        self.P = np.diag(np.repeat([0.0, 0.0, tuning.speed**2, tuning.turn**2], 3))
        self._rng = np.random.default_rng(0)

    def predict(self):
        """Move on by one picture with constant velocity."""
        F = np.eye(len(self.P))
        F[:3, 6:9] = np.eye(3)
        F[3:6, 3:6] = rotation.exp(-self.w)
        F[3:6, 9:12] = np.eye(3)
        noise = np.repeat([self.tuning.acceleration**2, self.tuning.angular**2], 3)
        G = np.zeros((len(self.P), 6))
        G[:CAMERA] = np.vstack([np.eye(6), np.eye(6)])
        self.r, self.R = self.r + self.v, self.R @ rotation.exp(self.w)
        self.P = F @ self.P @ F.T + (G * noise) @ G.T

    def project(self, state=None):
        """Return where the points are in the picture (N, 2), nan behind the camera, and Jacobians.

        Those are by camera place and turn (N, 2, 6) and by the point (N, 2, 6).
        """
        R, r, points = state or (self.R, self.r, self.points)
        m, by_angles = bearings(points)
        from_camera = points[:, :3] - r
        h = (points[:, 5:] * from_camera + m) @ R
        z = np.where(h[:, 2] > 1e-6, h[:, 2], np.nan)
        x = h[:, :2] / z[:, None] * np.diag(self.K)[:2] + self.K[:2, 2]
        by_h = np.zeros((len(points), 2, 3))
        by_h[:, 0, 0], by_h[:, 1, 1] = self.K[0, 0] / z, self.K[1, 1] / z
        by_h[:, :, 2] = -(x - self.K[:2, 2]) / z[:, None]
        by_w = by_h @ R.T  # by a vector in {W}
        skew = np.zeros((len(points), 3, 3))  # d h / d turn = [h]x
        skew[:, 0, 1], skew[:, 0, 2], skew[:, 1, 2] = -h[:, 2], h[:, 1], -h[:, 0]
        skew -= np.swapaxes(skew, 1, 2)
        depth = points[:, 5, None, None]
        camera = np.concatenate([-depth * by_w, by_h @ skew], 2)
        point = np.concatenate([depth * by_w, by_w @ by_angles, by_w @ from_camera[:, :, None]], 2)
        return x, camera, point

    def step(self, seen: np.ndarray) -> np.ndarray:
        """Update with the places (N, 2) of all points, nan: not seen; return which matches held.

        After `predict`. Algorithm 1 of the paper: low innovations by one point, then the rescue.
        """
        x, camera, point = self.project()
        compatible = self._compatible(seen, x, camera, point, np.isfinite(seen[:, 0]))
        low = self._one_point(seen, x, camera, point, np.flatnonzero(compatible))
        self._update(seen, x, camera, point, low)
        x, camera, point = self.project()
        high = self._compatible(seen, x, camera, point, compatible & ~low)
        self._update(seen, x, camera, point, high)
        return low | high

    def _by_state(self, camera, point, rows):
        """Return the derivative (2 M, S) of some points' places by the state."""
        H = np.zeros((len(rows), 2, len(self.P)))
        H[:, :, :6] = camera[rows]
        at = CAMERA + 6 * rows[:, None] + np.arange(6)
        H[np.arange(len(rows))[:, None, None], np.arange(2)[:, None], at[:, None]] = point[rows]
        return H.reshape(-1, len(self.P))

    def _compatible(self, seen, x, camera, point, among):
        """Return which matches (N,) bool lie in the ellipse of their prediction."""
        among = among & np.isfinite(x[:, 0])
        rows = np.flatnonzero(among)
        H = self._by_state(camera, point, rows)
        PH = (self.P @ H.T).reshape(len(self.P), -1, 2)
        S = np.einsum('naj,jnb->nab', H.reshape(-1, 2, len(self.P)), PH)
        S += self.tuning.pixel**2 * np.eye(2)
        off = seen[rows] - x[rows]
        square = np.einsum('na,na->n', off, np.linalg.solve(S, off[:, :, None])[:, :, 0])
        among[rows] = square < self.tuning.gate
        return among

    def _one_point(self, seen, x, camera, point, rows):
        """Return which matches (N,) bool agree with the state that one of them tells."""
        best, tried, needed = np.zeros(len(seen), bool), 0, len(rows)
        bound = 2 * self.tuning.pixel
        order = self._rng.permutation(rows)
        while tried < min(needed, len(rows)):
            one = order[tried:tried + 1]
            H = self._by_state(camera, point, one)
            PH = self.P @ H.T
            S = H @ PH + self.tuning.pixel**2 * np.eye(2)
            state = self._moved(PH @ np.linalg.solve(S, (seen[one] - x[one])[0]))
            off = np.linalg.norm(self.project(state[:3])[0][rows] - seen[rows], axis=1)
            fits = np.zeros(len(seen), bool)
            fits[rows] = off < bound  # never where it is nan
            tried += 1
            if fits.sum() > best.sum():
                best = fits
                wrong = max(1 - fits.sum() / len(rows), 1e-9)
                needed = int(np.ceil(np.log(1 - self.tuning.confidence) / np.log(wrong)))
        return best

    def _moved(self, step):
        """Return rotation, place, points, velocity and angular velocity after a correction."""
        return (self.R @ rotation.exp(step[3:6]), self.r + step[:3],
                self.points + step[CAMERA:].reshape(-1, 6), self.v + step[6:9],
                self.w + step[9:12])

    def _update(self, seen, x, camera, point, which):
        rows = np.flatnonzero(which)
        if not len(rows):
            return
        H = self._by_state(camera, point, rows)
        PH = self.P @ H.T
        S = H @ PH + self.tuning.pixel**2 * np.eye(len(H))
        gain = np.linalg.solve(S, PH.T).T
        step = gain @ (seen[rows] - x[rows]).ravel()
        self.R, self.r, self.points, self.v, self.w = self._moved(step)
        self.P = self.P - gain @ PH.T
        self.P = 0.5 * (self.P + self.P.T)

    def delete(self, gone: np.ndarray):
        """Delete points (N,) bool."""
        rows = np.r_[np.ones(CAMERA, bool), np.repeat(~gone, 6)]
        self.points, self.P = self.points[~gone], self.P[np.ix_(rows, rows)]

    def add(self, x: np.ndarray):
        """Add points (N, 2) that are new, with the usual inverse depth of the others."""
        known = self.points[self.points[:, 5] > 0, 5]
        depth = float(np.median(known)) if len(known) > 9 else self.tuning.depth
        rays = np.c_[(x - self.K[:2, 2]) / np.diag(self.K)[:2], np.ones(len(x))]
        for ray in rays:
            self._add(ray, depth)

    def _add(self, ray, depth):
        h = self.R @ ray
        flat = np.hypot(h[0], h[2])
        angles = np.arctan2(h[0], h[2]), np.arctan2(-h[1], flat)
        by_h = np.array([[h[2] / flat**2, 0, -h[0] / flat**2],
                         [h[0] * h[1] / flat, -flat, h[2] * h[1] / flat] / (h @ h)])
        J = np.zeros((6, len(self.P)))
        J[:3, :3] = np.eye(3)
        J[3:5, 3:6] = by_h @ self.R @ -rotation.skew(ray)
        by_pixel = by_h @ self.R[:, :2] / np.diag(self.K)[:2]
        own = np.zeros((6, 6))
        own[3:5, 3:5] = self.tuning.pixel**2 * by_pixel @ by_pixel.T
        own[5, 5] = depth**2
        PJ = self.P @ J.T
        self.P = np.block([[self.P, PJ], [PJ.T, J @ PJ + own]])
        self.points = np.vstack([self.points, [*self.r, *angles, depth]])


def bearings(points: np.ndarray):
    """Return the directions (N, 3) of points in {W}, and their derivative (N, 3, 2) by angles."""
    (sa, se), (ca, ce) = np.sin(points[:, 3:5]).T, np.cos(points[:, 3:5]).T
    none = np.zeros(len(points))
    return (np.c_[ce * sa, -se, ce * ca],
            np.stack([np.c_[ce * ca, none, -ce * sa], np.c_[-se * sa, -ce, -se * ca]], 2))


def drive(images: Iterable[np.ndarray], K: np.ndarray, tuning: Tuning = Tuning()) -> list[Pose]:
    """Return the pose of each picture (H, W) uint8, without distortion, to a free scale."""
    ekf, poses, previous, x = OnePointEkf(K, tuning), [], None, np.zeros((0, 2), np.float32)
    for i, image in enumerate(images):
        if previous is not None:
            ekf.predict()
        if len(x):
            there, found, _ = cv2.calcOpticalFlowPyrLK(previous, image, x, None, winSize=(21, 21),
                                                       maxLevel=3)
            there[found.ravel() == 0] = np.nan
            held = ekf.step(there.astype(float))
            ekf.delete(~held)
            x = there[held]
        free = np.full(image.shape, 255, np.uint8)
        for corner in x:
            cv2.circle(free, tuple(int(c) for c in corner), tuning.spacing, 0, -1)
        missing = tuning.points - len(x)
        new = cv2.goodFeaturesToTrack(image, missing, 0.01, tuning.spacing, mask=free) \
            if missing > 0 else None
        if new is not None:
            ekf.add(new[:, 0].astype(float))
            x = np.vstack([x, new[:, 0]])
        poses.append(Pose(i, ekf.R, ekf.r))
        previous = image
    return poses
