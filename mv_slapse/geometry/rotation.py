"""Rotations near the identity; everything else is scipy's ``Rotation``."""

import numpy as np
from scipy.spatial.transform import Rotation


def skew(v: np.ndarray) -> np.ndarray:
    """Return [v]x, with [v]x @ a == cross(v, a)."""
    x, y, z = v
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])


def exp(w: np.ndarray) -> np.ndarray:
    """Return the rotation matrix of a rotation vector (3,) [rad]."""
    return Rotation.from_rotvec(w).as_matrix()


def log(R: np.ndarray) -> np.ndarray:
    """Return the rotation vector (3,) [rad] of a rotation matrix."""
    return Rotation.from_matrix(R).as_rotvec()


def angle(R: np.ndarray) -> float:
    """Return the angle [rad] of a rotation matrix."""
    return float(np.linalg.norm(log(R)))


def tangent_basis(direction: np.ndarray) -> np.ndarray:
    """Return two unit vectors (3, 2) that are normal to a direction (3,) and to each other."""
    axis = np.eye(3)[np.argmin(np.abs(direction))]
    first = np.cross(direction, axis)
    first /= np.linalg.norm(first)
    second = np.cross(direction, first)
    return np.c_[first, second / np.linalg.norm(second)]
