"""Two views in numpy: the formulas of kernels two_view and joint, as reference."""

import formulas
from formulas import cross
from mv_slapse.geometry import rotation
import numpy as np


def epipolar_jacobian(rays_cur, rays_prev, focal, R_cur_from_prev, t_cur_from_prev):
    """Return epipolar_error (N,) [px] and its derivative (N, 6) by (w, t), R -> exp(w) R."""
    c = cross(rays_cur, t_cur_from_prev)
    line = c @ R_cur_from_prev
    norm = _line_norm(line, focal)
    error = np.einsum('ij,ij->i', rays_prev, line) / norm
    # error = y . c / norm with y = R x_prev; norm^2 = sum((line / focal)^2), line = R^T c.
    y = rays_prev @ R_cur_from_prev.T
    slope = line[:, :2] / np.square(focal) @ R_cur_from_prev[:, :2].T
    e_n = (error / norm)[:, None]
    by_c = y - e_n * slope
    jacobian = np.empty((len(error), 6))
    jacobian[:, :3] = cross(y, c) - e_n * cross(slope, c)
    jacobian[:, 3:] = cross(by_c, rays_cur)
    return error, jacobian / norm[:, None]


def _line_norm(line, focal):
    """Length of the pixel normal of lines given in ray coordinates, never zero."""
    return np.maximum(np.hypot(line[:, 0] / focal[0], line[:, 1] / focal[1]), 1e-12)


def plane_transfer(rays_cur, K, R_cur_from_prev, t_cur_from_prev, plane_cur) -> np.ndarray:
    """Predict x_prev (N, 2) [px] of blocks on a plane, the observation (19) of [SLAPSE]."""
    depthless = rays_cur + np.outer(rays_cur @ plane_cur, t_cur_from_prev)
    q = depthless @ R_cur_from_prev
    return q[:, :2] / q[:, 2:] * (K[0, 0], K[1, 1]) + K[:2, 2]


def plane_transfer_jacobian(rays_cur, K, R_cur_from_prev, t_cur_from_prev, plane_cur):
    """Return plane_transfer (N, 2) [px] and its derivative (N, 2, 9) by (w, t, plane).

    The rotation is perturbed as exp(w) R. Derivation: q = R^T (x + t (plane . x)), so
    dq = R^T ([p]x dw + (plane . x) dt + t x^T dplane) with p = x + t (plane . x).
    """
    along = rays_cur @ plane_cur
    p = rays_cur + np.outer(along, t_cur_from_prev)
    q = p @ R_cur_from_prev
    focal = np.array([K[0, 0], K[1, 1]])
    pixels = q[:, :2] / q[:, 2:] * focal + K[:2, 2]
    # d pixel / d q, rotated back: rows a_u, a_v (N, 3) such that d pixel = a . (R dq).
    by_q = np.zeros((len(q), 2, 3))
    by_q[:, 0, 0], by_q[:, 1, 1] = focal[0] / q[:, 2], focal[1] / q[:, 2]
    by_q[:, :, 2] = -focal * q[:, :2] / q[:, 2:]**2
    a = by_q @ R_cur_from_prev.T
    jacobian = np.empty((len(q), 2, 9))
    jacobian[:, :, :3] = cross(a, p[:, None])
    jacobian[:, :, 3:6] = a * along[:, None, None]
    jacobian[:, :, 6:] = (a @ t_cur_from_prev)[:, :, None] * rays_cur[:, None]
    return pixels, jacobian


def epipolar_terms(pair, R, t, width: float):
    """Return normal equations of epipolar errors by (w, t): A (6, 6), b (6,), cost.

    Geman-McClure kernel of ``width`` standard deviations; the cost is minus twice its log
    likelihood, bounded by width^2 for each correspondence.
    """
    error, J = epipolar_jacobian(pair.rays_cur, pair.rays_prev, pair.focal, R, t)
    m2 = np.square(error / pair.sigma)
    weight = 1 / np.square(1 + m2 / width**2) / pair.sigma**2
    weighted = weight[:, None] * J
    return weighted.T @ J, -weighted.T @ error, float(np.sum(m2 / (1 + m2 / width**2)))


def plane_terms(pair, R, t, plane, relief: float, width: float,
                dependence=(1.0, 1.0)):
    """Return normal equations of the homography errors of one plane by (w, t, plane).

    Parameters
    ----------
    relief : float
        Standard deviation of the surface's depth about its plane, as a share of depth: along the
        epipolar line it adds this share of the parallax to the noise.
    width : float
        Kernel width, as in epipolar_terms.
    dependence : (float, float)
        Of two_view.normal_equations.

    Returns
    -------
    A : (9, 9) array
    b : (9,) array
    cost : float
    """
    predicted, J = plane_transfer_jacobian(pair.rays_cur, pair.K, R, t, plane)
    error = pair.x_prev - predicted
    across, along = plane_weights(pair, R, predicted, relief)
    m2 = np.einsum('ni,nij,nj->n', error, across + along, error)
    W = across / dependence[0] + along / dependence[1]
    W = W / np.square(1 + m2 / width**2)[:, None, None]
    WJ = W @ J
    flat = J.reshape(-1, 9)
    return (flat.T @ WJ.reshape(-1, 9), WJ.reshape(-1, 9).T @ error.ravel(),
            float(np.sum(m2 / (1 + m2 / width**2))))


def plane_weights(pair, R, predicted, relief: float):
    """Return inverse covariances (N, 2, 2) of x_prev across and along epipolar lines [1/px^2].

    Their sum is the inverse covariance on a plane with relief.
    """
    at_infinity = pair.rays_cur @ R
    parallax = predicted - (at_infinity[:, :2] / at_infinity[:, 2:] * pair.focal + pair.K[:2, 2])
    variance = pair.sigma**2
    square = np.maximum(np.sum(parallax**2, axis=1), 1e-18)
    outer = parallax[:, :, None] * (parallax / square[:, None])[:, None, :]
    along = outer / (variance + relief**2 * square)[:, None, None]
    return (np.eye(2) - outer) / variance[:, None, None], along


def without_bias(A: np.ndarray, b: np.ndarray, plane: np.ndarray, bias: float):
    """Marginalise a common scale error of a plane's parallax out of its normal equations.

    Encoders pull all vectors of a surface the same way, so that its depth errs as a whole by a
    share s ~ N(0, bias^2) that does not average out over its blocks. With (1 + s) plane for
    plane, s is a tenth unknown with a prior; its Schur complement remains.
    """
    if not bias:
        return A, b
    column = A[:, 6:] @ plane
    own = plane @ column[6:] + 1 / bias**2
    return A - np.outer(column, column) / own, b - column * (plane @ b[6:]) / own


def without_turn(A: np.ndarray, b: np.ndarray, sigma):
    """Marginalise a common error of all vectors out of normal equations.

    An offset of all vectors is a turn of the camera by some ``sigma`` [rad], about each axis where
    it has three; what remains knows the rotation no better.
    """
    if not np.any(sigma):
        return A, b
    columns = A[:, :3]
    own = A[:3, :3] + np.eye(3) / sigma**2
    gain = np.linalg.solve(own, columns.T).T
    return A - gain @ columns.T, b - gain @ b[:3]


def normal_equations(pair, R, t, planes, index, relief: float, width: float, *,
                     bias: float = 0.0, dependence=(1.0, 1.0), offset: float = 0.0):
    """Return A, b and the cost of (10) by (w, t, plane 0, ...)."""
    size = 6 + 3 * len(planes)
    A, b = np.zeros((size, size)), np.zeros(size)
    A[:6, :6], b[:6], cost = epipolar_terms(pair[index < 0], R, t, width)
    A, b = A / dependence[0], b / dependence[0]
    for i, plane in enumerate(planes):
        A_i, b_i, cost_i = plane_terms(pair[index == i], R, t, plane, relief, width, dependence)
        A_i, b_i = without_bias(A_i, b_i, plane, bias)
        at = np.r_[0:6, 6 + 3 * i:9 + 3 * i]
        A[np.ix_(at, at)] += A_i
        b[at] += b_i
        cost += cost_i
    return *without_turn(A, b, offset / pair.focal.mean()), cost


def reestimate(pair, R, t, planes, index, relief: float, steps: int = 4,
               expected=()):
    """Minimise (10), as joint.reestimate does."""
    planes = np.array(planes, float).reshape(-1, 3)
    damping = 1e-6
    A, b, cost, lift = _tangent_equations(pair, R, t, planes, index, relief, expected)
    for _ in range(steps):
        step = lift @ np.linalg.solve(A + damping * np.diag(np.diag(A) + 1e-12), b)
        trial = _moved(R, t, planes, step)
        new = _tangent_equations(pair, *trial, index, relief, expected)
        if new[2] > cost:
            damping = max(damping * 100, 1e-3)
            continue
        converged = cost - new[2] < 1e-4 * cost
        (R, t, planes), (A, b, cost, lift) = trial, new
        damping *= 0.1
        if converged:
            break
    return R, t, planes, lift @ np.linalg.pinv(A, hermitian=True) @ lift.T


def _moved(R, t, planes, step):
    """Apply a step of (w, t, planes) and bring t back to unit length."""
    t_new = t + step[3:6]
    return (rotation.exp(step[:3]) @ R, t_new / np.linalg.norm(t_new),
            planes + step[6:].reshape(-1, 3))


def _tangent_equations(pair, R, t, planes, index, relief, expected):
    """Return A, b by (w, two tangents of t, planes), the cost, and the lift back to t."""
    A, b, cost = normal_equations(pair, R, t, planes, index, relief, width=3.0)
    for i, mean, information in expected:
        at = slice(6 + 3 * i, 9 + 3 * i)
        off = mean - planes[i]
        A[at, at] += information
        b[at] += information @ off
        cost += float(off @ information @ off)
    lift = np.zeros((len(b), len(b) - 1))
    lift[:3, :3], lift[3:6, 3:5] = np.eye(3), formulas.tangent_basis(t)
    lift[6:, 5:] = np.eye(len(b) - 6)
    return lift.T @ A @ lift, lift.T @ b, cost, lift
