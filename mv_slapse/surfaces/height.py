"""The camera's height over the ground from all pairs so far, where one pair shows too little.

Of a motorway a pair shows a dozen right vectors, on markings, tyre marks and joints, among as many
wrong ones. The height in baselines changes from pair to pair as the baseline does, which the rest
of the picture tells to half a per cent; so the evidence of many pairs comes together.
"""

from dataclasses import dataclass
from functools import cached_property

from mv_slapse.geometry.rotation import norm
from mv_slapse.kernels.binding import compiled
from mv_slapse.motion.observations import Depths
import numpy as np

STEP = 0.04  # of log(height): half of what one block tells at best
LEAST, MOST = 0.05, 50.0  # [baseline]: a robot's camera at full speed, a lorry's that creeps
GRID = np.arange(np.log(LEAST), np.log(MOST), STEP)
DRIFT = 0.01  # random walk of log(height) from pair to pair: slope and load
LEAK = 1e-5  # probability that the road has ended and all is as new
BIAS = 0.03  # by which all log(height) err alike: encoders pull vectors to zero, as measured
SURE = 0.07  # standard deviation of log(height) of one that is known; at 0.1 some were wrong
KNOWN = 0.1  # and beyond which it contradicts none
LEAST_PARALLAX = 4.0  # px: shorter vectors may have been pulled to zero

# What the kernel goes by. Wrong vectors that lie far off the epipolar line are known, and they
# point anywhere: as many of each length pass for right as chance turns to the line.
POLICY = {
    'relief': 0.04,  # error that the road's height has at one block: crown, ruts
    'blurred': 0.5,  # deviation of a block's depth, as a share: beyond it tells nothing
    'gate': 2.0,  # sigma of the epipolar error of a block that may be right
    'isotropy': 0.25,  # of log(length): width by which the lengths of wrong vectors are smoothed
    # Least and largest share of right vectors that a pair is believed to hold.
    'right_least': 0.03, 'right_most': 0.6,
    # An encoder goes on with the last vector over smooth ground: what lies nearer to each other
    # than three macroblocks [px] errs together, and so many places tell as much as one.
    'apart': 48.0, 'sites': 2.0,
    'asked': 100,  # of more blocks than that every second, third and so on is asked
}


@dataclass(frozen=True)
class RoadBlocks:
    """Blocks, right ones and wrong ones, and where among them the ground may be."""

    depths: Depths  # of N blocks
    drop: np.ndarray  # (N,): what each ray falls on the way of one unit
    error: np.ndarray  # (N,): epipolar error, in standard deviations
    sigma: np.ndarray  # (N,): standard deviation of a coordinate [px]
    parallax: np.ndarray  # (N,): length of the motion that no rotation explains [px]
    on_way: np.ndarray  # (N,) bool: blocks where the ground may be


@dataclass(frozen=True)
class HeightBelief:
    """Probability of the logarithm of the height [baseline], on GRID; it sums to 1."""

    probability: np.ndarray

    @classmethod
    def blank(cls) -> 'HeightBelief':
        """Return what is known at first: nothing."""
        return cls(np.full(len(GRID), 1 / len(GRID)))

    @cached_property
    def log(self) -> float:
        """Return the mean of log(height)."""
        return float(self.probability @ GRID)

    @cached_property
    def spread(self) -> float:
        """Return the standard deviation of log(height)."""
        return float(np.sqrt(self.probability @ np.square(GRID - self.log) + STEP**2 / 12))

    def allows(self, plane: np.ndarray) -> bool:
        """Tell whether a plane (3,) may be the ground, as far as the height is known.

        Where a road moves fast most of its vectors are wrong, and one pair's ground errs by 10 to
        20 % where what many pairs show errs by 3 to 5 (KITTI at five pictures a second). In a turn
        the road's vectors lag behind all alike, and hundreds of blocks agree on 20 %.
        """
        spread = np.hypot(self.spread, BIAS)
        return spread > KNOWN or abs(np.log(norm(plane)) + self.log) < 3 * spread

    def moved(self, log_ratio: float, sigma: float) -> 'HeightBelief':
        """Return it in the next baseline, which is exp(log_ratio) of this one."""
        width = min(float(np.hypot(sigma, DRIFT)), 3.0)
        return HeightBelief(compiled.move_height(self.probability, log_ratio / STEP,
                                                 width / STEP, LEAK))

    def seen(self, blocks: RoadBlocks, tilt: float, parallax: float,
             ceiling: float) -> 'HeightBelief':
        """Return it after a pair.

        ``tilt`` is the standard deviation of the ground's direction [rad], ``parallax`` the median
        of the scene's [px], as what is nearest moves more, ``ceiling`` the largest height
        [baseline].
        """
        rays, rho, sigma, x = blocks.depths.columns
        probability = compiled.see_height(
            self.probability, GRID, rho, sigma, x, blocks.drop, blocks.error, blocks.sigma,
            blocks.parallax, blocks.on_way, tilt, max(LEAST_PARALLAX, parallax), ceiling, POLICY)
        return self if probability is None else HeightBelief(probability)
