"""A house that stands before the next one: facade, end wall, facade, as inverse depths."""

from canyon import GRID, K
from mv_slapse.geometry.camera import to_rays
from mv_slapse.motion.observations import Depths
import numpy as np

UP = np.array([0.0, -1.0, 0.0])
# n / d: facade 5 m to the left, end wall 11 m ahead, facade 3 m to the left.
WALLS = np.array([[1 / 5, 0, 0], [0, 0, -1 / 11], [1 / 3, 0, 0]])
EDGES = (-5 / 11, -3 / 11, 0.0)  # where each ends, as slopes of rays


def walls(rng=None, sigma=0.025, claimed=None):
    """Return Depths of the left half picture and the row of WALLS that each block shows."""
    rays = to_rays(K, GRID)
    half = rays[:, 0] < -0.1
    rays, x = rays[half], GRID[half]
    surface = np.searchsorted(EDGES, rays[:, 0])
    rho = -np.sum(rays * WALLS[surface], axis=1)
    noise = 0.0 if rng is None else sigma * rho * rng.normal(size=len(rho))
    return Depths(rays, rho + noise, (claimed or sigma) * rho, x), surface
