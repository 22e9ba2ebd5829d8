"""How long a baseline is against the one before it, from the depths that two pairs share.

A pair knows lengths only in its own baseline. A block of key frame k comes from a cell of k-1
whose inverse depth the pair before has measured, in *its* baseline: each such block compares the
two. This carries the scale through vegetation and parked cars, where no plane is.
"""

from dataclasses import dataclass

from mv_slapse.planes import lattice
import numpy as np

STEPS = np.array([[i, j] for i in (-1, 0, 1) for j in (-1, 0, 1)])  # macroblocks around one
SAME_SURFACE = 0.25  # share of inverse depth by which blocks of one surface differ next door
MIN_NEIGHBOURS = 5  # of nine: three are needed for a plane
MAX_SPREAD = 0.3  # a block's depth must be known this well, as a share of it
MIN_BLOCKS = 20  # fewer cannot tell the mode of the ratios from its outliers


@dataclass(frozen=True)
class DepthMap:
    """Inverse depths of a key frame by macroblock.

    Attributes
    ----------
    grid : (rows, columns) int array
        Index of the block in each macroblock, -1 for none; a margin of one surrounds it.
    x : (N, 2) array
        Block centres [px].
    rho, sigma : (N,) arrays
        Inverse depths and their standard deviations [1/baseline].
    """

    grid: np.ndarray
    x: np.ndarray
    rho: np.ndarray
    sigma: np.ndarray

    def at(self, x: np.ndarray):
        """Interpolate at pixels (N, 2): rho (N,), sigma (N,), NaN where it cannot be told.

        A plane through the blocks of 3 x 3 macroblocks, as inverse depth is linear on planes. The
        value of the nearest block alone would err one way: seen from the epipole a match lies on
        the inner side of its block, where a street is farther (0.2 % a pair, as measured).
        """
        row, column = lattice.cells(x, np.subtract(self.grid.shape, 2), lattice.MACROBLOCK)
        near = self.grid[row[:, None] + 1 + STEPS[:, 0], column[:, None] + 1 + STEPS[:, 1]]
        rho, sigma = self.rho[near], self.sigma[near]
        middle = rho[:, [4]]
        same = (near >= 0) & (near[:, [4]] >= 0) & (
            np.abs(rho - middle) < SAME_SURFACE * middle + 3 * sigma)
        weight = np.where(same, 1 / np.maximum(sigma, 1e-12)**2, 0.0)
        offset = (self.x[near] - x[:, None]) / lattice.MACROBLOCK
        M = np.concatenate([np.ones((*near.shape, 1)), offset], axis=2)
        A = np.einsum('nki,nk,nkj->nij', M, weight, M)
        b = np.einsum('nki,nk->ni', M, weight * rho)
        known = same.sum(axis=1) >= MIN_NEIGHBOURS
        # Blocks in one row make no plane: their normal equations are singular.
        size = np.trace(A, axis1=1, axis2=2) / 3
        known &= np.linalg.det(A) > 1e-4 * size**3
        value, error = np.full(len(x), np.nan), np.full(len(x), np.nan)
        inverse = np.linalg.inv(A[known])
        value[known] = np.einsum('nj,nj->n', inverse[:, 0], b[known])
        error[known] = np.sqrt(inverse[:, 0, 0])
        return value, error


@dataclass(frozen=True)
class BaselineRatio:
    """log(|t_k| / |t_k-1|) and its standard deviation; infinite where it is unknown."""

    log: float = 0.0
    sigma: float = float('inf')


def depth_map(width, height, x_cur, rho, sigma, usable) -> DepthMap:
    """Note the inverse depths of the usable blocks (N,) where the next pair will look for them."""
    shape = lattice.shape_of(width, height, lattice.MACROBLOCK)
    grid = np.full(np.add(shape, 2), -1)
    index = np.flatnonzero(usable)
    row, column = lattice.cells(x_cur[index], shape, lattice.MACROBLOCK)
    grid[row + 1, column + 1] = index
    return DepthMap(grid, x_cur.astype(float), rho, sigma)


def baseline_ratio(before: DepthMap, x_prev, rays_cur, rho, sigma, usable, R, t) -> BaselineRatio:
    """Compare the depths of blocks with those at the places they come from.

    Parameters
    ----------
    before : DepthMap
        Of key frame k-1, in units of the baseline of (k-2, k-1).
    x_prev : (N, 2) array
        [px].
    rays_cur, rho, sigma, usable : (N, 3), (N,), (N,), (N,) arrays
        Of the pair (k-1, k); ``usable``: stationary, with parallax.
    R, t : (3, 3), (3,) arrays
        X_cur = R X_prev + t, |t| = 1.

    Returns
    -------
    ratio : BaselineRatio
        Robust mean over blocks of log(Z_before / Z_now), both at camera k-1.
    """
    index = np.flatnonzero(usable & (rho > 0))
    old, sigma_old = before.at(x_prev[index])
    z_now = (rays_cur[index] / rho[index, None] - t) @ R[:, 2]
    good = np.isfinite(old) & (z_now > 0)
    good[good] = old[good] > 0
    if good.sum() < MIN_BLOCKS:
        return BaselineRatio()
    index, now = index[good], 1 / z_now[good]
    return _compare(old[good], sigma_old[good], now,
                    sigma[index] * now**2 / np.square(rho[index]))


def _compare(old, sigma_old, now, sigma_now) -> BaselineRatio:
    """Robust mean of log(now / old) over blocks with inverse depths in either baseline.

    Errors are shares of the older depth, which nine blocks make sure: with the newer one a block
    that errs high would weigh more. The mean of a logarithm lies half a variance low.
    """
    value = np.log(now / old)
    factor = np.exp(np.median(value))
    share_old, share_now = sigma_old / old, sigma_now / (factor * old)
    value += 0.5 * (np.square(share_now) - np.square(share_old))
    spread = np.hypot(share_old, share_now)
    sure = spread < MAX_SPREAD
    return robust_mean(value[sure], spread[sure])


def robust_mean(value: np.ndarray, sigma: np.ndarray) -> BaselineRatio:
    """Return the mode of values with errors sigma, refined; far values count nothing."""
    if len(value) < MIN_BLOCKS:
        return BaselineRatio()
    width = 3 * np.maximum(sigma, 0.02)
    candidates = np.quantile(value, np.linspace(0.05, 0.95, 61))
    support = (1 / (1 + np.square((value - candidates[:, None]) / width)) / width).sum(axis=1)
    mean = candidates[np.argmax(support)]
    for _ in range(8):
        weight = 1 / np.square(1 + np.square((value - mean) / width)) / width**2
        mean = np.sum(weight * value) / np.sum(weight)
    inlier = np.abs(value - mean) < width
    if inlier.sum() < MIN_BLOCKS:
        return BaselineRatio()
    scatter = np.sqrt(np.sum(weight * np.square(value - mean)) / np.sum(weight))
    return BaselineRatio(float(mean), float(scatter / np.sqrt(inlier.sum())))
