"""Stationary planes from inverse depths: three unknowns, linear, sampled and then refined.

With the camera's motion known, a correspondence gives an inverse depth rho on its ray, and a
plane holds -plane @ ray = rho: three blocks make a plane, all hypotheses are scored in one
product. This takes the place of the four-point homographies of [MVO] 4.3, which moving planes
keep.
"""

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Depths:
    """Inverse depths of blocks: rays (N, 3), rho (N,), sigma (N,) [1/baseline], x (N, 2) [px]."""

    rays: np.ndarray
    rho: np.ndarray
    sigma: np.ndarray
    x: np.ndarray

    def __getitem__(self, mask) -> 'Depths':
        """Return those of a mask or an index."""
        return Depths(self.rays[mask], self.rho[mask], self.sigma[mask], self.x[mask])

    def __len__(self) -> int:
        """Return their number."""
        return len(self.rho)

    def error(self, plane: np.ndarray) -> np.ndarray:
        """Distance from a plane in standard deviations, (N,)."""
        return (self.rho + self.rays @ plane) / self.sigma

    def error_each(self, planes: np.ndarray) -> np.ndarray:
        """Distance of each block from a plane of its own, planes (N, 3), as in ``error``."""
        return (self.rho + np.einsum('ij,ij->i', self.rays, planes)) / self.sigma


def sample_planes(depths: Depths, radius: float, trials: int, rng: np.random.Generator):
    """Draw planes (T, 3) through three blocks that lie within a radius [px] of each other.

    Neighbours share a plane far more often than blocks drawn from the whole picture do.
    """
    first = rng.integers(len(depths), size=trials)
    order = np.argsort(depths.x[:, 0], kind='stable')
    x_sorted = depths.x[order, 0]
    low = np.searchsorted(x_sorted, depths.x[first, 0] - radius)
    high = np.searchsorted(x_sorted, depths.x[first, 0] + radius, 'right')
    pick = low[:, None] + (rng.random((trials, 8)) * (high - low)[:, None]).astype(int)
    other = order[pick]
    near = np.abs(depths.x[other, 1] - depths.x[first, 1][:, None]) <= radius
    rank = np.argsort(~near, axis=1, kind='stable')[:, :2]
    triple = np.c_[first, np.take_along_axis(other, rank, 1)]
    M = depths.rays[triple]
    good = np.abs(np.linalg.det(M)) > 1e-6
    return -np.linalg.solve(M[good], depths.rho[triple[good]][..., None])[..., 0]


def best_plane(depths: Depths, planes: np.ndarray, cut: float = 3.0, prior=None,
               blur: float = np.inf):
    """Return the plane (3,) with the least truncated squared error and its cost, or None.

    ``prior`` (T,) is added to the cost of each hypothesis, in units of outliers. What would not
    know its depth on a plane to a share ``blur`` of it speaks for none: far planes explain it all.
    """
    if not len(planes):
        return None, np.inf
    expected = -planes @ depths.rays.T
    error = np.square((depths.rho - expected) / depths.sigma)
    error[depths.sigma > blur * expected] = np.inf
    cost = np.minimum(error, cut**2).sum(axis=1) / cut**2
    cost = cost if prior is None else cost + prior
    best = int(np.argmin(cost))
    return planes[best], float(cost[best])


def refine_plane(depths: Depths, plane: np.ndarray, width: float = 2.0, steps: int = 5,
                 prior_plane=None, prior_information=None):
    """Reweighted least squares of a plane, with a Geman-McClure kernel.

    Parameters
    ----------
    depths : Depths
        Blocks, wrong ones among them.
    plane : (3,) array
        Start.
    width : float
        Kernel width in standard deviations.
    prior_plane, prior_information : (3,), (3, 3) arrays, optional
        Gaussian prior.

    Returns
    -------
    plane : (3,) array
    covariance : (3, 3) array
    """
    information = np.eye(3) * 1e-12
    for _ in range(steps):
        weight = 1 / np.square(1 + np.square(depths.error(plane) / width)) / depths.sigma**2
        A = depths.rays.T @ (weight[:, None] * depths.rays)
        b = -depths.rays.T @ (weight * depths.rho)
        if prior_plane is not None:
            A, b = A + prior_information, b + prior_information @ prior_plane
        information = A + np.eye(3) * (1e-9 * np.trace(A) + 1e-12)
        plane = np.linalg.solve(information, b)
    return plane, np.linalg.inv(information)
