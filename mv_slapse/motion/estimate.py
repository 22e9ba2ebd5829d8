"""Camera motion of a key frame pair from its correspondences, [MVO] 4.1."""

from dataclasses import dataclass

import cv2
from mv_slapse.geometry import epipolar, rotation, two_view
import numpy as np

MIN_CORRESPONDENCES = 12  # 5 unknowns need 5; below about twice that no inlier can be told
# Of the kernel [sigma] in each step: a wide one finds the support from a poor start, the last one
# settles. Steps become short where most vectors are wrong: up to 30 were needed.
WIDTHS = (8.0, 4.0) + 38 * (2.0,)
SETTLED = 0.3  # fall of the sum of robust costs, of one for each block, that ends it


@dataclass(frozen=True)
class MotionFit:
    """A motion with unit translation, its support and its covariance (6, 6) of (w, direction)."""

    R_cur_from_prev: np.ndarray
    t_cur_from_prev: np.ndarray
    covariance: np.ndarray
    cost: float


def robust_weight(error: np.ndarray, sigma: np.ndarray) -> np.ndarray:
    """Weight of a Geman-McClure kernel, (1 + (e / s)^2)^-2: a far error counts nothing."""
    return 1 / np.square(1 + np.square(error / sigma))


def robust_cost(error: np.ndarray, sigma: np.ndarray) -> float:
    """Mean Geman-McClure cost, between 0 (all agree) and 1 (none does)."""
    e2 = np.square(error / sigma)
    return float(np.mean(e2 / (1 + e2)))


def from_essential_matrix(rays_cur, rays_prev, threshold, confidence=0.999):
    """Return motions (R, t) of the best essential matrix, five points under USAC-MAGSAC.

    Parameters
    ----------
    rays_cur, rays_prev : (N, 3) arrays
    threshold : float
        Largest error of an inlier, in ray units (px / focal length).

    Returns
    -------
    motions : list of (R (3, 3), t (3,))
        R_cur_from_prev and unit t_cur_from_prev; empty where no model was found.
    """
    E, _ = cv2.findEssentialMat(
        rays_prev[:, :2].copy(), rays_cur[:, :2].copy(), np.eye(3), method=cv2.USAC_MAGSAC,
        prob=confidence, threshold=threshold)
    if E is None or E.shape[0] < 3 or not np.all(np.isfinite(E)):
        return []
    R1, R2, t = cv2.decomposeEssentialMat(E[:3])
    R = min((R1, R2), key=rotation.angle)
    return [(R, t[:, 0]), (R, -t[:, 0])]


def refine(rays_cur, rays_prev, sigma, focal, R, t) -> MotionFit:
    """Minimise the Sampson error over rotation and direction, (5) of [MVO].

    Levenberg-Marquardt over five unknowns with the analytic Jacobian and a Geman-McClure kernel
    whose width shrinks to ``sigma``, so that a poor start still finds its support.

    Parameters
    ----------
    rays_cur, rays_prev : (N, 3) arrays
    sigma : (N,) array
        Standard deviation of a coordinate of x_prev [px].
    focal : (2,) array
        fx, fy [px].
    R, t : (3, 3), (3,) arrays
        Start; t is a unit vector.
    """
    damping = 1e-6
    for width in WIDTHS:
        error, J, basis = _error(rays_cur, rays_prev, focal, R, t)
        weight = robust_weight(error, width * sigma) / sigma**2
        A = J.T @ (weight[:, None] * J)
        b = -J.T @ (weight * error)
        before = robust_cost(error, width * sigma)
        R, t, cost, damping = _damped_step(rays_cur, rays_prev, focal, R, t, basis, A, b,
                                           width * sigma, before, damping)
        if width == WIDTHS[-1] and (before - cost) * len(error) < SETTLED:
            break
    error, J, basis = _error(rays_cur, rays_prev, focal, R, t)
    weight = robust_weight(error, 2 * sigma)
    scale = max(1.0, float(np.sum(weight * np.square(error / sigma)) / max(weight.sum() - 5, 1)))
    information = J.T @ ((weight / sigma**2)[:, None] * J) / scale
    lift = np.zeros((6, 5))
    lift[:3, :3], lift[3:, 3:] = np.eye(3), basis
    covariance = lift @ np.linalg.pinv(information, hermitian=True) @ lift.T
    return MotionFit(R, t, covariance, robust_cost(error, 2 * sigma))


def refined_from(pair: two_view.Pair, R, t) -> MotionFit:
    """Refine a motion of a pair from a start."""
    return refine(pair.rays_cur, pair.rays_prev, pair.sigma, pair.focal, R, t)


def turn(rays_cur, rays_prev, sigma, focal, R, steps=6):
    """Fit a rotation without any translation; arguments as in refine.

    Returns
    -------
    R_cur_from_prev : (3, 3) array
    covariance : (6, 6) array
        As in MotionFit, zero for the direction, which there is none of.
    off : (N,) array
        Distance of each match from where the rotation puts it, in standard deviations.
    """
    for width in np.maximum(8.0 * 0.5 ** np.arange(steps), 2.0):
        y = rays_prev @ R.T
        image = y[:, :2] / y[:, 2:]
        error = (image - rays_cur[:, :2]) * focal
        off = np.linalg.norm(error, axis=1) / sigma
        # dy = w x y, and the image's change follows by the quotient rule.
        by_y = np.zeros((len(y), 2, 3))
        by_y[:, 0, 0], by_y[:, 1, 1] = focal
        by_y[:, :, 2] = -image * focal
        J = rotation.cross(y[:, None], by_y / y[:, 2:, None])
        weight = robust_weight(off, width) / sigma**2
        A = np.einsum('nia,n,nib->ab', J, weight, J)
        R = rotation.exp(-np.linalg.solve(A, np.einsum('nia,n,ni->a', J, weight, error))) @ R
    covariance = np.zeros((6, 6))
    covariance[:3, :3] = np.linalg.inv(A)
    return R, covariance, off


def _error(rays_cur, rays_prev, focal, R, t):
    """Epipolar error, its derivative (N, 5) by (w, two tangents of t), and these tangents."""
    basis = rotation.tangent_basis(t)
    error, J = epipolar.epipolar_jacobian(rays_cur, rays_prev, focal, R, t)
    return error, np.c_[J[:, :3], J[:, 3:] @ basis], basis


def _damped_step(rays_cur, rays_prev, focal, R, t, basis, A, b, sigma, cost, damping):
    """Take the Levenberg-Marquardt step that lowers the robust cost, if one of four does."""
    for _ in range(4):
        step = np.linalg.solve(A + damping * np.diag(np.diag(A) + 1e-9), b)
        R_new = rotation.exp(step[:3]) @ R
        t_new = t + basis @ step[3:]
        t_new /= np.linalg.norm(t_new)
        new = robust_cost(epipolar.epipolar_error(rays_cur, rays_prev, focal, R_new, t_new), sigma)
        if new <= cost:
            return R_new, t_new, new, damping * 0.3
        damping = max(damping * 30, 1e-4)
    return R, t, cost, damping


def calibrated(pair: two_view.Pair, fit: MotionFit, noise: float):
    """Return the scale of sigma that the errors of this pair show, smoothed over the last pairs.

    The scale is the median epipolar error of the blocks within three sigma, over the median of
    a Gaussian cut there: wrong vectors do not count.
    """
    error = np.abs(epipolar.epipolar_error(pair.rays_cur, pair.rays_prev, pair.focal,
                                           fit.R_cur_from_prev, fit.t_cur_from_prev))
    for _ in range(3):
        ratio = error / (noise * pair.sigma)
        close = ratio < 3
        if close.sum() < MIN_CORRESPONDENCES:
            break
        noise = float(np.clip(noise * np.median(ratio[close]) / 0.6724, 0.3, 4.0))
    return noise
