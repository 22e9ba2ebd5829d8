"""What each block says of itself once the camera's motion is known, [MVO] 4.2."""

from dataclasses import dataclass, fields

from mv_slapse.geometry import two_view
from mv_slapse.kernels.binding import compiled
from mv_slapse.motion.estimate import MotionFit
import numpy as np

TURNING_SHARE = 0.15  # of blocks off a rotation: below, the camera turns on the spot
TURNING_PARALLAX = 3.0  # of epsilon_m, in the median: beyond, the camera moves in any case


@dataclass(frozen=True)
class BlockObservations:
    """The blocks of a pair under one motion, computed once and handed from step to step.

    Constraints of Definition 1 of [MVO], as values and masks.
    """

    pair: two_view.Pair  # rays, matches and their standard deviations
    epipolar_error: np.ndarray  # (N,): in standard deviations
    rho: np.ndarray  # (N,): inverse depth [1/baseline]
    sigma_rho: np.ndarray  # (N,): its standard deviation [1/baseline]
    blur: np.ndarray  # (N,): the part of it that vectors make [1/baseline]
    # (N,): ||x'_prev - x_cur||, what is left of the vector without the rotation, (6) [px]
    parallax: np.ndarray
    epipolar_inlier: np.ndarray  # (N,) bool: (3)
    at_infinity: np.ndarray  # (N,) bool: (7), too little parallax for a depth
    # (N,) bool: the direction constraint fails: the block moves against the stationary flow
    backward: np.ndarray
    # (N,) bool: none of this: the parallax of what stands still before the camera
    has_depth: np.ndarray

    def __getitem__(self, rows) -> 'BlockObservations':
        """Return those of a mask or an index."""
        rows = two_view.numbers(rows, len(self.rho))
        columns = tuple(getattr(self, name) for name in COLUMNS)
        return BlockObservations(self.pair[rows], *compiled.take_rows(columns, rows))


COLUMNS = tuple(item.name for item in fields(BlockObservations))[1:]


@dataclass(frozen=True)
class Depths:
    """Inverse depths of blocks: rays (N, 3), rho (N,), sigma (N,) [1/baseline], x (N, 2) [px]."""

    rays: np.ndarray
    rho: np.ndarray
    sigma: np.ndarray
    x: np.ndarray

    def __getitem__(self, mask) -> 'Depths':
        """Return those of a mask or an index."""
        return Depths(self.rays[mask], self.rho[mask], self.sigma[mask], self.x[mask])

    def __len__(self) -> int:
        """Return their number."""
        return len(self.rho)

    @property
    def columns(self) -> tuple[np.ndarray, ...]:
        """Return rays, rho, sigma and pixels as kernels take them."""
        return self.rays, self.rho, self.sigma, np.ascontiguousarray(self.x, float)


def may_turn(parallax: np.ndarray, epsilon_m: float) -> bool:
    """Tell whether a pair shows so little parallax that the camera may have turned on the spot.

    That of the inliers counts, (N,) [px]. Some translation passes for a part of a turn: up to
    twice ``epsilon_m`` [px], alike everywhere, were measured.
    """
    # Half of them below the bound is what the median tells, without a sort.
    return np.count_nonzero(parallax < TURNING_PARALLAX * epsilon_m) > len(parallax) / 2


def turns_only(off: np.ndarray, rho: np.ndarray, epsilon_m: float) -> bool:
    """Tell whether a rotation explains a pair: next to no block is ``off`` (N,) [px] from it.

    Of a camera that moves by 5 cm, 22 % of the blocks or more are off by twice ``epsilon_m`` [px]
    on every stream that was measured; of one that turns on the spot up to 10 %. In little light it
    is up to 40 %: vectors are wrong there, and put as many blocks behind the camera, by their
    inverse depths ``rho`` (N,), as before it. Such pairs cancel out.
    """
    return bool(np.mean((off > 2 * epsilon_m) * np.sign(rho)) < TURNING_SHARE)


def observe(pair: two_view.Pair, fit: MotionFit, epsilon_f: float, epsilon_m: float,
            relief: float) -> BlockObservations:
    """Judge each correspondence under a camera motion.

    Limits are the largest epipolar error of an inlier [sigma], (3), the smallest parallax of a
    block not at infinity [px], (7), and the depth of a surface about its plane, a share of depth.
    """
    return BlockObservations(pair, *compiled.observe_blocks(
        *two_view.columns(pair, fit.R_cur_from_prev, fit.t_cur_from_prev),
        np.array([epsilon_f, epsilon_m, relief])))
