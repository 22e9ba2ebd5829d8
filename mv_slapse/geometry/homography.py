"""Homographies that planes induce, x_prev ~ H x_cur, (9) of [MVO]."""

import numpy as np


def induced_by_plane(K, R_cur_from_prev, t_cur_from_prev, plane_cur) -> np.ndarray:
    """Homography of a stationary plane, (9) of [MVO]; with t - t_d for t a moving one's, (11).

    Parameters
    ----------
    K : (3, 3) array
        Intrinsics [px].
    R_cur_from_prev, t_cur_from_prev : (3, 3), (3,) arrays
        Motion, X_cur = R X_prev + t.
    plane_cur : (3,) array
        Plane n / d in the current camera.

    Returns
    -------
    H : (3, 3) array
        Takes homogeneous pixels of the current key frame to the previous one, up to scale.
    """
    motion = np.eye(3) + np.outer(t_cur_from_prev, plane_cur)
    return K @ R_cur_from_prev.T @ motion @ np.linalg.inv(K)


def transfer(H: np.ndarray, x: np.ndarray) -> np.ndarray:
    """Take pixels (N, 2) through a homography."""
    mapped = x @ H[:, :2].T + H[:, 2]
    return mapped[:, :2] / mapped[:, 2:]
