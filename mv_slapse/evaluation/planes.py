"""Errors of stationary planes, (17) of [MVO], and how pure their macroblocks are.

Each row of ``planes.csv`` is compared with the true plane it lies on, in the camera of its key
frame. That plane is the one most of its macroblocks show, and where no labels are known the one
that agrees best.
"""

from dataclasses import dataclass

from mv_slapse.evaluation.trajectory import associate
from mv_slapse.evaluation.truth import LabelTable, on_common_blocks, TruePlane
from mv_slapse.records import Label
from mv_slapse.storage.tum import Trajectory
import numpy as np

MIN_FRAMES = 4  # planes seen in no more than 3 key frames do not count
PURE = 0.8  # share of an observation's macroblocks that lie on its true plane
METRES_PER_RADIAN = 6.0  # weight of an angle against a depth where planes are matched


@dataclass(frozen=True)
class PlaneScore:
    """Figures of the observed planes.

    Attributes
    ----------
    depth_error, normal_error : (N,) float64
        Of each observation that counts [m], [rad].
    true_id : (N,) int
        True plane of each.
    purity : (P,) float64
        Of each observation with labels: share of its macroblocks on one true plane.
    n_estimated : int
        Planes seen long enough to count.
    """

    depth_error: np.ndarray
    normal_error: np.ndarray
    true_id: np.ndarray
    purity: np.ndarray
    n_estimated: int


def in_camera(planes: list[TruePlane], R_world_from_cam: np.ndarray,
              t_world_from_cam: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return normals (P, 3) and depths (P,) >= 0 of planes of {W} in a camera."""
    normals = np.array([plane.normal for plane in planes]).reshape(-1, 3)
    depths = np.array([plane.depth for plane in planes]) + normals @ t_world_from_cam
    sign = np.where(depths < 0, -1.0, 1.0)
    return sign[:, None] * (normals @ R_world_from_cam), sign * depths


def evaluate(table: dict[str, np.ndarray], planes: list[TruePlane], truth: Trajectory,
             scale: float, labels: tuple[LabelTable, LabelTable] | None = None) -> PlaneScore:
    """Return the figures of the rows of a planes.csv.

    Parameters
    ----------
    table : columns of planes.csv
    scale : float
        Metres per unit of the estimate.
    labels : estimated and true LabelTable, or None
    """
    table = _seen_long_enough(table)
    row, frame = _frames_of(table['stamp'], truth.stamps)
    shares = plane_shares(table, planes, *labels) if labels else np.zeros((len(row), 0))
    observed = np.c_[table['nx'], table['ny'], table['nz']]
    poses = zip(row, truth.rotations()[frame], truth.positions[frame], strict=True)
    errors = [_error(observed[k], scale * table['d'][k], in_camera(planes, R, t),
                     shares[k] if shares.size else None) for k, R, t in poses]
    depth, angle, index = np.array(errors, float).reshape(-1, 3).T
    ids = np.array([plane.id for plane in planes], int)
    purity = shares.max(axis=1) if shares.size else np.zeros(0)
    return PlaneScore(depth, angle, ids[index.astype(int)], purity[np.isfinite(purity)],
                      len(np.unique(table['id'])))


def plane_shares(table: dict[str, np.ndarray], planes: list[TruePlane], estimate: LabelTable,
                 truth: LabelTable) -> np.ndarray:
    """Return (N, P): which share of the macroblocks of each row shows which true plane.

    A row is nan where none of its macroblocks has a true label.
    """
    estimate, truth = on_common_blocks(estimate, truth)
    frame = dict(zip(*associate(estimate.stamps, truth.stamps), strict=True))
    at = {stamp: k for k, stamp in enumerate(estimate.stamps)}
    shares = np.full((len(table['stamp']), len(planes)), np.nan)
    for i, (stamp, id_) in enumerate(zip(table['stamp'], table['id'], strict=True)):
        k = at.get(stamp)
        if k not in frame:
            continue
        mine = (estimate.plane[k] == id_) & (estimate.label[k] == Label.STATIONARY)
        mine &= truth.label[frame[k]] != Label.UNKNOWN
        if mine.any():
            shown = truth.plane[frame[k]][mine]
            shares[i] = [np.mean(shown == plane.id) for plane in planes]
    return shares


def figures(score: PlaneScore) -> dict[str, float | int | None]:
    """Return the keys that ``eval`` reports; None where nothing was compared."""
    any_ = len(score.depth_error) > 0
    return {
        'plane_depth_error_m': float(score.depth_error.mean()) if any_ else None,
        'plane_normal_error_deg': float(np.degrees(score.normal_error.mean())) if any_ else None,
        'n_planes': len(np.unique(score.true_id)), 'n_planes_estimated': score.n_estimated,
        'n_plane_observations': len(score.depth_error),
        'plane_observations_on_one_plane_percent':
            100 * float(np.mean(score.purity >= PURE)) if len(score.purity) else None}


def _error(normal: np.ndarray, depth: float, true: tuple[np.ndarray, np.ndarray],
           share: np.ndarray | None) -> tuple[float, float, int]:
    normals, depths = true
    angles = np.arccos(np.clip(normals @ normal, -1, 1))
    errors = np.abs(depths - depth)
    if share is not None and np.any(share > 0):
        best = int(np.argmax(share))
    else:
        best = int(np.argmin(errors + METRES_PER_RADIAN * angles))
    return errors[best], angles[best], best


def _seen_long_enough(table: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    ids, index, counts = np.unique(table['id'], return_inverse=True, return_counts=True)
    keep = counts[index] >= MIN_FRAMES if len(ids) else np.zeros(0, bool)
    return {name: values[keep] for name, values in table.items()}


def _frames_of(stamps: np.ndarray, truth: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return rows and their true frames; several rows share a stamp."""
    unique = np.unique(stamps)
    i, j = associate(unique, truth)
    frame = dict(zip(unique[i], j, strict=True))
    rows = np.array([k for k, stamp in enumerate(stamps) if stamp in frame], int)
    return rows, np.array([frame[stamps[k]] for k in rows], int)
