"""Two views of stationary points: their inverse depth.

Motion as in [MVO]: X_cur = R X_prev + t, so x_cur^T F x_prev = 0 with F = K^-T [t]x R K^-1, (4).
Rays are K^-1 x with last coordinate 1. Inverse depths are in units of 1/|t|.
"""

from mv_slapse.kernels.binding import compiled
import numpy as np


def inverse_depth(rays_cur, rays_prev, focal, R_cur_from_prev, t_cur_from_prev):
    """Inverse depth of each point in camera k and its sensitivity to the match.

    From X_prev ~ R^T (x_cur - rho t): with y = R x_prev / z, rho (t_xy - y t_z) = x_cur - y,
    solved along the epipolar line. Returns rho (N,), the depth along the optical axis, inverted
    [1/|t|] (negative: behind the camera or moving), and |d rho / d x_prev| along the line (N,)
    [1/|t|/px].
    """
    return compiled.inverse_depth(*(np.ascontiguousarray(array, float) for array in (
        rays_cur, rays_prev, focal, R_cur_from_prev, t_cur_from_prev)))
