"""What stood still a while ago, where it must be now: by this a parked car shows that it starts.

For a second a car that starts looks like one that stands farther off, and depths that follow new
vectors follow it. Those of a while ago, carried on by the camera's motion alone, do not: what is
farther now than all that was seen there has departed.
"""

from dataclasses import dataclass, field

from mv_slapse.geometry.blocks import grid_index, grid_shape
from mv_slapse.geometry.two_view import Pair
from mv_slapse.motion.observations import BlockObservations
from mv_slapse.records import Extraction
from mv_slapse.surfaces.consensus import Depths
import numpy as np
from scipy import ndimage

YOUNGEST, OLDEST = 0.3, 0.7  # [s] a car has gone 0.1 m, 0.8 m then; older depths err by more
WELL_KNOWN = 0.2  # error of a depth of one pair, as a share, beyond which it tells nothing
AROUND = 3  # macroblocks in which all that was seen counts: edges of things err by one
LEAST_SEEN = 3  # of these nine, or an edge could be missed
FARTHER = 0.06  # log of the depth: what motion and common errors of vectors make of it,
SIGMAS = 2.0  # and as many standard deviations of the block's own
AWAY = 0.4  # of the same: 5 m before the camera a car may gain as much in this time; more is wrong
STOOD = 0.8  # of the ground's inverse depth and more where a vehicle was: as of what is ground
LEAST_LEFT = 4  # of nine macroblocks: what departs is a body, and wrong vectors are scattered
# Share of departed blocks: of a car that starts (0.7 to 1 as measured), and of what stands.
LEAVING, STRAYING = 0.75, 0.005
AT_EDGES = 0.05  # the latter where not all around was nearer: 5 to 8 %, not 1 to 2, of lone blocks
SECOND = 1e9  # [ns]


@dataclass(frozen=True)
class Past:
    """Points that stood still in the last key frames.

    Attributes
    ----------
    stamp : (N,) int
        When they were seen [ns].
    X : (N, 3) float64
        In the camera of the last key frame [baseline of its pair].
    """

    stamp: np.ndarray = field(default_factory=lambda: np.zeros(0, int))
    X: np.ndarray = field(default_factory=lambda: np.zeros((0, 3)))

    def carried(self, stamp: int, R: np.ndarray, t: np.ndarray, log_ratio: float) -> 'Past':
        """Return it in the camera of the next key frame, without what is too old by then.

        Parameters
        ----------
        stamp : int
            Of the key frame [ns].
        R, t : (3, 3), (3,) arrays
            X_cur = R X_prev + t, |t| = 1.
        log_ratio : float
            Of this baseline over the last.
        """
        kept = stamp - self.stamp <= OLDEST * SECOND
        return Past(self.stamp[kept], self.X[kept] * np.exp(-log_ratio) @ R.T + t)

    def noted(self, stamp: int, depths: Depths) -> 'Past':
        """Return it with the depths that stand still in the key frame at ``stamp`` [ns]."""
        sure = depths.sigma < WELL_KNOWN * depths.rho
        X = depths.rays[sure] / depths.rho[sure, None]
        return Past(np.concatenate([self.stamp, np.full(len(X), stamp)]),
                    np.concatenate([self.X, X]))

    def seen(self, stamp: int, K: np.ndarray, size: tuple[int, int]):
        """Return what inverse depths were seen in macroblocks, and the least in and around them.

        Of all that lies in a macroblock now the median counts.

        Parameters
        ----------
        stamp : int
            Of the key frame in whose camera the points are [ns].
        K, size : (3, 3) array, (width, height)
            [px].

        Returns
        -------
        inside, least : (rows * columns,), (rows * columns,) arrays
            NaN where nothing, or too little, was seen.
        """
        columns, rows = grid_shape(*size)
        X = self.X[(stamp - self.stamp >= YOUNGEST * SECOND) & (self.X[:, 2] > 0)]
        cell = grid_index((X @ K.T)[:, :2] / X[:, 2:], *size)
        rho, cell = 1 / X[cell >= 0, 2], cell[cell >= 0]
        order = np.lexsort((rho, cell))
        values, first, count = np.unique(cell[order], return_index=True, return_counts=True)
        grid = np.full(rows * columns, np.inf)
        grid[values] = rho[order][first + count // 2]
        grid = grid.reshape(rows, columns)
        least = ndimage.minimum_filter(grid, AROUND)
        least[_around(np.isfinite(grid)) < LEAST_SEEN] = np.nan
        return np.where(np.isfinite(grid), grid, np.nan).ravel(), least.ravel()


def depths_of(pair: Pair, extraction: Extraction, evidence: BlockObservations, known) -> Depths:
    """Return what a pair's vectors alone tell of the depths of its blocks, 0 of those not known.

    ``known`` is (N,) bool.
    """
    return Depths(pair.rays_cur, np.where(known, evidence.rho, 0.0), evidence.blur,
                  extraction.x_cur)


def departure(past: Past, extraction: Extraction, depths: Depths,
              ground: np.ndarray | None = None) -> np.ndarray:
    """Return how much rather blocks (N,) have left where they stood than not, log-likelihoods.

    Positive: a block is farther than all that stood there a while ago. 0: nothing is known.

    Parameters
    ----------
    past : Past
        Carried to the extraction's key frame.
    extraction : Extraction
    depths : Depths
        Of its blocks, as if they stood still [1/baseline]; 0 where that is unknown.
    ground : (3,) array, optional
        Ground plane n / d in camera k [1/baseline]: no vehicle stood below it.
    """
    size, rho = (extraction.width, extraction.height), depths.rho
    at = grid_index(depths.x, *size)
    known = (at >= 0) & (depths.sigma < WELL_KNOWN * rho)
    rho = np.where(known, rho, 1.0)
    sure = FARTHER + SIGMAS * depths.sigma / rho
    inside, least = (np.log(values[at] / rho) for values in past.seen(
        extraction.stamp, extraction.K, size))
    # Near things outgrow what was seen of them: between its points the farthest around counts.
    far = np.where(np.isnan(inside), least, inside)
    left = known & (far > sure) & (far < AWAY)
    if ground is not None:
        left &= rho * np.exp(far) > STOOD * -(depths.rays @ ground)
    left &= _about(at, left & (least > 0), size) > 0
    left &= _about(at, left, size) >= LEAST_LEFT
    stays = np.clip((sure - inside) / (sure - FARTHER), 0.0, 1.0)
    stray = np.where(least > 0, STRAYING, AT_EDGES)
    return np.where(left, np.log(LEAVING / stray), 0.0) + np.where(
        known & (inside < sure), stays * np.log((1 - LEAVING) / (1 - STRAYING)), 0.0)


def _about(at, those, size):
    """Return how many of the macroblocks in and around those of blocks at (N,) hold some (N,)."""
    grid = np.zeros(grid_shape(*size)[::-1], bool)
    grid.ravel()[at[those]] = True
    return _around(grid).ravel()[at]


def _around(grid: np.ndarray) -> np.ndarray:
    """Return how many of the macroblocks (rows, columns) bool in and around each hold."""
    return np.rint(ndimage.uniform_filter(grid.astype(float), AROUND, mode='constant') * AROUND**2)
