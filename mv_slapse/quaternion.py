"""Unit quaternions x y z w as ROS has them; scipy's are the same, and take 0.3 s to import."""

import numpy as np


def from_matrix(R: np.ndarray) -> np.ndarray:
    """Return the quaternion (4,) of a rotation matrix, by its greatest part.

    Shepperd, "Quaternion from rotation matrix", J. Guidance and Control 1(3), 1978.
    """
    R, trace = np.asarray(R, float), float(np.trace(R))
    i = int(np.argmax([*np.diag(R), trace]))
    if i == 3:
        q = np.array([R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1], 1 + trace])
    else:
        j, k = (i + 1) % 3, (i + 2) % 3
        q = np.zeros(4)
        q[[i, j, k, 3]] = (1 - trace + 2 * R[i, i], R[j, i] + R[i, j], R[k, i] + R[i, k],
                           R[k, j] - R[j, k])
    return q / np.linalg.norm(q)


def to_matrix(q: np.ndarray) -> np.ndarray:
    """Return rotation matrices (..., 3, 3) of quaternions (..., 4) of any length."""
    q = np.asarray(q, float)
    x, y, z, w = np.moveaxis(q / np.linalg.norm(q, axis=-1, keepdims=True), -1, 0)
    return np.moveaxis(np.array([
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)]]), (0, 1), (-2, -1))
