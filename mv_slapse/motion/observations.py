"""What each macroblock says of itself once the camera's motion is known, [MVO] 4.2."""

from dataclasses import dataclass, fields

from mv_slapse.geometry import epipolar, two_view
from mv_slapse.motion.estimate import MotionFit
import numpy as np

TURNING_SHARE = 0.15  # of blocks off a rotation: below, the camera turns on the spot
TURNING_PARALLAX = 3.0  # of epsilon_m, in the median: beyond, the camera moves in any case


@dataclass(frozen=True)
class Evidence:
    """Constraints of Definition 1 of [MVO], as values and masks over the correspondences.

    Attributes
    ----------
    epipolar_error : (N,) array
        In standard deviations.
    epipolar_inlier : (N,) bool array
        (3).
    rho, sigma_rho, blur : (N,) arrays
        Inverse depth, its standard deviation, and the part of it that vectors make [1/baseline].
    parallax : (N,) array
        ||x'_prev - x_cur||, [px].
    at_infinity : (N,) bool array
        (7): too little parallax for a depth.
    backward : (N,) bool array
        The direction constraint fails: the block moves against the stationary flow.
    """

    epipolar_error: np.ndarray
    epipolar_inlier: np.ndarray
    rho: np.ndarray
    sigma_rho: np.ndarray
    blur: np.ndarray
    parallax: np.ndarray
    at_infinity: np.ndarray
    backward: np.ndarray

    def __getitem__(self, rows) -> 'Evidence':
        """Return that of a mask or an index."""
        return Evidence(*(getattr(self, item.name)[rows] for item in fields(self)))


def before_camera(rays_cur, rays_prev, focal, R, t) -> np.ndarray:
    """Return True where a block's motion puts it before the camera, (N,).

    The vote of [MVO] 4.2 (alpha < 90 degrees for a camera that moves forward, >= 90 for one that
    moves backward), cast on the sign of (t_xy - x'_prev t_z) . (x_cur - x'_prev): the epipole
    e = t_xy / t_z is kept homogeneous, so that a camera moving sideways has a vote too.
    """
    y = epipolar.derotate(rays_prev, R)[:, :2]
    outward = (t[:2] - y * t[2]) * focal
    return np.einsum('ij,ij->i', outward, (rays_cur[:, :2] - y) * focal) > 0


def orient(pair: two_view.Pair, R, t) -> tuple[np.ndarray, bool]:
    """Return the translation with the sign that puts most points before the camera.

    The majority vote of [MVO] 4.2, each block counting by its parallax in standard deviations:
    a far block's direction is noise. Also returns whether the camera moves forward.
    """
    if behind(pair, R, t) > 0.5:
        t = -t
    return t, bool(t[2] < 0)


def behind(pair: two_view.Pair, R, t) -> float:
    """Return the share of the votes of `orient` that put a block behind the camera."""
    vote = before_camera(pair.rays_cur, pair.rays_prev, pair.focal, R, t)
    length = np.linalg.norm(epipolar.parallax(pair.rays_cur, pair.rays_prev, pair.focal, R),
                            axis=1)
    weight = np.minimum(length / pair.sigma, 10.0)
    return float(weight[~vote].sum() / max(weight.sum(), 1e-9))


def may_turn(evidence: Evidence, epsilon_m: float) -> bool:
    """Tell whether a pair shows so little parallax that the camera may have turned on the spot.

    Some translation passes for a part of a turn: up to twice ``epsilon_m`` [px] of parallax, alike
    everywhere, were measured.
    """
    parallax = evidence.parallax[evidence.epipolar_inlier]
    return bool(np.median(parallax) < TURNING_PARALLAX * epsilon_m) if len(parallax) else False


def turns_only(off: np.ndarray, epsilon_m: float) -> bool:
    """Tell whether a rotation explains a pair: next to no block is ``off`` (N,) [px] from it.

    Of a camera that moves by 5 cm, 22 % of the blocks or more are off by twice ``epsilon_m`` [px]
    on every stream that was measured; of one that turns on the spot up to 10 %.
    """
    return bool(np.mean(off > 2 * epsilon_m) < TURNING_SHARE)


def evidence(pair: two_view.Pair, fit: MotionFit, epsilon_f: float, epsilon_m: float,
             relief: float) -> Evidence:
    """Judge each correspondence under a camera motion.

    Parameters
    ----------
    pair : Pair
    fit : MotionFit
        Oriented motion.
    epsilon_f : float
        Largest epipolar error of an inlier in standard deviations, (3).
    epsilon_m : float
        Smallest parallax of a block not at infinity [px], (7).
    relief : float
        Depth of a surface about its plane, as a share of depth.
    """
    R, t, focal = fit.R_cur_from_prev, fit.t_cur_from_prev, pair.focal
    error = epipolar.epipolar_error(pair.rays_cur, pair.rays_prev, focal, R, t) / pair.sigma
    rho, per_pixel = epipolar.inverse_depth(pair.rays_cur, pair.rays_prev, focal, R, t)
    blur = per_pixel * pair.sigma
    parallax = np.linalg.norm(epipolar.parallax(pair.rays_cur, pair.rays_prev, focal, R), axis=1)
    inlier = np.abs(error) < epsilon_f
    return Evidence(error, inlier, rho, np.hypot(blur, relief * rho), blur, parallax,
                    inlier & (parallax < epsilon_m),
                    inlier & (parallax >= epsilon_m) & (rho < -3 * blur))
