"""Baselines that depths tell: how their scale passes from pair to pair.

A pair's depths are those of its motion as the extraction found it. Where the parallax is 3 px, a
turn of a tenth of a degree makes all of them a quarter larger or smaller. The baseline is
therefore compared with the depths as the filter's own motion of the pair makes them, and what
the pairs before say of the baseline tells of the turn, too.
"""

from dataclasses import dataclass

from mv_slapse.config import SceneSettings
from mv_slapse.filters import ekf
from mv_slapse.geometry import two_view
from mv_slapse.kernels.binding import compiled
from mv_slapse.records import CameraMotion, Extraction
from mv_slapse.scene.gating import RATIO_GATE
from mv_slapse.scene.observations import Kind, linearised, Observation
from mv_slapse.scene.state import LENGTH, log_baseline, SceneState
import numpy as np

# Of the log of a baseline: beyond, it may as well be none at all. Guessed after a rest it is
# unsure by 1, gauge.UNKNOWN_SCALE: the pairs after it keep to that guess, or each would guess
# anew.
VAGUE = 1.2
# By how much the log of the map's unit drifts while a camera that stays where it is turns by one
# angle of view. Without parallax noise alone tells the depths of what comes into view: over
# rendered spins and hovers of 20 to 40 pairs they were wrong by .1 to .8.
TURNING = 0.22
# Where a height over the ground tells the length, too, by other matter than the depths: measured
# are .2 to .4 % a pair on rendered streets, 1 to 1.3 on kitti00, .8 to 3 behind buses. Where
# nothing but planes does, which err as the depths do, the chain is better than they are.
ABOVE_GROUND = 0.009


@dataclass(frozen=True)
class Depths:
    """The depths of a pair as a whole, and how they would change with its motion."""

    R: np.ndarray  # (3, 3): R_cur_from_prev of the extraction
    t: np.ndarray  # (3,): t_cur_from_prev, |t| = 1
    slope: np.ndarray  # (6,): derivative of the mean log of their inverse by (w, t), R -> exp(w) R
    variance: float  # of that mean by the covariance of the motion


def depths_of(pair: two_view.Pair, motion: CameraMotion, settings: SceneSettings) -> Depths:
    """Return what the stationary blocks of a pair (N,) tell, none more than its relief lets it."""
    R, t = motion.R_cur_from_prev, motion.t_cur_from_prev
    slope = compiled.depth_slope(pair.rays_cur, pair.rays_prev, pair.sigma, pair.focal, R, t,
                                 two_view.MAX_SPREAD, settings.relief)
    slope[3:] -= t * (t @ slope[3:])
    return Depths(R, t, slope, float(slope @ motion.covariance @ slope) * settings.dependence)


def told(state: SceneState, extraction: Extraction, depths: Depths, settings: SceneSettings,
         rested: bool = False, shared: bool = False) -> list[Observation]:
    """Move the scale of the depths by a pair's ratio; return what it tells of the baseline.

    Nothing where the ratio contradicts the prediction: vectors that are wrong in bulk agree in
    depths. The scale moves all the same, for the map of blocks outlasts such a pair, and the next
    one is compared with those before it. After a rest no length is predicted to contradict.

    Known planes in view tell the length by vectors that are ``shared`` with the depths, and how
    far the two err together is not known: the variance then counts twice, as in an intersection
    of covariances with equal weights.
    """
    sigma = float(np.hypot(sampling(extraction, settings), settings.ratio_sigma))
    log = extraction.baseline_ratio
    held = rested or holds(state, log, float(np.sqrt(sigma**2 + depths.variance)))
    move(state, log, settings.ratio_drift)
    return [observed(depths, sigma * np.sqrt(1 + shared))] if held else []


def sampling(extraction: Extraction, settings: SceneSettings) -> float:
    """Return by what share a pair's ratio errs, as its vectors do."""
    return extraction.baseline_ratio_sigma * np.sqrt(settings.depth_dependence)


def baseline(state: SceneState, extraction: Extraction) -> float:
    """Return the length that a pair's ratio to the baseline before tells, 0 if it is unknown."""
    known = np.isfinite(extraction.baseline_ratio_sigma)
    return float(np.exp(state.depth_scale + extraction.baseline_ratio)) if known else 0.0


def holds(state: SceneState, log_ratio: float, sigma: float) -> bool:
    """Tell whether a ratio to the baseline before agrees with the predicted length.

    The state's ``depth_scale`` is that of the pair before; an infinite sigma of the logarithm of
    the ratio is no ratio.
    """
    value, H = log_baseline(state)
    H[state.at('depth_scale')] = -1
    variance = H @ state.error.total @ H + sigma**2
    return bool((value - state.depth_scale - log_ratio)**2 < RATIO_GATE * variance < np.inf)


def observed(depths: Depths, sigma: float) -> Observation:
    """Observe the log of the baseline, by the scale of the depths.

    The depths of the pair before have a common error, which a ratio holds with the opposite sign
    of the next: such errors must not add up. So the scale of the depths is a state, moved by
    the ratio (see move), and the baseline equals it but for the pair's own common error, ``sigma``
    as a share.
    """
    return Observation(Kind.DEPTH_RATIO, sigma,
                       depths=np.concatenate([depths.R.ravel(), depths.t, depths.slope]))


def begin(state: SceneState, depths: Depths, sigma: float) -> bool:
    """Set the scale of the depths to the baseline, which they amount to but for sigma.

    Returns whether the baseline is known well enough for its logarithm to be linear.
    """
    (_, H), at = log_baseline(state), state.at('depth_scale')
    [off], by_state = linearised(observed(depths, sigma), state)
    state.depth_scale += off
    if H @ state.P @ H > VAGUE**2:
        state.error.P[at], state.error.P[:, at], state.error.lasting[at] = 0, 0, 0
        return False
    by_state[:, at] = 0
    ekf.predict_rows(state.error, np.array([at.start]), -by_state, np.eye(1) * sigma**2)
    return True


def doubt(state: SceneState, sigma: float):
    """Make the scale of the depths less sure, by a share."""
    at = state.at('depth_scale')
    state.error.P[at, at] += sigma**2


def doubt_for_good(state: SceneState, sigma: float):
    """Make it less sure by a share of which no plane tells anything.

    Where nothing but the map has told the length, planes err as its depths do, and must not put
    them right: the error lasts then.
    """
    at = state.at('depth_scale')
    before = state.error.lasting[at, LENGTH]  # its sign is that of what it has done to the rest
    state.error.lasting[at, LENGTH] = np.copysign(np.hypot(before, sigma), before)


def turn(state: SceneState, angle: float, metric: bool):
    """Make it less sure after a turn on the spot by an angle [angles of view]."""
    (doubt if metric else doubt_for_good)(state, TURNING * np.sqrt(angle))


def move(state: SceneState, log_ratio: float, sigma: float):
    """Move the scale of the depths by log(|t| now / |t| of the pair before)."""
    state.depth_scale += log_ratio
    doubt(state, sigma)
