"""What stood still a while ago, where it must be now: by this a parked car shows that it starts.

For a second a car that starts looks like one that stands farther off, and depths that follow new
vectors follow it. Those of a while ago, carried on by the camera's motion alone, do not: what is
farther now than all that was seen there has departed.
"""

from dataclasses import dataclass, field
from typing import NamedTuple

from mv_slapse.geometry.two_view import MAX_SPREAD, Pair
from mv_slapse.kernels.binding import compiled
from mv_slapse.motion.observations import BlockObservations, Depths
from mv_slapse.records import Extraction
import numpy as np


class Rules(NamedTuple):
    """Constants of departures."""

    youngest: float = 3e8  # [ns] a car has gone 0.1 m then, and 0.8 m
    oldest: int = 700_000_000  # [ns] then; older depths err by more
    well_known: float = MAX_SPREAD
    least_seen: float = 3.0  # of nine macroblocks, or an edge could be missed
    farther: float = 0.06  # log of the depth: what motion and common errors of vectors make of it,
    sigmas: float = 2.0  # and as many standard deviations of the block's own
    away: float = 0.4  # of the same: 5 m before the camera a car may gain as much; more is wrong
    stood: float = 0.8  # of the ground's inverse depth and more where a vehicle was
    least_left: float = 4.0  # of nine macroblocks: what departs is a body, not scattered vectors
    leaving: float = 0.75  # share of departed blocks of a car that starts: 0.7 to 1 as measured,
    straying: float = 0.005  # of what stands,
    at_edges: float = 0.05  # and of that where not all around was nearer: 5 to 8 % of lone blocks


RULES = Rules()


@dataclass(frozen=True)
class Past:
    """Points that stood still in the last key frames."""

    # (N,) int: when they were seen [ns]
    stamp: np.ndarray = field(default_factory=lambda: np.zeros(0, int))
    # (N, 3): in the camera of the last key frame [baseline of its pair]
    X: np.ndarray = field(default_factory=lambda: np.zeros((0, 3)))

    def carried(self, stamp: int, R: np.ndarray, t: np.ndarray, log_ratio: float) -> 'Past':
        """Return it in the camera of the next key frame at ``stamp`` [ns], without what is old.

        X_cur = R X_prev + t, |t| = 1 = exp(log_ratio) old baselines.
        """
        return Past(*compiled.carry_points(self.stamp, self.X, stamp, RULES.oldest, R, t,
                                           float(np.exp(-log_ratio))))

    def noted(self, stamp: int, depths: Depths) -> 'Past':
        """Return it with the depths that stand still in the key frame at ``stamp`` [ns]."""
        return Past(*compiled.note_points(self.stamp, self.X, stamp, depths.rays, depths.rho,
                                          depths.sigma, MAX_SPREAD))


def depths_of(pair: Pair, extraction: Extraction, evidence: BlockObservations, known) -> Depths:
    """Return what a pair's vectors alone tell of the depths of its blocks, 0 of those not known.

    ``known`` is (N,) bool.
    """
    return Depths(pair.rays_cur, np.where(known, evidence.rho, 0.0), evidence.blur,
                  extraction.x_cur.astype(float))


def departure(past: Past, extraction: Extraction, depths: Depths,
              ground: np.ndarray | None = None) -> np.ndarray:
    """Return how much rather blocks (N,) have left where they stood than not, log-likelihoods.

    Positive: a block is farther than all that stood there a while ago. 0: nothing is known.
    ``past`` is carried to the extraction's key frame; ``depths`` are those of its blocks, as if
    they stood still [1/baseline]; 0 where that is unknown. No vehicle stood below the ``ground``
    (3,).
    """
    return compiled.departures(past, depths, np.zeros(3) if ground is None else ground,
                               extraction.K, extraction.stamp, extraction.width,
                               extraction.height, RULES)
