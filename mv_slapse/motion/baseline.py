"""How long a baseline is against the one before it, from the depths that two pairs share.

A pair knows lengths only in its own baseline. A block of key frame k comes from a cell of k-1
whose inverse depth the pair before has measured, in *its* baseline: each such block compares the
two. This carries the scale through vegetation and parked cars, where no plane is.
"""

from dataclasses import dataclass

from mv_slapse.geometry.blocks import grid_shape
from mv_slapse.kernels.binding import compiled
from mv_slapse.motion.estimate import MotionFit
from mv_slapse.motion.observations import BlockObservations
import numpy as np

SAME_SURFACE = 0.25  # share of inverse depth by which blocks of one surface differ next door
MIN_NEIGHBOURS = 5  # of nine: three are needed for a plane
MAX_SPREAD = 0.2  # a depth's error by which two pairs may differ, as a share of it: with more, the
# least parallax of a depth would cut off the low ones only
CHANGE = 0.3  # common change of log(speed) from pair to pair; a start from rest has more
MIN_BLOCKS = 20  # fewer cannot tell the mode of the ratios from its outliers
POLICY = np.array([SAME_SURFACE, MAX_SPREAD, CHANGE, MIN_NEIGHBOURS, MIN_BLOCKS])


@dataclass(frozen=True)
class DepthMap:
    """Inverse depths of a key frame by macroblock."""

    # (rows, columns) int: index of the block in each macroblock, -1 for none; a margin of one
    # surrounds it
    grid: np.ndarray
    x: np.ndarray  # (N, 2): block centres [px]
    rho: np.ndarray  # (N,): inverse depths [1/baseline]
    # (N,): standard deviation that a point at infinity would have there [1/baseline]
    noise: np.ndarray
    # t_z of the pair [baseline]: it makes rho's standard deviation noise (1 - rho t_z)^2
    approach: float
    relief: float  # depth of a surface about its plane, as a share of depth

    def at(self, x: np.ndarray):
        """Interpolate at pixels (N, 2): rho (N,), sigma (N,), NaN where it cannot be told.

        A plane through the blocks of 3 x 3 macroblocks, as inverse depth is linear on planes. The
        value of the nearest block alone would err one way: seen from the epipole a match lies on
        the inner side of its block, where a street is farther (0.2 % a pair, as measured).
        """
        return compiled.depths_at(self.columns, np.ascontiguousarray(x, float), POLICY)

    @property
    def columns(self) -> tuple:
        """Return it as the kernels take it."""
        return self.grid, self.x, self.rho, self.noise, self.approach, self.relief


@dataclass(frozen=True)
class BaselineRatio:
    """log(|t_k| / |t_k-1|) and its standard deviation; infinite where it is unknown."""

    log: float = 0.0
    sigma: float = float('inf')


def depth_map(size, depths, approach: float, relief: float, usable) -> DepthMap:
    """Note depths (x, rho, noise), as in DepthMap, where another pair will look for them.

    Of a picture of ``size`` (width, height) [px], and of the usable blocks (N,) bool.
    """
    columns, rows = grid_shape(*size)
    x, rho, noise = (np.ascontiguousarray(column, float) for column in depths)
    return DepthMap(compiled.depth_grid(x, usable, rows, columns), x, rho, noise, float(approach),
                    relief)


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


def from_previous(size, seen: BlockObservations, usable, fit: MotionFit, relief) -> DepthMap:
    """Return the depths of a pair (k-1, k) as its camera k-1 sees them.

    Parameters
    ----------
    size : (width, height)
        [px].
    seen : BlockObservations
        Seen from camera k-1 inverse depth is the parallax over that of a point at distance 1,
        which makes ``far_sigma`` the error at every depth.
    usable : (N,) bool array, or True
        Which of those with a depth.
    fit : MotionFit
        Of which these are.
    relief : float
        As in DepthMap.
    """
    rho, before = compiled.previous_depths(seen.pair.rays_cur, seen.rho, seen.has_depth & usable,
                                           fit.R_cur_from_prev, fit.t_cur_from_prev)
    return depth_map(size, (seen.pair.x_prev, rho, seen.far_sigma), 0.0, relief, before)


def _excess(single: DepthMap, smooth: DepthMap, expected: float) -> BaselineRatio:
    """Robust mean of log(rho / rho around it in the other map) over blocks.

    Errors are shares of the smooth depth, which nine blocks make sure: with the single one a
    block that errs low would weigh more.
    """
    return BaselineRatio(*compiled.depth_excess(single.columns, smooth.columns, POLICY, expected))
