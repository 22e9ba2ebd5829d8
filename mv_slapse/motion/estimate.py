"""Camera motion of a key frame pair from its correspondences, [MVO] 4.1."""

from dataclasses import dataclass

import cv2
from mv_slapse.geometry import rotation, two_view
from mv_slapse.kernels.binding import compiled
import numpy as np

MIN_CORRESPONDENCES = 12  # 5 unknowns need 5; below about twice that no inlier can be told
# Of the kernel [sigma] in each step: a wide one finds the support from a poor start, the last one
# settles. Steps become short where most vectors are wrong: up to 30 were needed.
WIDTHS = np.array((8.0, 4.0) + 38 * (2.0,))
SETTLED = 0.3  # fall of the sum of robust costs, of one for each block, that ends it


@dataclass(frozen=True)
class MotionFit:
    """A motion with unit translation, its support and its covariance (6, 6) of (w, direction).

    ``behind``: share of the blocks, weighed by their parallax, that it puts behind the camera.
    """

    R_cur_from_prev: np.ndarray
    t_cur_from_prev: np.ndarray
    covariance: np.ndarray
    cost: float
    behind: float = 0.0


def from_essential_matrix(rays_cur, rays_prev, threshold, confidence=0.999):
    """Return motions (R, t) of the best essential matrix, five points under USAC-MAGSAC.

    Of rays (N, 3); ``threshold`` is the largest error of an inlier in their units (px / focal
    length). R_cur_from_prev (3, 3) and unit t_cur_from_prev (3,); none where no model was found.
    """
    E, _ = cv2.findEssentialMat(
        rays_prev[:, :2].copy(), rays_cur[:, :2].copy(), np.eye(3), method=cv2.USAC_MAGSAC,
        prob=confidence, threshold=threshold)
    if E is None or E.shape[0] < 3 or not np.all(np.isfinite(E)):
        return []
    R1, R2, t = cv2.decomposeEssentialMat(E[:3])
    R = min((R1, R2), key=rotation.angle)
    return [(R, t[:, 0]), (R, -t[:, 0])]


def refined_from(pair: two_view.Pair, R, t) -> MotionFit:
    """Minimise the Sampson error over rotation and direction, (5) of [MVO], from a start.

    The direction gets the sign that puts most blocks before the camera, the majority vote of [MVO]
    4.2, each counting by its parallax in standard deviations: a far block's is noise.

    Levenberg-Marquardt over five unknowns with the analytic Jacobian and a Geman-McClure kernel
    whose width shrinks to ``2 sigma``, so that a poor start R (3, 3), unit t (3,) still finds its
    support.
    """
    return MotionFit(*compiled.refine_motion(*two_view.columns(pair, R, t), WIDTHS, SETTLED))


def turn(pair: two_view.Pair, R, steps: int = 6):
    """Fit a rotation without any translation, from a start R (3, 3).

    Returns R_cur_from_prev, its covariance (6, 6) as in MotionFit, zero for the direction, which
    there is none of, and how far (N,) each match is from where the rotation puts it [sigma].
    """
    *view, _ = two_view.columns(pair, R, np.zeros(3))
    R, information, off = compiled.fit_turn(*view, steps)
    covariance = np.zeros((6, 6))
    covariance[:3, :3] = np.linalg.inv(information)
    return R, covariance, off


def calibrated(pair: two_view.Pair, fit: MotionFit, noise: float) -> float:
    """Return the scale of sigma that the errors of this pair show.

    The scale is the median epipolar error of the blocks within three sigma, over the median of
    a Gaussian cut there: wrong vectors do not count. ``noise`` is that of the pair before,
    by which it is told what lies within three sigma, and the answer where too few blocks do.
    """
    return compiled.noise_scale(*two_view.columns(pair, fit.R_cur_from_prev, fit.t_cur_from_prev),
                                noise, MIN_CORRESPONDENCES)
