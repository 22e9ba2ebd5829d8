"""Depths of what stands still, kept from pair to pair: by them each motion has a length.

Two views know the direction of their baseline only. Where its length is a chain of ratios of
neighbouring pairs, a stop, a hover or a quick yaw breaks it. The map is carried to the newest
camera instead, with what is out of view, and nothing of it is forgotten at rest: each pair is
fitted to it in six degrees of freedom. Depths are filtered as in semi-dense visual odometry
(Engel, Sturm, Cremers, ICCV 2013).
"""

from dataclasses import dataclass, field
import math
from typing import NamedTuple

from mv_slapse.changed import replace
from mv_slapse.geometry import rotation, two_view
from mv_slapse.kernels.binding import compiled
from mv_slapse.motion.estimate import MotionFit
from mv_slapse.motion.observations import Depths
import numpy as np

# Of the kernel [sigma] in each step; the second judges the starts.
WIDTHS = np.array((8.0, 4.0) + 6 * (2.5,))
SURE_START = 0.3  # error of a pair's own depth, as a share, with which it tells a first length
LEAST_KNOWN = 20  # blocks with a depth; fewer cannot tell a length from their outliers

POLICY = {
    # Interpolation between points: largest difference from the three nearest, as a share; width of
    # the weight [px]; roughness of a surface, as a share; most that the slope may change a depth.
    'same_surface': 0.25, 'spread': 12.0, 'roughness': 0.1, 'slack': 0.3,
    'relief': 0.02,  # of a surface between points, as a share of depth
    # Standard deviation of an inverse depth that the map does not know, over the usual one: none.
    # What comes into view at the sides is nearer than usual; held to be usual within 100 %, its
    # hundreds of blocks make each way longer, by .04 to .2 % a pair where a lens is distorted.
    'weak': 100.0,
    # A pair's depths are joined with the map's: share by which interpolation errs, and share of
    # the variance of a depth that it has in common with those before: vectors in a row err alike.
    'drift': 0.02, 'alike': 0.7,
    'inflation': 0.005,  # share by which depths become less sure in each pair
    'epsilon': 3.0,  # [sigma] of the epipolar error, beyond which a block tells no depth
    'gate': 9.0,  # squared, 3 sigma: beyond, a depth contradicts the map
    'least_gain': 0.15, 'sure': 0.2,  # of a depth that a pair knows to that share
    'doubt': 4.0,  # growth of the variance of what is contradicted, until it is replaced
    'first_relief': 0.03,  # share by which a first depth errs beside its vector
    'most': 4000}  # points in all
# A pair that turns has next to no parallax: by noise alone its way shrinks and the map with it,
# unless what is not known is held to be as far as usual.
TURNING = POLICY | {'weak': 1.0}


@dataclass(frozen=True)
class BaselineRatio:
    """log(|t_k| / |t| of the last pair that had a baseline), standard deviation; inf: unknown."""

    log: float = 0.0
    sigma: float = float('inf')


class MapMotion(NamedTuple):
    """A pair's motion against the map, X_cur = R X_prev + t."""

    R: np.ndarray  # (3, 3)
    t: np.ndarray  # (3,) [map unit]
    covariance: np.ndarray  # (6, 6): of (w, t / |t|), R -> exp(w) R
    sigma: float  # standard deviation of log |t|

    @property
    def length(self) -> float:
        """Return |t| [map unit]."""
        return math.hypot(*self.t)


@dataclass(frozen=True)
class BlockMap:
    """Points that stand still, in the newest camera."""

    # (M, 5): unit ray, inverse distance [1/map unit], its variance
    points: np.ndarray = field(default_factory=lambda: np.zeros((0, 5)))
    stamp: int | None = None  # of the key frame [ns]; None before the first
    length: float = 0.0  # of the last baseline [map unit]; 0 before the first
    # (3, 3), (3,): R_cur_from_prev of the last pair, t_cur_from_prev over its time [map unit/s]
    R: np.ndarray = field(default_factory=lambda: np.eye(3))
    velocity: np.ndarray = field(default_factory=lambda: np.zeros(3))
    span: int = 0  # that time [ns]

    def at(self, stamp: int) -> 'BlockMap':
        """Return it for a pair whose earlier key frame has a stamp; a new one after a gap."""
        return self if self.stamp == stamp else BlockMap(stamp=stamp)

    def known(self, pair: two_view.Pair, size: tuple[int, int]) -> np.ndarray:
        """Return what is known of a pair's blocks in camera k-1 (N, 3).

        Columns: inverse depth, interpolated on planes; its variance, infinite where it is unknown;
        inverse depth of what lies around, which does not err with it.
        """
        return compiled.map_at(self.points, pair.x_prev, pair.K, np.array(size, np.int64), POLICY)

    def measured(self, pair: two_view.Pair, known: np.ndarray, fit: MotionFit, stamp: int):
        """Return the motion of a pair up to a stamp [ns], its length, its ratio to the last one.

        Where the map does not tell these, the pair's own motion and the usual length [map unit].
        """
        way = self.moving(pair, known, fit, 1e-9 * (stamp - self.stamp))
        length = way.length if way else 0.0
        if not length:
            return fit, self.usual(stamp), BaselineRatio()
        fit = replace(fit, R_cur_from_prev=way.R, t_cur_from_prev=way.t / length,
                      covariance=way.covariance)
        ratio = (BaselineRatio(math.log(length / self.length), way.sigma)
                 if self.length else BaselineRatio())
        return fit, length, ratio

    def moving(self, pair: two_view.Pair, known: np.ndarray, fit: MotionFit,
               dt: float) -> MapMotion | None:
        """Return the motion of a pair against the map, None where it knows too little of it.

        Starts from the pair's own motion, at the length that the map's depths tell and at that of
        the last pair, and from the last motion, over ``dt`` [s].
        """
        R, t, way = fit.R_cur_from_prev, fit.t_cur_from_prev, self.velocity * dt
        n_sure, length = compiled.told_length(columns(pair), known, R, t, SURE_START)
        if n_sure < LEAST_KNOWN:
            return None
        return _fitted(pair, known, [(R, length * t), (R, math.hypot(*way) * t),
                                     (R, way), (self._turn(dt), way)], POLICY)

    def turning(self, pair: two_view.Pair, known: np.ndarray, R: np.ndarray) -> MapMotion | None:
        """Return the little motion of a camera that seems to turn on the spot by R (3, 3)."""
        if np.count_nonzero(np.isfinite(known[:, 1])) < LEAST_KNOWN:
            return None
        return _fitted(pair, known, [(R, np.zeros(3))], TURNING)

    def joined(self, pair: two_view.Pair, known: np.ndarray, fit: MotionFit, length: float,
               depths: Depths) -> Depths:
        """Return a pair's depths (N,) with what the map knew of them, unless it contradicts.

        ``fit`` is the pair's motion, ``length`` its baseline [map unit].
        """
        rho, sigma = compiled.join_map(depths.rho, depths.sigma, known, pair.rays_prev,
                                       fit.R_cur_from_prev, length * fit.t_cur_from_prev, POLICY)
        return replace(depths, rho=rho, sigma=sigma)

    def moved(self, stamp: int, motion: tuple, pair: two_view.Pair, known: np.ndarray,
              size: tuple[int, int]) -> 'BlockMap':
        """Return it in camera k at a stamp, with what a pair's blocks tell.

        ``motion`` is (R_cur_from_prev, t_cur_from_prev) [map unit].
        """
        R, t = motion
        points = compiled.fuse_map(
            self.points, columns(pair), known, np.concatenate((R.ravel(), t)),
            (pair.K, np.array(size, np.int64)), POLICY)
        span = max(stamp - self.stamp, 1)
        return replace(self, points=points, stamp=stamp, R=R, velocity=1e9 * t / span, span=span)

    def rested(self, stamp: int) -> 'BlockMap':
        """Return it after a pair of a camera that stands still."""
        return replace(self, stamp=stamp, R=np.eye(3), velocity=np.zeros(3), span=0)

    def coasted(self, stamp: int, K: np.ndarray, size: tuple[int, int]) -> 'BlockMap':
        """Return it after a pair that shows no motion: the last one goes on."""
        dt = 1e-9 * (stamp - self.stamp)
        none = np.zeros((0, 3))
        nothing = two_view.Pair(none, none, np.zeros((0, 2)), np.zeros(0), K)
        return self.moved(stamp, (self._turn(dt), dt * self.velocity), nothing, none, size)

    def _turn(self, dt: float) -> np.ndarray:
        """Return R_cur_from_prev (3, 3) of a pair of ``dt`` [s] that turns as the last one."""
        share = 1e9 * dt / self.span if self.span else 1.0
        return self.R if share == 1 else rotation.exp(share * rotation.log(self.R))

    def usual(self, stamp: int) -> float:
        """Return the length of a baseline at an unchanged speed [map unit], 1 if none is known."""
        way = 1e-9 * (stamp - self.stamp) * rotation.norm(self.velocity)
        return way or self.length or 1.0


def _fitted(pair, known, starts, policy) -> MapMotion:
    """Return the motion from the best of some starts (R, t)."""
    rows = np.array([R.ravel().tolist() + t.tolist() for R, t in starts])
    R, t, _, covariance, told, _ = compiled.fit_to_map(columns(pair), known, rows, WIDTHS, policy)
    return MapMotion(R, t, covariance, 1 / math.sqrt(max(told, 1e-12)))


def columns(pair: two_view.Pair) -> tuple:
    """Return a pair as the kernels take it."""
    return pair.rays_cur, pair.rays_prev, pair.sigma, pair.focal
