"""How long a baseline is against the one before it, from the depths that two pairs share.

A pair knows lengths only in its own baseline. A block of key frame k comes from a cell of k-1
whose inverse depth the pair before has measured, in *its* baseline: each such block compares the
two. This carries the scale through vegetation and parked cars, where no plane is.
"""

from dataclasses import dataclass

from mv_slapse.geometry import lattice
import numpy as np

STEPS = np.array([[i, j] for i in (-1, 0, 1) for j in (-1, 0, 1)])  # macroblocks around one
SAME_SURFACE = 0.25  # share of inverse depth by which blocks of one surface differ next door
MIN_NEIGHBOURS = 5  # of nine: three are needed for a plane
MAX_SPREAD = 0.2  # a depth's error by which two pairs may differ, as a share of it: with more, the
# least parallax of a depth would cut off the low ones only
RELIEF = 0.03  # depth of a surface about its plane, as a share of depth
CHANGE = 0.3  # common change of log(speed) from pair to pair; a start from rest has more
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
    rho : (N,) array
        Inverse depths [1/baseline].
    noise : (N,) array
        Standard deviation that a point at infinity would have there [1/baseline].
    approach : float
        t_z of the pair [baseline]: it makes rho's standard deviation noise (1 - rho t_z)^2.
    """

    grid: np.ndarray
    x: np.ndarray
    rho: np.ndarray
    noise: np.ndarray
    approach: float

    def at(self, x: np.ndarray):
        """Interpolate at pixels (N, 2): rho (N,), sigma (N,), NaN where it cannot be told.

        A plane through the blocks of 3 x 3 macroblocks, as inverse depth is linear on planes. The
        value of the nearest block alone would err one way: seen from the epipole a match lies on
        the inner side of its block, where a street is farther (0.2 % a pair, as measured).
        """
        row, column = lattice.cells(x, np.subtract(self.grid.shape, 2), lattice.MACROBLOCK)
        near = self.grid[row[:, None] + 1 + STEPS[:, 0], column[:, None] + 1 + STEPS[:, 1]]
        rho, middle = self.rho[near], self.rho[near[:, [4]]]
        sigma = self.sigma(near, rho)
        same = (near >= 0) & (near[:, [4]] >= 0) & (
            np.abs(rho - middle) < SAME_SURFACE * middle + 3 * sigma)
        mean = np.sum(rho * same, axis=1, keepdims=True) / np.maximum(
            same.sum(axis=1, keepdims=True), 1)
        weight = np.where(same, self.sigma(near, mean)**-2, 0.0)
        dx, dy = np.moveaxis((self.x[near] - x[:, None]) / lattice.MACROBLOCK, 2, 0)
        value, error = _at_origin(dx, dy, rho, weight)
        unknown = same.sum(axis=1) < MIN_NEIGHBOURS
        value[unknown] = error[unknown] = np.nan
        return value, error

    def sigma(self, near: np.ndarray, rho: np.ndarray) -> np.ndarray:
        """Return the standard deviation of the blocks ``near`` where they have about ``rho``.

        A block's own measured ``rho`` must not set its weight in a mean: what errs low, or high,
        would count more.
        """
        sigma = self.noise[near] * np.square(1 - rho * self.approach)
        return np.maximum(np.hypot(sigma, RELIEF * rho), 1e-12)


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


@dataclass(frozen=True)
class BaselineRatio:
    """log(|t_k| / |t_k-1|) and its standard deviation; infinite where it is unknown."""

    log: float = 0.0
    sigma: float = float('inf')


def depth_map(width, height, x, rho, noise, approach, usable) -> DepthMap:
    """Note the inverse depths of the usable blocks (N,) where another pair will look for them."""
    shape = lattice.shape_of(width, height, lattice.MACROBLOCK)
    grid = np.full(np.add(shape, 2), -1)
    index = np.flatnonzero(usable)
    row, column = lattice.cells(x[index], shape, lattice.MACROBLOCK)
    grid[row + 1, column + 1] = index
    return DepthMap(grid, x.astype(float), rho, noise, approach)


def baseline_ratio(before: DepthMap, now: DepthMap, expected: float = 0.0) -> BaselineRatio:
    """Compare the depths that two pairs see from the key frame between them.

    Blocks of the later pair are compared with the earlier one's depths around them, and the other
    way round. Either alone errs one way by 0.1 to 0.4 % a pair as measured, for the logarithm of
    a noisy depth, and the choice of blocks that have one, tell on the single blocks only; half the
    difference of the two does not.

    Parameters
    ----------
    before, now : DepthMap
        Of key frame k-1, from the pairs (k-2, k-1) and (k-1, k), each in its own baseline.
    expected : float
        The result at an unchanged speed.

    Returns
    -------
    ratio : BaselineRatio
        Robust mean over blocks of log(Z_before / Z_now).
    """
    ahead, back = _excess(now, before, expected), _excess(before, now, -expected)
    error = np.hypot(max(ahead.sigma, back.sigma), 0.5 * (ahead.log + back.log))
    return BaselineRatio(0.5 * (ahead.log - back.log), float(error))


def from_previous(size, x_prev, rays_cur, rho, noise, usable, R, t) -> DepthMap:
    """Return the depths of a pair (k-1, k) as its camera k-1 sees them.

    Parameters
    ----------
    size : (width, height)
        [px].
    x_prev, rays_cur, rho, usable : (N, 2), (N, 3), (N,), (N,) arrays
        Matches [px], and what camera k sees; ``usable``: stationary, with parallax.
    noise : (N,) array
        As in DepthMap. Seen from camera k-1 inverse depth is the parallax over that of a point at
        distance 1, which makes it the error at every depth.
    R, t : (3, 3), (3,) arrays
        X_cur = R X_prev + t, |t| = 1.
    """
    usable = usable & (rho > 0)
    z = (rays_cur / np.where(usable, rho, 1.0)[:, None] - t) @ R[:, 2]
    usable &= z > 0
    return depth_map(*size, x_prev, 1 / np.where(usable, z, 1.0), noise, 0.0, usable)


def _excess(single: DepthMap, smooth: DepthMap, expected: float) -> BaselineRatio:
    """Robust mean of log(rho / rho around it in the other map) over blocks.

    Errors are shares of the smooth depth, which nine blocks make sure: with the single one a
    block that errs low would weigh more.
    """
    index = single.grid[single.grid >= 0]
    around, error = smooth.at(single.x[index])
    good = np.isfinite(around)
    good[good] = (around[good] > 0) & (single.rho[index[good]] > 0)
    if good.sum() < MIN_BLOCKS:
        return BaselineRatio()
    index, around = index[good], around[good]
    value = np.log(single.rho[index] / around)
    likely = np.exp(np.median(value)) * around
    spread = np.hypot(single.sigma(index, likely) / likely, error[good] / around)
    sure = spread < MAX_SPREAD
    return robust_mean(value[sure], spread[sure], expected)


def robust_mean(value: np.ndarray, sigma: np.ndarray, expected: float = 0.0) -> BaselineRatio:
    """Return the mode of values with errors sigma, refined; far values count nothing.

    Of two modes the one nearer to ``expected`` may be the smaller: vectors to another reference
    picture than was meant make a mode of their own.
    """
    if len(value) < MIN_BLOCKS:
        return BaselineRatio()
    width = 3 * np.maximum(sigma, 0.02)
    candidates = np.quantile(value, np.linspace(0.05, 0.95, 61))
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
