"""Outlines of planes and obstacles as triangles, points and footprints; free of ROS."""

import cv2
import numpy as np


def fan(outline: np.ndarray) -> np.ndarray:
    """Return the triangles (M - 2, 3, 3) of a convex outline (M, 3)."""
    n = max(len(outline) - 2, 0)
    corners = np.array([[0, i + 1, i + 2] for i in range(n)], int).reshape(n, 3)
    return np.asarray(outline, float).reshape(-1, 3)[corners]


def sample(outline: np.ndarray, spacing: float, most: int = 4000) -> np.ndarray:
    """Return points (N, 3) on a convex outline (M, 3), at most ``spacing`` [m] apart.

    The spacing grows where more than ``most`` points would be needed.
    """
    triangles = fan(outline)
    if not len(triangles):
        return np.asarray(outline, float).reshape(-1, 3)
    per_triangle = max(most // len(triangles), 3)
    return np.concatenate([_sample_triangle(t, spacing, per_triangle) for t in triangles])


def footprint(outline: np.ndarray, depth: float) -> np.ndarray:
    """Return the corners (N, 2) of what an outline (M, 3) covers on the ground, z being up.

    A surface seen edge-on from above covers nothing: it is given an extent of ``depth`` [m].
    """
    points = np.ascontiguousarray(np.asarray(outline, float)[:, :2], np.float32)
    centre, size, angle = cv2.minAreaRect(points)
    if min(size) >= depth:
        return cv2.convexHull(points)[:, 0].astype(float)
    size = tuple(max(side, depth) for side in size)
    return cv2.boxPoints((centre, size, angle)).astype(float)


def _sample_triangle(triangle: np.ndarray, spacing: float, most: int) -> np.ndarray:
    longest = np.linalg.norm(triangle - np.roll(triangle, 1, axis=0), axis=1).max()
    steps = int(np.ceil(longest / spacing))
    steps = max(min(steps, int(np.sqrt(2 * most)) - 2), 1)
    i, j = np.triu_indices(steps + 1)
    weights = np.c_[i, j - i, steps - j] / steps
    return weights @ triangle
