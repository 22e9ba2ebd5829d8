"""Ratio of baselines in numpy: the formulas of its kernels, as reference."""

from mv_slapse.geometry.blocks import MACROBLOCK
from mv_slapse.motion.baseline import (
    BaselineRatio,
    CHANGE,
    MAX_SPREAD,
    MIN_BLOCKS,
    MIN_NEIGHBOURS,
    SAME_SURFACE,
)
import numpy as np

STEPS = np.array([[i, j] for i in (-1, 0, 1) for j in (-1, 0, 1)])  # macroblocks around one


def cells(x, shape, size):
    """Return row and column of the cells in which pixels (N, 2) lie, clipped to a shape."""
    column = np.clip(np.floor((x[:, 0] + 0.5) / size).astype(int), 0, shape[1] - 1)
    row = np.clip(np.floor((x[:, 1] + 0.5) / size).astype(int), 0, shape[0] - 1)
    return row, column


def at(depths, x):
    """Interpolate a DepthMap at pixels (N, 2): rho (N,), sigma (N,)."""
    row, column = cells(x, np.subtract(depths.grid.shape, 2), MACROBLOCK)
    near = depths.grid[row[:, None] + 1 + STEPS[:, 0], column[:, None] + 1 + STEPS[:, 1]]
    rho, middle = depths.rho[near], depths.rho[near[:, [4]]]
    sigma = sigma_of(depths, near, rho)
    same = (near >= 0) & (near[:, [4]] >= 0) & (
        np.abs(rho - middle) < SAME_SURFACE * middle + 3 * sigma)
    mean = np.sum(rho * same, axis=1, keepdims=True) / np.maximum(
        same.sum(axis=1, keepdims=True), 1)
    weight = np.where(same, sigma_of(depths, near, mean)**-2, 0.0)
    dx, dy = np.moveaxis((depths.x[near] - x[:, None]) / MACROBLOCK, 2, 0)
    value, error = _at_origin(dx, dy, rho, weight)
    unknown = same.sum(axis=1) < MIN_NEIGHBOURS
    value[unknown] = error[unknown] = np.nan
    return value, error


def sigma_of(depths, near, rho):
    """Return the standard deviation of the blocks near where they have about rho."""
    sigma = depths.noise[near] * np.square(1 - rho * depths.approach)
    return np.maximum(np.hypot(sigma, depths.relief * rho), 1e-12)


def _at_origin(x, y, value, weight):
    """Fit planes to N times K weighted values (N, K); return them at x = y = 0 and their errors.

    NaN where the values lie in one row. Written out: N small matrices cost numpy far more.
    """
    w, wx, wy = weight, weight * x, weight * y
    s, sx, sy = w.sum(axis=1), wx.sum(axis=1), wy.sum(axis=1)
    sxx, sxy, syy = (wx * x).sum(axis=1), (wx * y).sum(axis=1), (wy * y).sum(axis=1)
    # The first row of the adjugate of the normal equations.
    first, second, third = sxx * syy - sxy**2, sxy * sy - sx * syy, sx * sxy - sxx * sy
    determinant = s * first + sx * second + sy * third
    size = (s + sxx + syy) / 3
    determinant = np.where(determinant > 1e-4 * size**3, determinant, np.nan)
    right = (w * value).sum(axis=1), (wx * value).sum(axis=1), (wy * value).sum(axis=1)
    at = (first * right[0] + second * right[1] + third * right[2]) / determinant
    return at, np.sqrt(first / determinant)


def depth_grid(shape, x, usable):
    """Return the grid of a DepthMap."""
    grid = np.full(np.add(shape, 2), -1)
    index = np.flatnonzero(usable)
    row, column = cells(x[index], shape, MACROBLOCK)
    grid[row + 1, column + 1] = index
    return grid


def excess(single, smooth, expected):
    """Robust mean of log(rho / rho around it in the other map) over blocks.

    Errors are shares of the smooth depth, which nine blocks make sure: with the single one a
    block that errs low would weigh more.
    """
    index = single.grid[single.grid >= 0]
    around, error = at(smooth, single.x[index])
    good = np.isfinite(around)
    good[good] = (around[good] > 0) & (single.rho[index[good]] > 0)
    if good.sum() < MIN_BLOCKS:
        return BaselineRatio()
    index, around = index[good], around[good]
    value = np.log(single.rho[index] / around)
    likely = np.exp(np.median(value)) * around
    spread = np.hypot(sigma_of(single, index, likely) / likely, error[good] / around)
    sure = spread < MAX_SPREAD
    return robust_mean(value[sure], spread[sure], expected)


def robust_mean(value, sigma, expected=0.0):
    """Return the mode of values with errors sigma, refined; far values count nothing.

    Of two modes the one nearer to ``expected`` may be the smaller: vectors to another reference
    picture than was meant make a mode of their own.
    """
    if len(value) < MIN_BLOCKS:
        return BaselineRatio()
    width = 3 * np.maximum(sigma, 0.02)
    n = min(len(value), 31)
    candidates = value[np.arange(n) * len(value) // n]
    support = (1 / (1 + np.square((value - candidates[:, None]) / width)) / width).sum(axis=1)
    support /= 1 + np.square((candidates - expected) / CHANGE)
    mean = candidates[np.argmax(support)]
    for _ in range(8):
        weight = 1 / np.square(1 + np.square((value - mean) / width)) / width**2
        mean = np.sum(weight * value) / np.sum(weight)
    inlier = np.abs(value - mean) < width
    if inlier.sum() < MIN_BLOCKS:
        return BaselineRatio()
    scatter = np.sqrt(np.sum(weight * np.square(value - mean)) / np.sum(weight))
    return BaselineRatio(float(mean), float(scatter / np.sqrt(inlier.sum())))
