"""Undistorted correspondences of a key frame pair, alone and with its motion.

Motion as in [MVO]: X_cur = R X_prev + t, so x_cur^T F x_prev = 0 with F = K^-T [t]x R K^-1, (4).
Rays are K^-1 x with last coordinate 1. Inverse depths are in units of 1/|t|.
"""

from dataclasses import dataclass

from mv_slapse.geometry.rotation import norm
from mv_slapse.kernels.binding import compiled
import numpy as np

MAX_SPREAD = 0.2  # a depth's error, as a share of it, beyond which it tells nothing
KERNEL_WIDTH = 3.0  # of the Geman-McClure kernel of fits that are nearly right [sigma]


@dataclass(frozen=True)
class Pair:
    """Undistorted correspondences with what is computed of them once."""

    rays_cur: np.ndarray  # (N, 3)
    rays_prev: np.ndarray  # (N, 3)
    x_prev: np.ndarray  # (N, 2) [px]
    sigma: np.ndarray  # (N,): standard deviation of a coordinate of x_prev [px]
    K: np.ndarray  # (3, 3) [px]

    @property
    def focal(self) -> np.ndarray:
        """Return fx, fy [px]."""
        return np.array([self.K[0, 0], self.K[1, 1]])

    @property
    def roll_arm(self) -> float:
        """Return how much more a roll than another turn makes of vectors that err on one side."""
        return 1 / max(norm(self.rays_cur[:, :2].ravel()) / max(len(self), 1)**0.5, 1e-3)

    def __getitem__(self, mask) -> 'Pair':
        """Return the correspondences of a mask or an index."""
        rows = numbers(mask, len(self))
        return Pair(*compiled.take_rows(
            (self.rays_cur, self.rays_prev, self.x_prev, self.sigma), rows), self.K)

    def __len__(self) -> int:
        """Return the number of correspondences."""
        return len(self.sigma)


def numbers(mask, n: int) -> np.ndarray:
    """Return the numbers that a mask, an index or a slice chooses of n, for kernels."""
    if not isinstance(mask, np.ndarray):
        return np.arange(n)[mask]
    return mask.nonzero()[0] if mask.dtype == bool else mask


def columns(pair: Pair, R, t) -> tuple:
    """Return a pair and its motion as the kernels take them."""
    return (pair.rays_cur, pair.rays_prev, pair.sigma, pair.focal, np.ascontiguousarray(R, float),
            np.ascontiguousarray(t, float))


def inverse_depth(rays_cur, rays_prev, focal, R_cur_from_prev, t_cur_from_prev):
    """Inverse depth of each point in camera k and its sensitivity to the match.

    From X_prev ~ R^T (x_cur - rho t): with y = R x_prev / z, rho (t_xy - y t_z) = x_cur - y,
    solved along the epipolar line. Returns rho (N,), the depth along the optical axis, inverted
    [1/|t|] (negative: behind the camera or moving), and |d rho / d x_prev| along the line (N,)
    [1/|t|/px].
    """
    return compiled.inverse_depth(*(np.ascontiguousarray(array, float) for array in (
        rays_cur, rays_prev, focal, R_cur_from_prev, t_cur_from_prev)))
