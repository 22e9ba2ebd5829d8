"""How long a baseline is against the one before it, from the depths that two pairs share.

A pair knows lengths only in its own baseline. A block of key frame k comes from a cell of k-1
whose inverse depth the pair before has measured, in *its* baseline: each such block compares the
two. This carries the scale through vegetation and parked cars, where no plane is.
"""

from dataclasses import dataclass

from mv_slapse.planes import lattice
import numpy as np

MAX_SPREAD = 0.3  # a block's depth must be known this well, as a share of it
MIN_BLOCKS = 20  # fewer cannot tell the mode of the ratios from its outliers


@dataclass(frozen=True)
class DepthMap:
    """Inverse depths of a key frame by cell: ``index`` grid of blocks, rho and sigma of each."""

    index: np.ndarray
    rho: np.ndarray
    sigma: np.ndarray


@dataclass(frozen=True)
class BaselineRatio:
    """log(|t_k| / |t_k-1|) and its standard deviation; infinite where it is unknown."""

    log: float = 0.0
    sigma: float = float('inf')


def depth_map(width, height, x_cur, block, rho, sigma, usable) -> DepthMap:
    """Note the inverse depths of the usable blocks where the next pair will look for them."""
    index = lattice.paint(width, height, x_cur[usable], block[usable],
                          np.flatnonzero(usable).astype(np.int32))
    return DepthMap(index, rho, sigma)


def baseline_ratio(before: DepthMap, x_prev, rays_cur, rho, sigma, usable, R, t) -> BaselineRatio:
    """Compare the depths of blocks with those of the cells they come from.

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
    came_from = lattice.lookup(before.index, x_prev)
    both = usable & (came_from >= 0) & (rho > 0)
    if both.sum() < MIN_BLOCKS:
        return BaselineRatio()
    old, rho, sigma = came_from[both], rho[both], sigma[both]
    z_now = (rays_cur[both] / rho[:, None] - t) @ R[:, 2]
    good = z_now > 0
    if good.sum() < MIN_BLOCKS:
        return BaselineRatio()
    old, now = old[good], 1 / z_now[good]
    return _compare(before.rho[old], before.sigma[old], now,
                    sigma[good] * now**2 / np.square(rho[good]))


def _compare(old, sigma_old, now, sigma_now) -> BaselineRatio:
    """Robust mean of log(now / old) over blocks with inverse depths in either baseline.

    Weights come from the mean of both inverse depths, not from either: a depth that errs high
    would weigh more, and the ratio would drift (by 0.3 % a pair, as measured).
    """
    value = np.log(now / old)
    factor = np.exp(np.median(value))
    mean = 0.5 * (factor * old + now)
    spread = np.hypot(factor * sigma_old, sigma_now) / mean
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
