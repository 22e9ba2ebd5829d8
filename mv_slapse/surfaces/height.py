"""The camera's height over the ground from all pairs so far, where one pair shows too little.

Of a motorway a pair shows a dozen right vectors, on markings, tyre marks and joints, among as many
wrong ones. The height in baselines changes from pair to pair as the baseline does, which the rest
of the picture tells to half a per cent; so the evidence of many pairs comes together.
"""

from dataclasses import dataclass

from mv_slapse.surfaces.consensus import Depths
import numpy as np

STEP = 0.04  # of log(height): half of what one block tells at best
LEAST, MOST = 0.05, 50.0  # [baseline]: a robot's camera at full speed, a lorry's that creeps
GRID = np.arange(np.log(LEAST), np.log(MOST), STEP)
RELIEF = 0.04  # error that the road's height has at one block: crown, ruts
BLURRED = 0.5  # standard deviation of a block's depth, as a share: beyond it tells nothing
DRIFT = 0.01  # random walk of log(height) from pair to pair: slope and load
LEAK = 1e-5  # probability that the road has ended and all is as new
BIAS = 0.03  # by which all log(height) err alike: encoders pull vectors to zero, as measured
SURE = 0.07  # standard deviation of log(height) of one that is known; at 0.1 some were wrong
KNOWN = 0.1  # and beyond which it contradicts none
LEAST_PARALLAX = 4.0  # px: shorter vectors may have been pulled to zero
GATE = 2.0  # sigma of the epipolar error of a block that may be right
ISOTROPY = 0.25  # of log(length): width by which the lengths of wrong vectors are smoothed
RIGHT = (0.03, 0.6)  # least and largest share of right vectors that a pair is believed to hold
APART = 48.0  # px, three macroblocks: what lies nearer to each other errs together,
SITES = 2.0  # and so many places tell as much as one
MIN_DEPTHS = 10  # sharp blocks that tell how far the scene is


@dataclass(frozen=True)
class RoadBlocks:
    """Blocks where the ground may be, right ones and wrong ones.

    Attributes
    ----------
    depths : Depths
    drop : (N,) array
        What each ray falls on the way of one unit.
    error : (N,) array
        Epipolar error, in standard deviations.
    sigma : (N,) array
        Standard deviation of a coordinate [px].
    parallax : (N,) array
        Length of the motion that no rotation explains [px].
    """

    depths: Depths
    drop: np.ndarray
    error: np.ndarray
    sigma: np.ndarray
    parallax: np.ndarray

    def possible(self, least: float) -> np.ndarray:
        """Return the blocks (N,) that may show the ground: they move by ``least`` px or more."""
        return ((np.abs(self.error) < GATE) & (self.depths.rho > 0) & (self.parallax > least))

    def strays(self, possible: np.ndarray, least: float):
        """Return the density of wrong vectors among the possible, by log(length), and their share.

        Wrong vectors that lie far off the epipolar line are known, and they point anywhere: as
        many of each length pass for right as chance turns to the line.
        """
        wrong = (np.abs(self.error) > GATE) & (self.parallax > least)
        length = self.parallax[wrong]
        chance = np.arcsin(np.minimum(GATE * self.sigma[wrong] / length, 1.0)) / np.pi
        passing = chance / (1 - 2 * np.minimum(chance, 0.4))
        gap = np.log(self.parallax[possible])[:, None] - np.log(length)
        near = np.exp(-0.5 * np.square(gap / ISOTROPY)) / (np.sqrt(2 * np.pi) * ISOTROPY)
        # One more of any length, over the six units that lengths have.
        total = passing.sum()
        return (near @ passing + 1 / 6) / (total + 1), total / max(possible.sum(), 1)

    def around(self, possible: np.ndarray) -> np.ndarray:
        """Return how many of the possible blocks lie about each, itself among them.

        An encoder goes on with the last vector over smooth ground: what lies together tells as
        much as one.
        """
        near = [np.abs(column[:, None] - column) < APART for column in self.depths.x[possible].T]
        return np.count_nonzero(near[0] & near[1], axis=1)


@dataclass(frozen=True)
class HeightBelief:
    """Probability of the logarithm of the height [baseline], on GRID; it sums to 1."""

    probability: np.ndarray

    @classmethod
    def blank(cls) -> 'HeightBelief':
        """Return what is known at first: nothing."""
        return cls(np.full(len(GRID), 1 / len(GRID)))

    @property
    def log(self) -> float:
        """Return the mean of log(height)."""
        return float(self.probability @ GRID)

    @property
    def spread(self) -> float:
        """Return the standard deviation of log(height)."""
        return float(np.sqrt(self.probability @ np.square(GRID - self.log) + STEP**2 / 12))

    def allows(self, plane: np.ndarray) -> bool:
        """Tell whether a plane (3,) may be the ground, as far as the height is known.

        Where a road moves fast most of its vectors are wrong, and one pair's ground errs by 10 to
        20 % where what many pairs show errs by 3 to 5 (KITTI at five pictures a second).
        """
        spread = np.hypot(self.spread, BIAS)
        return spread > KNOWN or abs(np.log(np.linalg.norm(plane)) + self.log) < 3 * spread

    def moved(self, log_ratio: float, sigma: float) -> 'HeightBelief':
        """Return it in the next baseline, which is exp(log_ratio) of this one."""
        moved = np.interp(GRID + log_ratio, GRID, self.probability, 0.0, 0.0)
        width = min(float(np.hypot(sigma, DRIFT)), 3.0) / STEP
        reach = np.arange(-np.ceil(3 * width), np.ceil(3 * width) + 1)
        kernel = np.exp(-0.5 * np.square(reach / width))
        moved = np.convolve(moved, kernel / kernel.sum())[len(reach) // 2:][:len(GRID)]
        return HeightBelief((1 - LEAK) * moved + (1 - (1 - LEAK) * moved.sum()) / len(GRID))

    def seen(self, blocks: RoadBlocks, tilt: float, parallax: float,
             ceiling: float) -> 'HeightBelief':
        """Return it after a pair.

        Parameters
        ----------
        blocks : RoadBlocks
        tilt : float
            Standard deviation of the ground's direction [rad].
        parallax : float
            Median of the scene's [px]: what is nearest moves more.
        ceiling : float
            Largest height [baseline].
        """
        least = max(LEAST_PARALLAX, parallax)
        possible = blocks.possible(least)
        if not possible.any():
            return self
        stray, wrong = blocks.strays(possible, least)
        right = np.clip(1 - wrong, *RIGHT)
        depths = blocks.depths[possible]
        expected = blocks.drop[possible][:, None] * np.exp(-GRID)
        rough = np.hypot(RELIEF, tilt / blocks.drop[possible])[:, None]
        sigma = np.hypot(depths.sigma[:, None], rough * expected)
        error = (depths.rho[:, None] - expected) / sigma
        density = np.exp(-0.5 * np.square(error)) * expected / (np.sqrt(2 * np.pi) * sigma)
        gain = np.log(1 - right + right * density / stray[:, None])
        gain[sigma > BLURRED * expected] = 0
        share = 1 / (SITES * blocks.around(possible))
        log = np.where(np.log(ceiling) > GRID, share @ gain + np.log(self.probability), -np.inf)
        if not np.any(np.isfinite(log)):
            return HeightBelief.blank()
        probability = np.exp(log - log.max())
        return HeightBelief(probability / probability.sum())
