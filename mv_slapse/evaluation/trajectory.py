"""Errors of a trajectory against the true one, section 6.1 of [MVO].

Poses are associated by stamp, exactly or with the nearest within a tolerance; the truth is not
interpolated. ``evo`` gives the same figures.
"""

from dataclasses import dataclass

from mv_slapse.errors import UnusableInput
from mv_slapse.storage.tum import Trajectory
import numpy as np
from scipy.spatial.transform import Rotation

TOLERANCE = 10_000_000  # [ns] as evo's default
SEGMENT = 10.0  # [m] length over which drift is measured
REST, STILL = 1_000_000_000, 1e-3  # [ns] of a standstill, [m] that its poses lie apart at most


@dataclass(frozen=True)
class Similarity:
    """X_truth = scale R X_estimate + t."""

    scale: float
    R: np.ndarray
    t: np.ndarray

    def apply(self, X: np.ndarray) -> np.ndarray:
        """Return points (N, 3) of the estimate in the truth's frame."""
        return self.scale * X @ self.R.T + self.t


@dataclass(frozen=True)
class TrajectoryScore:
    """Figures of a trajectory.

    Attributes
    ----------
    n_poses : int
        Associated poses.
    distance : float
        Way of the truth between the first and the last of them [m].
    alignment, rigid : Similarity
        Best similarity, and best rigid motion, of the estimate onto the truth.
    ate, ate_rigid : (N,) float64
        Distances to the true positions after either [m].
    rpe, rpe_angle : (N - 1,) float64
        Errors of the motion between consecutive poses, with the similarity's scale [m], [rad].
    drift : (M,) float64
        Position errors over segments of at least SEGMENT, as a share of their length.
    standstill_drift : float or None
        Farthest from where a standstill of at least REST began, over all of them, with the
        similarity's scale [m]; None where the truth never rests.
    """

    n_poses: int
    distance: float
    alignment: Similarity
    rigid: Similarity
    ate: np.ndarray
    ate_rigid: np.ndarray
    rpe: np.ndarray
    rpe_angle: np.ndarray
    drift: np.ndarray
    standstill_drift: float | None


def associate(stamps: np.ndarray, truth: np.ndarray,
              tolerance: int = TOLERANCE) -> tuple[np.ndarray, np.ndarray]:
    """Return indices of stamps and of the true stamps [ns] nearest to them, within tolerance.

    Each true stamp is used once, by the nearest of those that ask for it.
    """
    if not len(stamps) or not len(truth):
        return np.zeros(0, int), np.zeros(0, int)
    after = np.clip(np.searchsorted(truth, stamps), 1, max(len(truth) - 1, 1))
    before, after = after - 1, np.minimum(after, len(truth) - 1)
    nearest = np.where(np.abs(truth[before] - stamps) <= np.abs(truth[after] - stamps),
                       before, after)
    gap = np.abs(truth[nearest] - stamps)
    order = np.lexsort((gap, nearest))
    first = np.r_[True, np.diff(nearest[order]) > 0]
    chosen = np.sort(order[first & (gap[order] <= tolerance)])
    return chosen, nearest[chosen]


def align(source: np.ndarray, target: np.ndarray, with_scale: bool = True) -> Similarity:
    """Return the similarity, or rigid motion, that best maps points (N, 3) onto others.

    Umeyama, Least-squares estimation of transformation parameters between two point patterns,
    PAMI 1991, (40)-(42). Where all source points are the same the scale is 1.
    """
    mean_source, mean_target = source.mean(0), target.mean(0)
    centred = source - mean_source
    covariance = (target - mean_target).T @ centred / len(source)
    U, D, Vt = np.linalg.svd(covariance)
    S = np.diag([1.0, 1.0, -1.0 if np.linalg.det(U) * np.linalg.det(Vt) < 0 else 1.0])
    R = U @ S @ Vt
    variance = np.mean(np.sum(centred**2, axis=1))
    scale = float(D @ np.diag(S) / variance) if with_scale and variance > 0 else 1.0
    return Similarity(scale, R, mean_target - scale * R @ mean_source)


def path_length(positions: np.ndarray) -> float:
    """Return the length [m] of the way along positions (N, 3)."""
    return float(np.linalg.norm(np.diff(positions, axis=0), axis=1).sum())


def evaluate(estimate: Trajectory, truth: Trajectory,
             tolerance: int = TOLERANCE) -> TrajectoryScore:
    """Return the figures of an estimate.

    Raises
    ------
    UnusableInput
        Where fewer than three poses have a true one.
    """
    i, j = associate(estimate.stamps, truth.stamps, tolerance)
    if len(i) < 3:
        raise UnusableInput(
            f'only {len(i)} of {len(estimate)} poses have a true pose within '
            f'{tolerance / 1e6:g} ms; estimate {_span(estimate)}, truth {_span(truth)}. '
            'Shift the stamps with --stamp-offset, or give the truth of this input')
    source, target = estimate.positions[i], truth.positions[j]
    alignment, rigid = align(source, target), align(source, target, with_scale=False)
    steps, angles = _relative_errors(estimate, truth, i, j, alignment.scale)
    return TrajectoryScore(
        len(i), path_length(truth.positions[j[0]:j[-1] + 1]), alignment, rigid,
        np.linalg.norm(alignment.apply(source) - target, axis=1),
        np.linalg.norm(rigid.apply(source) - target, axis=1),
        steps, angles, _drift(estimate, truth, i, j, alignment.scale),
        _standstill_drift(alignment.scale * source, target, truth.stamps[j]))


def figures(score: TrajectoryScore) -> dict[str, float | int | None]:
    """Return the keys that ``eval`` reports; percentages of the distance, None without one."""
    def percent(error: float) -> float | None:
        """Return an error [m] in per cent of the way."""
        return 100 * error / score.distance if score.distance > 1e-6 else None

    mean, rigid = float(score.ate.mean()), float(score.ate_rigid.mean())
    return {
        'n_poses': score.n_poses, 'distance_m': score.distance,
        'scale': score.alignment.scale,
        'ate_mean_m': mean, 'ate_max_m': float(score.ate.max()), 'ate_mean_percent': percent(mean),
        'ate_max_percent': percent(float(score.ate.max())),
        'ate_rigid_mean_m': rigid, 'ate_rigid_max_m': float(score.ate_rigid.max()),
        'ate_rigid_mean_percent': percent(rigid),
        'rpe_mean_m': float(score.rpe.mean()),
        'rpe_mean_deg': float(np.degrees(score.rpe_angle.mean())),
        'rpe_10m_percent': 100 * float(score.drift.mean()) if len(score.drift) else None,
        'standstill_drift_m': score.standstill_drift}


def epsilon_d(estimate: Trajectory, truth: Trajectory, is_metric: bool) -> float | None:
    """Return the mean relative error of the way from the first pose, [SLAPSE] table II [%].

    As there the frames of the first pose are one, without any alignment, and where the scale is
    free the first step tells it. None where the truth does not move.
    """
    i, j = associate(estimate.stamps, truth.stamps)
    start, end = np.zeros_like(i), np.arange(len(i))
    t, true = (_motions(path, at[start], at[end])[1]
               for path, at in ((estimate, i), (truth, j)))
    way, true_way = np.linalg.norm(t, axis=1), np.linalg.norm(true, axis=1)
    gone = (true_way > STILL) & (way > 0)
    if not gone.any():
        return None
    unit = 1.0 if is_metric else true_way[gone][0] / way[gone][0]
    return 100 * float(np.mean(np.linalg.norm(unit * t - true, axis=1)[gone] / true_way[gone]))


def _relative_errors(estimate: Trajectory, truth: Trajectory, i: np.ndarray, j: np.ndarray,
                     scale: float) -> tuple[np.ndarray, np.ndarray]:
    R, t = _motions(estimate, i[:-1], i[1:])
    R_true, t_true = _motions(truth, j[:-1], j[1:])
    error = np.swapaxes(R_true, 1, 2) @ R
    return (np.linalg.norm(scale * t - t_true, axis=1),
            np.linalg.norm(Rotation.from_matrix(error).as_rotvec(), axis=1))


def _drift(estimate: Trajectory, truth: Trajectory, i: np.ndarray, j: np.ndarray,
           scale: float) -> np.ndarray:
    steps = np.linalg.norm(np.diff(truth.positions, axis=0), axis=1)
    way = np.r_[0.0, np.cumsum(steps)][j]
    last = np.searchsorted(way, way + SEGMENT)
    first = np.flatnonzero(last < len(way))
    last = last[first]
    _, t = _motions(estimate, i[first], i[last])
    _, t_true = _motions(truth, j[first], j[last])
    return np.linalg.norm(scale * t - t_true, axis=1) / (way[last] - way[first])


def _standstill_drift(source: np.ndarray, target: np.ndarray, stamps: np.ndarray) -> float | None:
    moved = np.linalg.norm(np.diff(target, axis=0), axis=1) > STILL
    drifts = [np.linalg.norm(source[rest] - source[rest[0]], axis=1).max()
              for rest in np.split(np.arange(len(target)), np.flatnonzero(moved) + 1)
              if stamps[rest[-1]] - stamps[rest[0]] >= REST]
    return float(max(drifts)) if drifts else None


def _motions(trajectory: Trajectory, first: np.ndarray,
             last: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the poses (N, 3, 3), (N, 3) of ``last`` in the frames of ``first``."""
    R = trajectory.rotations()
    back = np.swapaxes(R[first], 1, 2)
    step = trajectory.positions[last] - trajectory.positions[first]
    return back @ R[last], np.einsum('nij,nj->ni', back, step)


def _span(trajectory: Trajectory) -> str:
    if not len(trajectory):
        return 'is empty'
    first, last = trajectory.stamps[[0, -1]] / 1e9
    return f'spans {first:.3f} to {last:.3f} s'
