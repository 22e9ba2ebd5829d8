"""Formulas, and kernels that are parts of others, by themselves: only tests ask for them."""

from math import comb
from types import SimpleNamespace

import cv2
from mv_slapse.codec.merging import existence
from mv_slapse.codec.prediction import kernel_frame
from mv_slapse.geometry.camera import Camera, to_rays
from mv_slapse.geometry.rotation import skew
from mv_slapse.geometry.two_view import columns
from mv_slapse.kernels.binding import compiled
from mv_slapse.movers.moving_plane import (
    fit_surfaces,
    MIN_BLOCKS,
    Regions,
    settled,
    View,
)
from mv_slapse.records import SegmentKind
from mv_slapse.scene.observations import Kind, Observation
from mv_slapse.scene.state import HEIGHT, N_LASTING, relative_motion
import numpy as np

CELL = 8  # px, the smallest partition that decoders report


def fundamental(K, R_cur_from_prev, t_cur_from_prev) -> np.ndarray:
    """Return F (3, 3) with x_cur^T F x_prev = 0, (4) of [MVO]."""
    K_inv = np.linalg.inv(K)
    return K_inv.T @ skew(t_cur_from_prev) @ R_cur_from_prev @ K_inv


def derotate(rays_prev, R_cur_from_prev) -> np.ndarray:
    """Rays x'_prev ~ R x_prev (N, 3) as the current camera would see them untranslated, (6)."""
    y = rays_prev @ R_cur_from_prev.T
    return y / y[:, 2:]


def epipolar_error(rays_cur, rays_prev, focal, R_cur_from_prev, t_cur_from_prev):
    """Signed distance of x_prev from its epipolar line, the Sampson error of (5) in [MVO].

    A block's centre is exact and its match is not, so all noise is in x_prev and the first-order
    (Sampson) error is this distance.

    Parameters
    ----------
    rays_cur, rays_prev : (N, 3) arrays
    focal : (2,) array
        fx, fy [px].
    R_cur_from_prev, t_cur_from_prev : (3, 3), (3,) arrays
        Motion; any length of t.

    Returns
    -------
    error : (N,) array
        [px].
    """
    return compiled.epipolar_error(*(np.ascontiguousarray(array, float) for array in (
        rays_cur, rays_prev, focal, R_cur_from_prev, t_cur_from_prev)))


def inverse_depth_jacobian(rays_cur, rays_prev, focal, R_cur_from_prev, t_cur_from_prev):
    """Return inverse_depth's rho (N,) and its derivative (N, 6) by (w, t), R -> exp(w) R."""
    y = derotate(rays_prev, R_cur_from_prev)
    g = (t_cur_from_prev[:2] - y[:, :2] * t_cur_from_prev[2]) * focal
    square = np.maximum(np.sum(g * g, axis=1), 1e-18)[:, None]
    gap = (rays_cur[:, :2] - y[:, :2]) * focal
    rho = np.sum(gap * g, axis=1) / square[:, 0]
    by_gap, by_g = g / square * focal, (gap - 2 * rho[:, None] * g) / square * focal
    # y moves by w x y, and back to z = 1; what a vector v in the picture tells by y is v . dy.
    by_y = -by_gap - by_g * t_cur_from_prev[2]
    by_y = np.c_[by_y, -np.sum(by_y * y[:, :2], axis=1)]
    return rho, np.c_[cross(y, by_y), by_g, -np.sum(by_g * y[:, :2], axis=1)]


def parallax(rays_cur, rays_prev, focal, R_cur_from_prev):
    """Pixel displacement x_cur - x'_prev (N, 2) that is left after rotation is removed, (6)."""
    return (rays_cur[:, :2] - derotate(rays_prev, R_cur_from_prev)[:, :2]) * focal


def induced_by_plane(K, R_cur_from_prev, t_cur_from_prev, plane_cur) -> np.ndarray:
    """Homography of a stationary plane, (9) of [MVO]; with t - t_d for t a moving one's, (11).

    Parameters
    ----------
    K : (3, 3) array
        Intrinsics [px].
    R_cur_from_prev, t_cur_from_prev : (3, 3), (3,) arrays
        Motion, X_cur = R X_prev + t.
    plane_cur : (3,) array
        Plane n / d in the current camera.

    Returns
    -------
    H : (3, 3) array
        Takes homogeneous pixels of the current key frame to the previous one, up to scale.
    """
    motion = np.eye(3) + np.outer(t_cur_from_prev, plane_cur)
    return K @ R_cur_from_prev.T @ motion @ np.linalg.inv(K)


def to_normal_depth(plane: np.ndarray) -> tuple[np.ndarray, float]:
    """Return the unit normal and the positive depth [m] of a plane."""
    depth = 1 / np.linalg.norm(plane)
    return plane * depth, float(depth)


def normal_depth_jacobian(plane: np.ndarray) -> np.ndarray:
    """Return the derivative (4, 3) of (normal, depth) by the plane."""
    depth = 1 / np.linalg.norm(plane)
    normal = plane * depth
    return np.vstack([depth * (np.eye(3) - np.outer(normal, normal)), -depth**2 * normal])


def tangent_basis(direction: np.ndarray) -> np.ndarray:
    """Return two unit vectors (3, 2) that are normal to a direction (3,) and to each other."""
    axis = np.eye(3)[np.argmin(np.abs(direction))]
    first = cross(direction, axis)
    first /= np.linalg.norm(first)
    second = cross(direction, first)
    return np.c_[first, second / np.linalg.norm(second)]


def cell_of(x: np.ndarray, block: np.ndarray) -> np.ndarray:
    """Return column and row (N, 2) int of the cell at the upper left corner of blocks.

    Parameters
    ----------
    x, block : (N, 2), (N, 2) arrays
        Centres and sizes [px].
    """
    return np.floor((x + 0.5 - block / 2) / CELL).astype(np.intp)


def components(x: np.ndarray, reach: int = 1) -> np.ndarray:
    """Return for each block (N, 2) the number of its connected component, from 0.

    Blocks are connected over gaps of up to ``2 * reach`` macroblocks. Components are numbered in
    the order of their first macroblocks, row by row.
    """
    return compiled.components(np.ascontiguousarray(x, float), reach)


def largest_components(x: np.ndarray, smallest: int, reach: int = 1) -> np.ndarray:
    """Return the mask of blocks in components of at least ``smallest`` macroblocks."""
    return compiled.largest_components(np.ascontiguousarray(x, float), smallest, reach)


def normal_equations(pair, R, t, planes, index, relief: float, width: float, *,
                     bias: float = 0.0, dependence=(1.0, 1.0), offset: float = 0.0):
    """Return the normal equations of (10) by (w, t, plane 0, plane 1, ...).

    A Geman-McClure kernel bounds each correspondence; the cost is minus twice the log likelihood.

    Parameters
    ----------
    planes : (P, 3) array
        n / d in camera k.
    index : (N,) int array
        Plane of each correspondence; -1: epipolar error only.
    relief : float
        Standard deviation of a surface's depth about its plane, as a share of depth: along the
        epipolar line it adds this share of the parallax to the noise.
    width : float
        Of the kernel, in standard deviations.
    bias : float
        Share by which all depths of a surface err together: encoders pull all vectors of a
        surface the same way. It is marginalised.
    dependence : (float, float)
        Correspondences that together tell as much as one independent one does, across epipolar
        lines and, where relief errs together too, along them.
    offset : float
        Error that all vectors share [px], a turn of the camera. It is marginalised.

    Returns
    -------
    A : (6 + 3 P, 6 + 3 P) array
    b : (6 + 3 P,) array
    cost : float
    """
    return compiled.normal_equations(
        *columns(pair, R, t), np.ascontiguousarray(index, np.int64),
        np.ascontiguousarray(planes, float).reshape(-1, 3),
        np.array([relief, width, *dependence, bias, offset], float))


def behind(pair, R, t) -> float:
    """Return the share of the blocks, weighed by their parallax, that are behind the camera.

    A block's vote of [MVO] 4.2 (alpha < 90 degrees for a camera that moves forward, >= 90 for one
    that moves backward) is the sign of (t_xy - x'_prev t_z) . (x_cur - x'_prev): the epipole
    e = t_xy / t_z is kept homogeneous, so that a camera moving sideways has a vote too.
    """
    return compiled.behind(*columns(pair, R, t))


def fit_moving_plane(x_cur, x_prev, sigma, block, K, R_cur_from_prev, t_cur_from_prev,
                     ground=None) -> SimpleNamespace | None:
    """Estimate the plane and the displacement of a moving region, (12) of [MVO].

    Parameters
    ----------
    x_cur, x_prev : (N, 2) arrays
        Block centres in key frame k and their matches in the previous one, undistorted [px].
    sigma : (N,) array
        Standard deviation of a coordinate of ``x_prev`` [px].
    block : (N, 2) array
        Width and height of the blocks [px].
    K, R_cur_from_prev, t_cur_from_prev : (3, 3), (3, 3), (3,) arrays
        Intrinsics [px] and camera motion; its length is the unit (zero: standing camera, then
        the unit is the ground's).
    ground : (3,) array, optional
        Ground plane n / d in camera k, in the same unit.

    Returns
    -------
    moving : MovingPlane's columns or None
        With the ``centre`` and the ``inlier`` of the region's Surfaces, and ``closing``, the share
        of its depth that the surface lost during the pair, with its variance. None where fewer
        than 4 vectors, or less than half of them, agree on a motion.
    """
    if len(x_cur) < MIN_BLOCKS:
        return None
    x_cur, x_prev, sigma, t = (np.ascontiguousarray(values, float) for values in (
        x_cur, x_prev, sigma, t_cur_from_prev))
    view = View(K, np.ascontiguousarray(R_cur_from_prev), t)
    fit = fit_surfaces(Regions(x_cur, x_prev, sigma, np.zeros(1, int)), view, ground)
    blocks = SimpleNamespace(x=x_cur, block=np.asarray(block, float), first=np.zeros(1, int),
                             members=np.arange(len(x_cur)))
    found = settled(fit, blocks, 0, view, ground)
    return found and SimpleNamespace(
        **found._asdict(), centre=fit.centre[0], inlier=fit.inlier, closing=-fit.theta[0, 2],
        closing_variance=fit.covariance[0, 2, 2])


def leaning(frame) -> np.ndarray:
    """Return how far (N,) [px] below the middle of each block the point lies that it tells of.

    Zero for partitions, few of which are as predicted; above the middle it is negative. The
    prediction is that of ITU-T H.264, 8.4.1.3, for one reference picture in each direction.
    """
    return compiled.leaning(kernel_frame(frame))


def expected_variance(kind: SegmentKind, n_b: int, p: float, direct_weight: float) -> float:
    """Return the variance of a merged vector, given that it exists: Lemma 2 of [SLAPSE], (8), (9).

    The mixture over which of the evidence is right, of `merged_variance`, divided by Lemma 1.
    """
    q = p * p
    directs = ((0, 1.0),) if kind is SegmentKind.PI else ((0, 1 - p), (1, p))
    total = sum(chance * comb(n_b, n) * q ** n * (1 - q) ** (n_b - n)
                * merged_variance(n, direct, direct_weight)
                for direct, chance in directs for n in range(n_b + 1) if n + direct)
    return total / existence(kind, n_b, p)


def merged_variance(n_indirect, has_direct, direct_weight: float):
    """Return the variance of a merged vector in units of one vector's variance.

    The average of a direct vector (variance 1, weight w) and n indirect ones (variance 2, weight
    1) has variance (w^2 + 2 n) / (w + n)^2; [SLAPSE] (5) takes w = sqrt 2, inverse variances
    give w = 2. Works on arrays.
    """
    w = direct_weight * has_direct
    return (w ** 2 + 2 * n_indirect) / (w + n_indirect) ** 2


def time_to_contact(closing: float, variance: float, dt: float) -> tuple[float, float]:
    """Time until the seen surface reaches the camera's plane, and its variance [s], [s^2].

    With the product M = (t - t_d) plane^T and the ray r of the region's centre, -M r is the
    surface's displacement relative to the camera over its depth Z. Its third coordinate is -s:
    in dt the depth shrinks by s Z, so tau = Z / (s Z / dt) = dt / s, in which no scale is left.

    Parameters
    ----------
    closing, variance : float
        s and its variance; infinite times where s is not positive.
    dt : float
        Time of the pair [s].
    """
    if closing <= 0:
        return np.inf, np.inf
    return dt / closing, dt**2 * variance / closing**4


def cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return np.cross(a, b) over last axes of length 3, at a quarter of its cost."""
    out = np.empty(np.broadcast_shapes(a.shape, b.shape))
    for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        out[..., i] = a[..., j] * b[..., k] - a[..., k] * b[..., j]
    return out


def distort(camera: Camera, x: np.ndarray) -> np.ndarray:
    """Return the pixels (N, 2) float64 at which the lens shows ideal pixels (N, 2)."""
    x = np.asarray(x, float)
    if not np.any(camera.distortion) or not len(x):
        return x.copy()
    rays = to_rays(camera.K, x)
    if camera.lens == 'equidistant':
        return cv2.fisheye.distortPoints(rays[:, None, :2].copy(), camera.K,
                                         camera.distortion)[:, 0]
    return cv2.projectPoints(rays[:, None], np.zeros(3), np.zeros(3), camera.K,
                             camera.distortion)[0][:, 0]


def plane_in_camera_jacobian(state, id: int):
    """Return the derivatives of plane_in_camera by pose error (3, 6) and plane (3, 3)."""
    plane, pose = state.planes[id], state.current
    offset = pose.t - plane.anchor
    scale = 1 + plane.plane @ offset
    turned = pose.R.T @ plane.plane
    by_pose = np.c_[skew(turned / scale), -np.outer(turned, plane.plane) / scale**2]
    return by_pose, pose.R.T / scale - np.outer(turned, offset) / scale**2


def relative_motion_jacobian(state):
    """Return the derivatives (6, 6) of (w, t) by the errors of the previous and current pose.

    R_cur_from_prev -> exp(w) R_cur_from_prev as in geometry.two_view.
    """
    R_cp, t_cp = relative_motion(state)
    by_previous, by_current = np.zeros((6, 6)), np.zeros((6, 6))
    by_previous[:3, :3], by_previous[3:, 3:] = R_cp, state.current.R.T
    by_current[:3, :3], by_current[3:, 3:] = -np.eye(3), -state.current.R.T
    by_current[3:, :3] = skew(t_cp)
    return by_previous, by_current


def camera_height(ground: int, height: float, sigma: float, lasting=0.0) -> Observation:
    """Observe the camera's mean height [m] above the ground plane, known but for sigma [m].

    ``lasting`` is what each lasting error does to it [m], (N_LASTING,); a float: what of it is
    wrong for good.
    """
    error = np.zeros(N_LASTING)
    error[slice(None) if np.ndim(lasting) else HEIGHT] = lasting
    return Observation(Kind.CAMERA_HEIGHT, sigma, height, ground, error)
