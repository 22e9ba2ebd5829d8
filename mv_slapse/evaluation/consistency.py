"""Whether the covariance that is published with a pose says what errors are made.

A recorded truth knows the frame of the estimate only through the poses themselves, and its first
may be its worst. There positions are compared, after the rigid motion with which most of them
agree, each as far as its covariance lets it; the best fit of all would spread an error at the end
over the start, where the covariance is small. A rendered truth is right from the first pose on, so
that nothing needs to be aligned.
"""

from collections.abc import Iterable
from itertools import pairwise
from typing import Any

from mv_slapse.evaluation.trajectory import align, associate
from mv_slapse.geometry import rotation
from mv_slapse.records import SceneEstimate, WITH_POSE
from mv_slapse.storage.tum import Trajectory
import numpy as np
from scipy.spatial.transform import Rotation

BOUND = 14.16  # chi-square of 3 degrees of freedom: as probable as 3 sigma of one, 99.73 %
WIDTHS = (100.0, 30.0, 10.0, 3.0, 3.0, 3.0)  # sigma, of the kernel: narrower from step to step
REST_SIGMA = 1e-6  # m and rad: a camera at rest has no error, but for the digits of the files
TRUTH_SIGMA = 0.01  # m, of recorded positions from one to the next


def figures(estimate: Trajectory, covariances: dict[int, np.ndarray], truth: Trajectory,
            is_metric: bool, is_exact: bool) -> dict[str, Any]:
    """Return how far covariances and errors agree.

    Parameters
    ----------
    estimate, truth : Trajectory
        [map unit], [m].
    covariances : dict of (6, 6) arrays
        Of (position, rotation about the axes of {W}) by stamp; poses without one are left out.
    is_metric : bool
        Whether the map unit is the metre; else the scale is aligned, too.
    is_exact : bool
        Whether the truth is right from the first pose on.

    Returns
    -------
    dict
        position_covered_percent: positions within 3 sigma of the true ones, after alignment.
        pose_nees: squared errors of the pose in units of its covariance, the mean over all poses,
        6 where it is right; None of a truth that is not exact.
    """
    i, j = associate(estimate.stamps, truth.stamps)
    known = np.array([stamp in covariances for stamp in estimate.stamps[i]], bool)
    i, j = i[known], j[known]
    if len(i) < 3:
        return {'position_covered_percent': None, 'pose_nees': None}
    P = np.array([covariances[stamp] for stamp in estimate.stamps[i]])
    P = P + np.eye(6) * REST_SIGMA**2
    source, target = estimate.positions[i], truth.positions[j]
    metre = 1.0 if is_metric else align(target, source, True).scale  # [map unit]
    of_position = P[:, :3, :3] + np.eye(3) * (0 if is_exact else metre * TRUTH_SIGMA)**2
    square = aligned_squares(source, target, of_position, not is_metric)
    error = pose_errors(estimate, truth, i, j, is_metric) if is_exact else None
    return {'position_covered_percent': 100 * float(np.mean(square < BOUND)),
            'pose_nees': None if error is None else
            float(np.mean(_squares(error, np.linalg.inv(P))))}


def unexplained_step(scenes: Iterable[SceneEstimate]) -> float | None:
    """Return the longest of a path's steps, less what twist and covariances explain [map unit].

    A step is explained by one of the twists at its ends, its own or their mean, but for 3 sigma:
    of the twist, and of what the position was unsure by before and is no more. None without steps;
    a new frame, which its count tells, begins without one.
    """
    path = [scene for scene in scenes if scene.status in WITH_POSE]
    left = [min(_unexplained(a, b, share) for share in (0.0, 0.5, 1.0))
            for a, b in pairwise(path) if a.resets == b.resets]
    return max(0.0, *left) if left else None


def _unexplained(before: SceneEstimate, after: SceneEstimate, share: float) -> float:
    dt = (after.stamp - before.stamp) * 1e-9
    velocity = (1 - share) * before.velocity_world + share * after.velocity_world
    off = after.t_world_from_cam - before.t_world_from_cam - velocity * dt
    along = off / max(np.linalg.norm(off), 1e-12)
    speed, old, new = (np.sqrt(along @ P[:3, :3] @ along) for P in (
        after.twist_covariance, before.pose_covariance, after.pose_covariance))
    corrected = max((old + speed * dt)**2 - new**2, 0)  # the velocity errs as the way so far does
    return float(np.linalg.norm(off) - 3 * np.hypot(speed * dt, np.sqrt(corrected)))


def pose_errors(estimate: Trajectory, truth: Trajectory, i: np.ndarray, j: np.ndarray,
                is_metric: bool) -> np.ndarray:
    """Return the errors (N, 6) of poses ``i`` [map unit, rad] against the true ones ``j``.

    {W} is the true pose at the estimate's first; the unit is the metre, or the first baseline.
    """
    first = associate(estimate.stamps[:1], truth.stamps)[1][0]
    R_world_from_truth = truth.rotations()[first].T
    R = R_world_from_truth @ truth.rotations()[j]
    t = (truth.positions[j] - truth.positions[first]) @ R_world_from_truth.T
    way = np.linalg.norm(estimate.positions[i], axis=1)
    start = np.argmax(way > 0)
    unit = 1.0 if is_metric else np.linalg.norm(t[start]) / way[start]
    turn = Rotation.from_matrix(estimate.rotations()[i] @ np.swapaxes(R, 1, 2)).as_rotvec()
    return np.c_[estimate.positions[i] - t / unit, turn]


def aligned_squares(source: np.ndarray, target: np.ndarray, covariances: np.ndarray,
                    with_scale: bool) -> np.ndarray:
    """Return the squared Mahalanobis distances (N,) of positions (N, 3) from the true ones.

    Aligned by iterated reweighting, with the weights of a Cauchy distribution.
    """
    true, information = align(target, source, with_scale).apply(target), np.linalg.inv(covariances)
    for width in WIDTHS:
        weight = 1 / (1 + _squares(source - true, information) / width**2)
        true = _moved(true, source, weight[:, None, None] * information, with_scale)
    return _squares(source - true, information)


def _moved(true: np.ndarray, source: np.ndarray, information: np.ndarray,
           with_scale: bool) -> np.ndarray:
    """Return the true positions after one Gauss-Newton step of their alignment."""
    turn = -np.array([rotation.skew(X) for X in true])
    J = np.concatenate([turn, np.broadcast_to(np.eye(3), turn.shape), true[:, :, None]], axis=2)
    J = J if with_scale else J[:, :, :6]
    weighted = np.einsum('nik,nij->nkj', J, information)
    A = np.einsum('nkj,njl->kl', weighted, J)
    b = np.einsum('nkj,nj->k', weighted, source - true)
    # Of a straight way the roll is unknown, and nothing depends on it.
    step = np.linalg.lstsq(A, b)[0]
    growth = np.exp(step[6]) if with_scale else 1.0
    return growth * true @ rotation.exp(step[:3]).T + step[3:6]


def _squares(error: np.ndarray, information: np.ndarray) -> np.ndarray:
    return np.einsum('ni,nij,nj->n', error, information, error)
