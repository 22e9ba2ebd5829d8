"""Two visual odometries as a user would write them with OpenCV, to compare with.

One tracks corners (Lucas-Kanade), one matches ORB features; both take the essential matrix of two
pictures with RANSAC. One camera does not know how far it went: the length of each step is taken
from the truth, which neither has to estimate then. No map, no bundle adjustment, no loop closure.
"""

from collections.abc import Callable, Iterable
from typing import NamedTuple

import cv2
import numpy as np

CORNERS = 1500
FEATURES = 2000
FLOW = 3.0  # [px] median motion between the pictures of a step; from less no motion can be told
FEWEST = 30  # matches of a step
RATIO = 0.8  # of the best match's distance to the second best, Lowe 2004
PYRAMID = {'winSize': (21, 21), 'maxLevel': 3}

Length = Callable[[int, int], float]


class Pose(NamedTuple):
    """Where the camera is in picture i: X_world = R X_cam + t."""

    index: int
    R: np.ndarray
    t: np.ndarray


def corner_tracking(images: Iterable[np.ndarray], K: np.ndarray, length: Length) -> list[Pose]:
    """Track corners from picture to picture, and step where they have moved far enough.

    Parameters
    ----------
    images : iterable of (H, W) uint8
        Without distortion.
    K : (3, 3) array
    length : function of two numbers of pictures
        How far the camera went between them.
    """
    walk, previous, start, now = _Walk(K, length), None, None, None
    for i, image in enumerate(images):
        if now is not None and len(now):
            now, found, _ = cv2.calcOpticalFlowPyrLK(previous, image, now, None, **PYRAMID)
            kept = found.ravel() == 1
            start, now = start[kept], now[kept]
            walk.step(i, start[:, 0], now[:, 0])
        if walk.poses[-1].index == i or now is None or len(now) < FEWEST:
            start = now = cv2.goodFeaturesToTrack(image, CORNERS, 0.01, 7)
        previous = image
    return walk.poses


def orb_matching(images: Iterable[np.ndarray], K: np.ndarray, length: Length) -> list[Pose]:
    """Match ORB features with those of the last step, and step where they moved far enough."""
    orb, matcher = cv2.ORB_create(FEATURES), cv2.BFMatcher(cv2.NORM_HAMMING)
    walk, last = _Walk(K, length), None
    for i, image in enumerate(images):
        points, descriptors = orb.detectAndCompute(image, None)
        if last is not None and descriptors is not None:
            pairs = [pair for pair in matcher.knnMatch(last[1], descriptors, k=2)
                     if len(pair) == 2 and pair[0].distance < RATIO * pair[1].distance]
            walk.step(i, np.array([last[0][best.queryIdx].pt for best, _ in pairs]),
                      np.array([points[best.trainIdx].pt for best, _ in pairs]))
        if walk.poses[-1].index == i and descriptors is not None:
            last = points, descriptors
    return walk.poses


class _Walk:
    """Poses, step by step."""

    def __init__(self, K: np.ndarray, length: Length):
        cv2.setRNGSeed(0)
        self._K, self._length = K, length
        self.poses = [Pose(0, np.eye(3), np.zeros(3))]

    def step(self, i: int, x_prev: np.ndarray, x_cur: np.ndarray):
        """Add the pose of picture i, given its matches (N, 2) with the last; none: too near."""
        if len(x_cur) < FEWEST or np.median(np.linalg.norm(x_cur - x_prev, axis=1)) < FLOW:
            return
        E, inlier = cv2.findEssentialMat(x_prev, x_cur, self._K, cv2.RANSAC, 0.999, 1.0)
        if E is None or E.shape != (3, 3):
            return
        _, R, t, _ = cv2.recoverPose(E, x_prev, x_cur, self._K, mask=inlier)
        last = self.poses[-1]
        R_world = last.R @ R.T
        way = self._length(last.index, i)
        self.poses.append(Pose(i, R_world, last.t - way * (R_world @ t).ravel()))
