"""Planes in inhomogeneous form, ``n / d``.

A plane is a vector ``plane`` of shape (3,) [1/m]: a point ``X`` is on it when ``plane @ X == -1``,
that is ``n @ X + d == 0`` for its normal ``n`` and depth ``d``. Points and plane share one frame.
On a ray ``x`` (last coordinate 1) its inverse depth is ``-plane @ x``.
"""

import numpy as np

WELL_SEEN = 5  # key frames that show a plane which is worth keeping
MOST_KEPT = 30  # planes that are kept beside those in view: time grows with them


def transform(plane_a: np.ndarray, R_b_from_a: np.ndarray, t_b_from_a: np.ndarray) -> np.ndarray:
    """Express a plane of frame a in frame b, where ``X_b = R_b_from_a @ X_a + t_b_from_a``."""
    rotated = R_b_from_a @ plane_a
    return rotated / (1 - rotated @ t_b_from_a)


def scaled_about(place: np.ndarray, factor: float, normal: np.ndarray, depth: float,
                 covariance: np.ndarray) -> tuple[float, np.ndarray]:
    """Return depth and covariance (4, 4) of (normal, depth) after a change of the unit of length.

    All lengths are multiplied by a factor, and a place (3,) stays where it is.
    """
    J = np.eye(4)
    J[3] = *((factor - 1) * place), factor
    return factor * depth + (factor - 1) * float(normal @ place), J @ covariance @ J.T
