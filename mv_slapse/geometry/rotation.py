"""Rotations near the identity, and lengths; everything else is scipy's ``Rotation``."""

import math

from mv_slapse.kernels.binding import compiled
import numpy as np


def norm(vector: np.ndarray) -> float:
    """Return the length of a vector (N,): numpy's, bit by bit, in a third of its time."""
    return math.sqrt(vector.dot(vector))


def skew(v: np.ndarray) -> np.ndarray:
    """Return [v]x, with [v]x @ a == cross(v, a)."""
    x, y, z = v
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])


def exp(w: np.ndarray) -> np.ndarray:
    """Return the rotation matrix of a rotation vector (3,) [rad]."""
    return compiled.rotation_exp(np.ascontiguousarray(w, float))


def log(R: np.ndarray) -> np.ndarray:
    """Return the rotation vector (3,) [rad] of a rotation matrix."""
    return compiled.rotation_log(np.ascontiguousarray(R, float))


def angle(R: np.ndarray) -> float:
    """Return the angle [rad] of a rotation matrix."""
    return norm(log(R))
