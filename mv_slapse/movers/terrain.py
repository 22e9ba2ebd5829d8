"""Land at another height than the road: banks, ditches, what lies beyond an edge.

It looks farther than the plane of the road, as a car ahead does, and it hides that plane. But its
inverse depth grows from row to row as the road's does, in one proportion, and a car's does not.
"""

import numpy as np

RELIEF = 0.05  # share of their inverse depth by which bodies are no planes, and land neither
FARTHEST = 9.0  # squared error, in variances, that one block tells at most: it may be wrong
DEPENDENCE = 2.0  # blocks that tell as much as one
ITERATIONS = 3  # of the reweighting: more change the share of land by less than a per cent, mostly


def land_rather(rho: np.ndarray, sigma: np.ndarray, under: np.ndarray, first: np.ndarray
                ) -> np.ndarray:
    """Return how much rather regions (R,) show still land than one depth, as chi-square, from 0.

    Parameters
    ----------
    rho, sigma : (N,), (N,) arrays
        Apparent inverse depths of their blocks and what noise makes of them [1/baseline].
    under : (N,) array
        Inverse depth of the ground there [1/baseline]; blocks above the horizon tell nothing.
    first : (R,) array
        Where each region begins.
    """
    weight = (under > 0) / (sigma**2 + (RELIEF * rho)**2 + 1e-18)
    number = np.repeat(np.arange(len(first)), np.diff(first, append=len(rho)))
    land, share = _misfit(rho, np.where(under > 0, under, 0.0), weight, first, number)
    body, _ = _misfit(rho, np.ones(len(rho)), weight, first, number)
    # Nothing still looks farther than infinity.
    return np.where(share > 0, np.maximum(body - land, 0.0) / DEPENDENCE, 0.0)


def _misfit(rho, shape, weight, first, number):
    """Return the capped squared errors (R,) of the best multiples (R,) of a shape (N,)."""
    own = weight
    for _ in range(ITERATIONS):
        scale = (np.add.reduceat(own * rho * shape, first)
                 / np.maximum(np.add.reduceat(own * shape**2, first), 1e-12))
        squared = weight * (rho - scale[number] * shape)**2
        own = weight / (1 + squared / FARTHEST)**2
    return np.add.reduceat(np.minimum(squared, FARTHEST), first), scale
