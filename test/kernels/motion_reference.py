"""Motion and observations of blocks in numpy: the formulas of their kernels, as reference."""

import formulas
from formulas import derotate
from kernels.two_view_reference import epipolar_jacobian
from mv_slapse.geometry import rotation
from mv_slapse.motion.estimate import MIN_CORRESPONDENCES, MotionFit, SETTLED, WIDTHS
import numpy as np


def robust_weight(error: np.ndarray, sigma: np.ndarray) -> np.ndarray:
    """Weight of a Geman-McClure kernel, (1 + (e / s)^2)^-2: a far error counts nothing."""
    return 1 / np.square(1 + np.square(error / sigma))


def robust_cost(error: np.ndarray, sigma: np.ndarray):
    """Mean Geman-McClure cost, between 0 (all agree) and 1 (none does)."""
    e2 = np.square(error / sigma)
    return float(np.mean(e2 / (1 + e2)))


def refine(rays_cur, rays_prev, sigma, focal, R, t) -> MotionFit:
    """Minimise the Sampson error, as estimate.refined_from does."""
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


def turn(rays_cur, rays_prev, sigma, focal, R, steps=6):
    """Fit a rotation alone, as estimate.turn does."""
    for width in np.maximum(8.0 * 0.5 ** np.arange(steps), 2.0):
        y = rays_prev @ R.T
        image = y[:, :2] / y[:, 2:]
        error = (image - rays_cur[:, :2]) * focal
        off = np.linalg.norm(error, axis=1) / sigma
        # dy = w x y, and the image's change follows by the quotient rule.
        by_y = np.zeros((len(y), 2, 3))
        by_y[:, 0, 0], by_y[:, 1, 1] = focal
        by_y[:, :, 2] = -image * focal
        J = formulas.cross(y[:, None], by_y / y[:, 2:, None])
        weight = robust_weight(off, width) / sigma**2
        A = np.einsum('nia,n,nib->ab', J, weight, J)
        R = rotation.exp(-np.linalg.solve(A, np.einsum('nia,n,ni->a', J, weight, error))) @ R
    covariance = np.zeros((6, 6))
    covariance[:3, :3] = np.linalg.inv(A)
    return R, covariance, off


def _error(rays_cur, rays_prev, focal, R, t):
    """Epipolar error, its derivative (N, 5) by (w, two tangents of t), and these tangents."""
    basis = formulas.tangent_basis(t)
    error, J = epipolar_jacobian(rays_cur, rays_prev, focal, R, t)
    return error, np.c_[J[:, :3], J[:, 3:] @ basis], basis


def _damped_step(rays_cur, rays_prev, focal, R, t, basis, A, b, sigma, cost, damping):
    """Take the Levenberg-Marquardt step that lowers the robust cost, if one of four does."""
    for _ in range(4):
        step = np.linalg.solve(A + damping * np.diag(np.diag(A) + 1e-9), b)
        R_new = rotation.exp(step[:3]) @ R
        t_new = t + basis @ step[3:]
        t_new /= np.linalg.norm(t_new)
        new = robust_cost(epipolar_error(rays_cur, rays_prev, focal, R_new, t_new), sigma)
        if new <= cost:
            return R_new, t_new, new, damping * 0.3
        damping = max(damping * 30, 1e-4)
    return R, t, cost, damping


def calibrated(pair, fit, noise):
    """Return the scale of sigma, as estimate.calibrated does."""
    error = np.abs(epipolar_error(pair.rays_cur, pair.rays_prev, pair.focal,
                                           fit.R_cur_from_prev, fit.t_cur_from_prev))
    for _ in range(3):
        ratio = error / (noise * pair.sigma)
        close = ratio < 3
        if close.sum() < MIN_CORRESPONDENCES:
            break
        noise = float(np.clip(noise * np.median(ratio[close]) / 0.6724, 0.3, 4.0))
    return noise


def epipolar_error(rays_cur, rays_prev, focal, R, t):
    """Signed distance of x_prev from its epipolar line (N,) [px]."""
    line = np.cross(rays_cur, t) @ R
    length = np.hypot(line[:, 0] / focal[0], line[:, 1] / focal[1])
    return np.sum(rays_prev * line, axis=1) / np.maximum(length, 1e-12)


def inverse_depth(rays_cur, rays_prev, focal, R, t):
    """Return the inverse depth (N,) and its change by a pixel along the epipolar line."""
    y = derotate(rays_prev, R)[:, :2]
    g = (t[:2] - y * t[2]) * focal
    length = np.maximum(np.linalg.norm(g, axis=1), 1e-9)
    rho = np.sum((rays_cur[:, :2] - y) * focal * g, axis=1) / length**2
    return rho, np.abs(1 - rho * t[2]) / length


def before_camera(rays_cur, rays_prev, focal, R, t) -> np.ndarray:
    """Return True where a block's motion puts it before the camera, (N,)."""
    y = derotate(rays_prev, R)[:, :2]
    outward = (t[:2] - y * t[2]) * focal
    return np.einsum('ij,ij->i', outward, (rays_cur[:, :2] - y) * focal) > 0


def behind(pair, R, t):
    """Return the share of the votes of `orient` that put a block behind the camera."""
    vote = before_camera(pair.rays_cur, pair.rays_prev, pair.focal, R, t)
    length = np.linalg.norm(formulas.parallax(pair.rays_cur, pair.rays_prev, pair.focal, R),
                            axis=1)
    weight = np.minimum(length / pair.sigma, 10.0)
    return float(weight[~vote].sum() / max(weight.sum(), 1e-9))


def observed(pair, fit, epsilon_f, epsilon_m, relief):
    """Return the columns of BlockObservations after the pair."""
    R, t, focal = fit.R_cur_from_prev, fit.t_cur_from_prev, pair.focal
    error = epipolar_error(pair.rays_cur, pair.rays_prev, focal, R, t) / pair.sigma
    rho, per_pixel = inverse_depth(pair.rays_cur, pair.rays_prev, focal, R, t)
    blur = per_pixel * pair.sigma
    parallax = np.linalg.norm(formulas.parallax(pair.rays_cur, pair.rays_prev, focal, R), axis=1)
    inlier, near = np.abs(error) < epsilon_f, parallax >= epsilon_m
    return (error, rho, np.hypot(blur, relief * rho), blur, parallax, inlier,
            inlier & ~near, inlier & near & (rho < -3 * blur), inlier & near & (rho > 0))
