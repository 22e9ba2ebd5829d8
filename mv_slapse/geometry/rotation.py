"""Rotations near the identity; everything else is scipy's ``Rotation``."""

from mv_slapse.kernels.binding import compiled
import numpy as np


def skew(v: np.ndarray) -> np.ndarray:
    """Return [v]x, with [v]x @ a == cross(v, a)."""
    x, y, z = v
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])


def cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return np.cross(a, b) over last axes of length 3, at a quarter of its cost."""
    out = np.empty(np.broadcast_shapes(a.shape, b.shape))
    for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        out[..., i] = a[..., j] * b[..., k] - a[..., k] * b[..., j]
    return out


def exp(w: np.ndarray) -> np.ndarray:
    """Return the rotation matrix of a rotation vector (3,) [rad]."""
    return compiled.rotation_exp(np.ascontiguousarray(w, float))


def log(R: np.ndarray) -> np.ndarray:
    """Return the rotation vector (3,) [rad] of a rotation matrix."""
    return compiled.rotation_log(np.ascontiguousarray(R, float))


def angle(R: np.ndarray) -> float:
    """Return the angle [rad] of a rotation matrix."""
    return float(np.linalg.norm(log(R)))


def tangent_basis(direction: np.ndarray) -> np.ndarray:
    """Return two unit vectors (3, 2) that are normal to a direction (3,) and to each other."""
    axis = np.eye(3)[np.argmin(np.abs(direction))]
    first = cross(direction, axis)
    first /= np.linalg.norm(first)
    second = cross(direction, first)
    return np.c_[first, second / np.linalg.norm(second)]
