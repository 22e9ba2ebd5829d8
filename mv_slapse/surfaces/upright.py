"""Blocks of bodies: what rises from the road shows one depth in all its rows, the road does not.

Vehicles beside the camera's way look as far as a road far below: pair after pair the lower edge of
one tells a wrong height. The blocks above it tell what it is.
"""

from mv_slapse.geometry import lattice
from mv_slapse.surfaces.consensus import Depths
import numpy as np
from scipy.spatial import cKDTree

ABOVE = (0.5, 1.5)  # macroblocks from a block up to the one above it
BESIDE = 0.75  # the same aside
RELIEF = 0.06  # share of an inverse depth by which a surface is no plane
STRAY = 0.05  # density of a wrong vector's depth, to the peak of a right one's
SURE = 3.0  # times likelier to be upright than level


def on_bodies(depths: Depths, drop: np.ndarray, known: np.ndarray) -> np.ndarray:
    """Return the blocks (N,) bool that rise from the road, by the one above or below them.

    Parameters
    ----------
    depths : Depths
        Of N blocks.
    drop : (N,) array
        What each ray falls on the way of one unit.
    known : (N,) bool array
        Blocks below the horizon whose depth means something.
    """
    found = np.zeros(len(drop), bool)
    at = np.flatnonzero(known & (depths.rho > 0))
    if not len(at):
        return found
    x = depths.x[at] / lattice.MACROBLOCK
    pairs = at[cKDTree(x).query_pairs(np.hypot(ABOVE[1], BESIDE), output_type='ndarray')]
    order = np.argsort(depths.x[pairs, 1], axis=1)
    high, low = np.take_along_axis(pairs, order, axis=1).T
    aside, up = np.abs(depths.x[low] - depths.x[high]).T / lattice.MACROBLOCK
    near = (aside <= BESIDE) & (up >= ABOVE[0]) & (up <= ABOVE[1])
    high, low = high[near], low[near]
    rho = depths.rho
    sigma = np.sqrt(depths.sigma[low]**2 + depths.sigma[high]**2
                    + (RELIEF * np.maximum(rho[low], rho[high]))**2)
    level, upright = (np.exp(-0.5 * ((rho[high] - rho[low] * share) / sigma)**2) + STRAY
                      for share in (drop[high] / drop[low], 1.0))
    rises = upright > SURE * level
    found[low[rises]] = found[high[rises]] = True
    return found
