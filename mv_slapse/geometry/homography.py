"""Homographies that planes induce, x_prev ~ H x_cur, (9) of [MVO]."""

from mv_slapse.geometry.rotation import cross
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


def plane_transfer(rays_cur, K, R_cur_from_prev, t_cur_from_prev, plane_cur) -> np.ndarray:
    """Predict x_prev (N, 2) [px] of blocks on a plane, the observation (19) of [SLAPSE]."""
    depthless = rays_cur + np.outer(rays_cur @ plane_cur, t_cur_from_prev)
    q = depthless @ R_cur_from_prev
    return q[:, :2] / q[:, 2:] * (K[0, 0], K[1, 1]) + K[:2, 2]


def plane_transfer_jacobian(rays_cur, K, R_cur_from_prev, t_cur_from_prev, plane_cur):
    """Return plane_transfer (N, 2) [px] and its derivative (N, 2, 9) by (w, t, plane).

    The rotation is perturbed as exp(w) R. Derivation: q = R^T (x + t (plane . x)), so
    dq = R^T ([p]x dw + (plane . x) dt + t x^T dplane) with p = x + t (plane . x).
    """
    along = rays_cur @ plane_cur
    p = rays_cur + np.outer(along, t_cur_from_prev)
    q = p @ R_cur_from_prev
    focal = np.array([K[0, 0], K[1, 1]])
    pixels = q[:, :2] / q[:, 2:] * focal + K[:2, 2]
    # d pixel / d q, rotated back: rows a_u, a_v (N, 3) such that d pixel = a . (R dq).
    by_q = np.zeros((len(q), 2, 3))
    by_q[:, 0, 0], by_q[:, 1, 1] = focal[0] / q[:, 2], focal[1] / q[:, 2]
    by_q[:, :, 2] = -focal * q[:, :2] / q[:, 2:]**2
    a = by_q @ R_cur_from_prev.T
    jacobian = np.empty((len(q), 2, 9))
    jacobian[:, :, :3] = cross(a, p[:, None])
    jacobian[:, :, 3:6] = a * along[:, None, None]
    jacobian[:, :, 6:] = (a @ t_cur_from_prev)[:, :, None] * rays_cur[:, None]
    return pixels, jacobian
