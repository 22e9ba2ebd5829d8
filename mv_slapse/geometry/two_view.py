"""The joint cost of a key frame pair, (10) of [MVO], and its normal equations.

A correspondence on a plane is a two-dimensional observation of the homography (9), one off all
planes observes the epipolar line only, (5). The same equations serve the re-estimation of a pair
and, with the state's derivative chained on, the update of the scene filter: (19) of [SLAPSE] in
information form.
"""

from dataclasses import dataclass

from mv_slapse.kernels.binding import compiled
import numpy as np


@dataclass(frozen=True)
class Pair:
    """Undistorted correspondences with what is computed of them once.

    Attributes
    ----------
    rays_cur, rays_prev : (N, 3) arrays
    x_prev : (N, 2) array
        [px].
    sigma : (N,) array
        Standard deviation of a coordinate of x_prev [px].
    K : (3, 3) array
        [px].
    """

    rays_cur: np.ndarray
    rays_prev: np.ndarray
    x_prev: np.ndarray
    sigma: np.ndarray
    K: np.ndarray

    @property
    def focal(self) -> np.ndarray:
        """Return fx, fy [px]."""
        return np.array([self.K[0, 0], self.K[1, 1]])

    def __getitem__(self, mask) -> 'Pair':
        """Return the correspondences of a mask or an index."""
        rows = numbers(mask, len(self))
        return Pair(self.rays_cur.take(rows, 0), self.rays_prev.take(rows, 0),
                    self.x_prev.take(rows, 0), self.sigma.take(rows), self.K)

    def __len__(self) -> int:
        """Return the number of correspondences."""
        return len(self.sigma)


def numbers(mask, n: int) -> np.ndarray:
    """Return the numbers that a mask, an index or a slice chooses of n.

    To take rows by their numbers costs a third of what a mask does, which is counted each time.
    """
    if not isinstance(mask, np.ndarray):
        return np.arange(n)[mask]
    return np.flatnonzero(mask) if mask.dtype == bool else mask


def columns(pair: Pair, R, t) -> tuple:
    """Return a pair and its motion as the kernels take them."""
    return (pair.rays_cur, pair.rays_prev, pair.sigma, pair.focal, np.ascontiguousarray(R, float),
            np.ascontiguousarray(t, float))


def normal_equations(pair: Pair, R, t, planes, index, relief: float, width: float, *,
                     bias: float = 0.0, dependence=(1.0, 1.0), offset: float = 0.0):
    """Return the normal equations of (10) by (w, t, plane 0, plane 1, ...).

    A Geman-McClure kernel bounds each correspondence; the cost is minus twice the log likelihood.

    Parameters
    ----------
    planes : (P, 3) array
        n / d in camera k.
    index : (N,) int array
        Plane of each correspondence; -1: epipolar error only.
    relief : float
        Standard deviation of a surface's depth about its plane, as a share of depth: along the
        epipolar line it adds this share of the parallax to the noise.
    width : float
        Of the kernel, in standard deviations.
    bias : float
        Share by which all depths of a surface err together: encoders pull all vectors of a
        surface the same way. It is marginalised.
    dependence : (float, float)
        Correspondences that together tell as much as one independent one does, across epipolar
        lines and, where relief errs together too, along them.
    offset : float
        Error that all vectors share [px], a turn of the camera. It is marginalised.

    Returns
    -------
    A : (6 + 3 P, 6 + 3 P) array
    b : (6 + 3 P,) array
    cost : float
    """
    return compiled.normal_equations(
        *columns(pair, R, t), np.ascontiguousarray(index, np.int64),
        np.ascontiguousarray(planes, float).reshape(-1, 3),
        np.array([relief, width, *dependence, bias, offset], float))
