"""Two views of stationary points: epipolar error, derotation, inverse depth.

Motion as in [MVO]: X_cur = R X_prev + t, so x_cur^T F x_prev = 0 with F = K^-T [t]x R K^-1, (4).
Rays are K^-1 x with last coordinate 1. Inverse depths are in units of 1/|t|.
"""

from mv_slapse.geometry.rotation import cross, skew
from mv_slapse.kernels.binding import compiled
import numpy as np


def fundamental(K, R_cur_from_prev, t_cur_from_prev) -> np.ndarray:
    """Return F (3, 3) with x_cur^T F x_prev = 0, (4) of [MVO]."""
    K_inv = np.linalg.inv(K)
    return K_inv.T @ skew(t_cur_from_prev) @ R_cur_from_prev @ K_inv


def epipolar_error(rays_cur, rays_prev, focal, R_cur_from_prev, t_cur_from_prev):
    """Signed distance of x_prev from its epipolar line, the Sampson error of (5) in [MVO].

    A block's centre is exact and its match is not, so all noise is in x_prev and the first-order
    (Sampson) error is this distance.

    Parameters
    ----------
    rays_cur, rays_prev : (N, 3) arrays
    focal : (2,) array
        fx, fy [px].
    R_cur_from_prev, t_cur_from_prev : (3, 3), (3,) arrays
        Motion; any length of t.

    Returns
    -------
    error : (N,) array
        [px].
    """
    return compiled.epipolar_error(*map(_contiguous, (
        rays_cur, rays_prev, focal, R_cur_from_prev, t_cur_from_prev)))


def _contiguous(array) -> np.ndarray:
    return np.ascontiguousarray(array, float)


def derotate(rays_prev: np.ndarray, R_cur_from_prev: np.ndarray) -> np.ndarray:
    """Rays x'_prev ~ R x_prev (N, 3) as the current camera would see them untranslated, (6)."""
    y = rays_prev @ R_cur_from_prev.T
    return y / y[:, 2:]


def inverse_depth(rays_cur, rays_prev, focal, R_cur_from_prev, t_cur_from_prev):
    """Inverse depth of each point in camera k and its sensitivity to the match.

    From X_prev ~ R^T (x_cur - rho t): with y = R x_prev / z, rho (t_xy - y t_z) = x_cur - y,
    solved along the epipolar line.

    Returns
    -------
    rho : (N,) array
        Depth along the optical axis, inverted [1/|t|]; negative: behind the camera or moving.
    per_pixel : (N,) array
        |d rho / d x_prev| along the line [1/|t|/px].
    """
    return compiled.inverse_depth(*map(_contiguous, (
        rays_cur, rays_prev, focal, R_cur_from_prev, t_cur_from_prev)))


def inverse_depth_jacobian(rays_cur, rays_prev, focal, R_cur_from_prev, t_cur_from_prev):
    """Return inverse_depth's rho (N,) and its derivative (N, 6) by (w, t), R -> exp(w) R."""
    y = derotate(rays_prev, R_cur_from_prev)
    g = (t_cur_from_prev[:2] - y[:, :2] * t_cur_from_prev[2]) * focal
    square = np.maximum(np.sum(g * g, axis=1), 1e-18)[:, None]
    gap = (rays_cur[:, :2] - y[:, :2]) * focal
    rho = np.sum(gap * g, axis=1) / square[:, 0]
    by_gap, by_g = g / square * focal, (gap - 2 * rho[:, None] * g) / square * focal
    # y moves by w x y, and back to z = 1; what a vector v in the picture tells by y is v . dy.
    by_y = -by_gap - by_g * t_cur_from_prev[2]
    by_y = np.c_[by_y, -np.sum(by_y * y[:, :2], axis=1)]
    return rho, np.c_[cross(y, by_y), by_g, -np.sum(by_g * y[:, :2], axis=1)]


def parallax(rays_cur, rays_prev, focal, R_cur_from_prev):
    """Pixel displacement x_cur - x'_prev (N, 2) that is left after rotation is removed, (6)."""
    return (rays_cur[:, :2] - derotate(rays_prev, R_cur_from_prev)[:, :2]) * focal
