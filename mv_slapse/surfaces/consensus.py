"""Inverse depths of blocks.

With the camera's motion known, a correspondence gives an inverse depth rho on its ray, and a
plane holds -plane @ ray = rho: three unknowns, linear, sampled or proposed and then refined. This
takes the place of the four-point homographies of [MVO] 4.3, which moving planes keep.
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

    @property
    def columns(self) -> tuple[np.ndarray, ...]:
        """Return rays, rho, sigma and pixels as kernels take them."""
        return self.rays, self.rho, self.sigma, np.ascontiguousarray(self.x, float)
