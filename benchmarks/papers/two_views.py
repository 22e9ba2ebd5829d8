"""Two views as printed: eight points, (5), four-point homographies, Definitions 1 and 2, (10).

Motion as in [MVO], X_cur = R X_prev + t with |t| = 1; planes are n / d in camera k. The papers
give no thresholds but for 1 px and 20 macroblocks (table I of [SLAPSE]); what is chosen here is
in `Thresholds`.
"""

from dataclasses import dataclass
from typing import NamedTuple

import cv2
from mv_slapse.geometry import rotation
from mv_slapse.geometry.camera import to_pixels, to_rays
import numpy as np
from scipy.optimize import least_squares

BATCH, MOST, CONFIDENCE = 64, 1024, 0.99  # samples of eight points at a time and in all
ON_A_LINE = 24  # macroblocks that make an epipolar line: with fewer, no line can be fitted


@dataclass(frozen=True)
class Thresholds:
    """Bounds of errors [px], and the fewest macroblocks of a plane."""

    f: float = 1.0  # (3); the print's is algebraic, whose unit depends on F's scale: Sampson here
    m: float = 1.0  # (7), (13) of [SLAPSE]: parallax at infinity
    h: float = 1.0  # (15) of [SLAPSE]
    e: float = 2.0  # Definition 1, magnitude: 0.5 px of MPEG-2, four times
    smallest: int = 20
    planes: int = 8  # most of a pair
    tilt: float = np.inf  # of moving planes, `obstacles.observed`: nothing is printed


class View(NamedTuple):
    """Matches of two pictures, without the lens' distortion [px], and the intrinsics."""

    x_cur: np.ndarray
    x_prev: np.ndarray
    K: np.ndarray

    def of(self, rows) -> 'View':
        """Return those of a mask or an index."""
        return View(self.x_cur[rows], self.x_prev[rows], self.K)


def sampson(F: np.ndarray, view: View) -> np.ndarray:
    """Return the signed Sampson errors (..., N) [px] of matches under F (..., 3, 3)."""
    a, b = (np.c_[x, np.ones(len(x))].T for x in (view.x_cur, view.x_prev))
    of_prev, of_cur = F @ b, np.swapaxes(F, -1, -2) @ a
    squares = (of_prev[..., :2, :]**2).sum(-2) + (of_cur[..., :2, :]**2).sum(-2)
    return (a * of_prev).sum(-2) / np.sqrt(np.maximum(squares, 1e-300))


def eight_points(view: View, threshold: float, rng: np.random.Generator):
    """Return F (3, 3) by the normalised eight-point algorithm under RANSAC, and its inliers (N,).

    None, and nobody, where there are not enough matches. As H&Z 11.6 fitted again to its inliers.
    """
    n, best, support, done = len(view.x_cur), None, np.zeros(len(view.x_cur), bool), 0
    if n < 16:
        return best, support
    a, A = _normalised(view.x_cur)
    b, B = _normalised(view.x_prev)
    rows = np.einsum('ni,nj->nij', a, b).reshape(-1, 9)

    def solved(samples):
        M = rows[samples]
        least = np.linalg.eigh(np.swapaxes(M, 1, 2) @ M)[1][..., 0]
        U, S, Vt = np.linalg.svd(least.reshape(-1, 3, 3))
        S[:, 2] = 0
        return A.T @ (U * S[:, None]) @ Vt @ B

    needed = MOST
    while done < needed:
        F = solved(rng.integers(0, n, (BATCH, 8)))
        inlier = np.abs(sampson(F, view)) < threshold
        k = int(inlier.sum(1).argmax())
        if inlier[k].sum() > support.sum():
            best, support = F[k], inlier[k]
            share = min(support.mean(), 1 - 1e-9)
            needed = min(MOST, np.log(1 - CONFIDENCE) / np.log1p(-share**8))
        done += BATCH
    again = solved(np.flatnonzero(support)[None])[0] if support.sum() >= 8 else best
    inlier = np.abs(sampson(again, view)) < threshold
    return (again, inlier) if inlier.sum() >= support.sum() else (best, support)


def motion(view: View, F: np.ndarray, inlier: np.ndarray):
    """Return R_cur_from_prev and unit t_cur_from_prev of F, with most inliers before both."""
    E = view.K.T @ F @ view.K
    seen = view.of(inlier)
    _, R, t, _ = cv2.recoverPose(E, seen.x_prev, seen.x_cur, view.K)
    return R, t[:, 0] / np.linalg.norm(t)


def moved(R: np.ndarray, t: np.ndarray, step: np.ndarray):
    """Return a motion changed by (rotation (3,), direction (2,))."""
    t = t + tangent(t) @ step[3:5]
    return rotation.exp(step[:3]) @ R, t / np.linalg.norm(t)


def tangent(t: np.ndarray) -> np.ndarray:
    """Return two directions (3, 2) at right angles to a unit vector and each other."""
    return np.linalg.svd(t[None])[2][1:].T


def fundamental(K: np.ndarray, R: np.ndarray, t: np.ndarray) -> np.ndarray:
    """Return F of a motion, (4) of [MVO]."""
    K_inv = np.linalg.inv(K)
    return K_inv.T @ rotation.skew(t) @ R @ K_inv


def refined(view: View, R: np.ndarray, t: np.ndarray):
    """Return the motion of least squared Sampson error, (5) of [MVO], Levenberg-Marquardt."""
    def errors(step):
        return sampson(fundamental(view.K, *moved(R, t, step)), view)

    return moved(R, t, least_squares(errors, np.zeros(5), method='lm').x)


def without_rotation(view: View, R: np.ndarray) -> np.ndarray:
    """Return x'_prev (N, 2) [px], (6) of [MVO], (12) of [SLAPSE]."""
    return to_pixels(view.K, to_rays(view.K, view.x_prev) @ R.T)


def at_infinity(view: View, R: np.ndarray, threshold: float) -> np.ndarray:
    """Return which matches (N,) show too little parallax, (7) of [MVO], (13) of [SLAPSE]."""
    return np.linalg.norm(without_rotation(view, R) - view.x_cur, axis=1) < threshold


def stationary(view: View, R: np.ndarray, t: np.ndarray, bounds: Thresholds) -> np.ndarray:
    """Return which matches (N,) are stationary, Definition 1 of [MVO], each by itself."""
    turned, e = without_rotation(view, R), view.K @ t
    still = np.abs(sampson(fundamental(view.K, R, t), view)) < bounds.f
    e[2] = np.copysign(max(abs(e[2]), 1e-5 * np.linalg.norm(e)), e[2])  # not beyond 100,000 px
    # From the epipole, times its last coordinate, whose sign the vote takes out again.
    outward, flow = turned * e[2] - e[:2], view.x_cur - turned
    ahead = (outward * flow).sum(1) > 0
    still &= ahead == (ahead[still].mean() >= 0.5 if still.any() else True)
    rows = np.flatnonzero(still)
    away = view.x_cur[rows] * e[2] - e[:2]
    reach = np.linalg.norm(away, axis=1) / abs(e[2])
    still[rows] = _on_lines(np.arctan2(away[:, 1], away[:, 0]), reach,
                            np.linalg.norm(flow[rows], axis=1), bounds.e)
    return still


def _on_lines(angle, reach, length, threshold):
    """Return whose length agrees with the line that most of an epipolar line's blocks make.

    Blocks next to one another in angle about the epipole are one epipolar line. All pairs of its
    blocks are tried, in place of RANSAC's samples.
    """
    agrees = np.ones(len(angle), bool)
    if len(angle) < ON_A_LINE:
        return agrees
    order = np.argsort(angle, kind='stable')
    first, second = np.triu_indices(ON_A_LINE, 1)
    starts = [*range(0, len(order) - ON_A_LINE, ON_A_LINE), len(order) - ON_A_LINE]
    for start in starts:
        rows = order[start:start + ON_A_LINE]
        r, y = reach[rows] / max(reach[rows].max(), 1e-9), length[rows]
        apart = r[second] - r[first]
        slope = (y[second] - y[first]) / np.where(np.abs(apart) > 1e-6, apart, np.inf)
        off = np.abs(y - y[first, None] - slope[:, None] * (r - r[first, None]))
        agrees[rows] = off[(off < threshold).sum(1).argmax()] < threshold
    return agrees


def homographies(view: View, rows: np.ndarray, known: np.ndarray, bounds: Thresholds):
    """Return the plane (N,) of each match by sequential RANSAC, -1 for none, 4.3 of [MVO].

    Planes with a number in ``known`` (N,), -1 for none, are looked for first, among their own
    blocks, and keep it; new ones go on from the largest. Only matches of ``rows`` (N,) bool count.
    """
    plane, free = np.full(len(rows), -1), rows.copy()
    for number in np.unique(known[known >= 0]):
        _label(view, free & (known == number), free, number, plane, bounds)
    new, found = known.max(initial=-1) + 1, len(np.unique(plane[plane >= 0]))
    for number in range(new, new + bounds.planes - found):
        if not _label(view, free, free, number, plane, bounds):
            break
    return plane


def _label(view, sample, free, number, plane, bounds):
    """Find a homography among samples and give its inliers among the free ones its number."""
    if sample.sum() < 4:
        return False
    H, _ = cv2.findHomography(view.x_cur[sample], view.x_prev[sample], cv2.RANSAC, bounds.h)
    if H is None:
        return False
    there = cv2.perspectiveTransform(view.x_cur[None].astype(float), H)[0]
    found = free & (np.linalg.norm(there - view.x_prev, axis=1) < bounds.h)
    if found.sum() < bounds.smallest:
        return False
    plane[found], free[found] = number, False
    return True


def moving_planes(plane: np.ndarray, still: np.ndarray) -> list[int]:
    """Return the numbers of the planes most of whose matches move, Definition 2 of [MVO]."""
    return [int(n) for n in np.unique(plane[plane >= 0]) if still[plane == n].mean() <= 0.5]


def transfer(rays_cur, R_prev_from_cur, t_prev_from_cur, planes):
    """Return rays in camera k-1 (N, 3) of points on planes (N, 3), (9) of [MVO], (19) of [SLAPSE].

    X_prev = R X_cur + t, and plane @ X_cur = -1.
    """
    return rays_cur @ R_prev_from_cur.T - np.outer((rays_cur * planes).sum(1), t_prev_from_cur)


def fitted_plane(view: View, R_prev_from_cur, t_prev_from_cur) -> np.ndarray:
    """Return the plane (3,) that best explains matches of a known motion: linear in n / d."""
    rays, there = to_rays(view.K, view.x_cur), to_rays(view.K, view.x_prev)
    a, b = rays @ R_prev_from_cur.T, t_prev_from_cur
    by = b[:2] - there[:, :2] * b[2]
    M = (by[:, :, None] * rays[:, None, :]).reshape(-1, 3)
    return np.linalg.lstsq(M, (a[:, :2] - there[:, :2] * a[:, 2:]).ravel(), rcond=None)[0]


class Joint(NamedTuple):
    """Motion and stationary planes (P, 3) of (10), and the information about their changes.

    ``information`` (5 + 3 P, 5 + 3 P) is that of rotation (3), direction (2) and planes.
    """

    R: np.ndarray
    t: np.ndarray
    planes: np.ndarray
    information: np.ndarray


def joint(view: View, still: np.ndarray, plane: np.ndarray, start: Joint, sigma: float) -> Joint:
    """Minimise (10) of [MVO]: Sampson errors of all that is still, and those of its planes.

    ``plane`` (N,) is the row of ``start.planes`` of each match, -1 for none.
    """
    seen, on, R, t = view.of(still), plane >= 0, start.R, start.t
    rays, there, of = to_rays(view.K, view.x_cur[on]), view.x_prev[on], plane[on]

    def errors(step):
        R_cur, t_cur = moved(R, t, step)
        back = transfer(rays, R_cur.T, -R_cur.T @ t_cur, (start.planes + step[5:].reshape(
            -1, 3))[of])
        return np.r_[sampson(fundamental(view.K, R_cur, t_cur), seen),
                     (to_pixels(view.K, back) - there).ravel()]

    found = least_squares(errors, np.zeros(5 + start.planes.size), method='lm', max_nfev=2000)
    R, t = moved(R, t, found.x)
    return Joint(R, t, start.planes + found.x[5:].reshape(-1, 3),
                 found.jac.T @ found.jac / sigma**2)


def _normalised(x: np.ndarray):
    """Return homogeneous points (N, 3), centred and scaled, and the matrix that did it."""
    centre = x.mean(0)
    scale = np.sqrt(2) / np.mean(np.linalg.norm(x - centre, axis=1))
    T = np.array([[scale, 0, -scale * centre[0]], [0, scale, -scale * centre[1]], [0, 0, 1.0]])
    return np.c_[scale * (x - centre), np.ones(len(x))], T
