"""Exact correspondences of a street with noise of choice, without pictures: for filter tests."""

from dataclasses import dataclass

from mv_slapse.geometry.blocks import MACROBLOCK
from mv_slapse.geometry.camera import to_pixels, to_rays
from mv_slapse.records import Correspondences, Label, SegmentKind
from mv_slapse.simulation.street import Street
from mv_slapse.simulation.surfaces import cast, FIRST_MOVER, SKY
import numpy as np

SEARCH = 16.0   # an outlier lies at most so far from the truth, in each coordinate [px]


@dataclass(frozen=True)
class DrawnPair:
    """Correspondences and the truth of each.

    Attributes
    ----------
    correspondences : Correspondences
    label : (N,) int8
        STATIONARY, MOVING or INFINITY (the sky), outliers included.
    surface : (N,) int32
        Plane id, mover id, or -1 for the sky.
    outlier : (N,) bool
        Vectors that are wrong on purpose.
    x_true : (N, 2) float64
        ``x_prev`` without noise [px].
    """

    correspondences: Correspondences
    label: np.ndarray
    surface: np.ndarray
    outlier: np.ndarray
    x_true: np.ndarray


def draw_pair(street: Street, i: int, j: int, rng: np.random.Generator, sigma: float = 0.3,
              outliers: float = 0.1) -> Correspondences:
    """Return what a codec would ideally tell of frames i (previous) and j (current).

    One correspondence for each macroblock of frame j whose centre is seen in frame i, with
    Gaussian noise ``sigma`` [px] on ``x_prev`` and a share ``outliers`` of wrong vectors.
    """
    return draw(street, i, j, rng, sigma, outliers).correspondences


def draw(street: Street, i: int, j: int, rng: np.random.Generator, sigma: float = 0.3,
         outliers: float = 0.1) -> DrawnPair:
    """Return ``draw_pair`` with the truth of each correspondence."""
    centres = block_centres(street.camera.width, street.camera.height)
    x_true, surface, seen = match(street, i, j, centres)
    x_cur, x_true, surface = centres[seen], x_true[seen], surface[seen]
    n = len(x_cur)
    outlier = rng.uniform(size=n) < outliers
    error = np.where(outlier[:, None], rng.uniform(-SEARCH, SEARCH, (n, 2)),
                     rng.normal(0, 1, (n, 2)) * sigma)
    pair = Correspondences(
        street.stamp(j), street.stamp(i), street.camera.width, street.camera.height,
        SegmentKind.PP, max(0, abs(j - i) - 1), '', x_cur.astype(np.float32),
        (x_true + error).astype(np.float32), np.full(n, max(sigma, 1e-3), np.float32),
        np.full(n, 1 - outliers, np.float32), np.full((n, 2), MACROBLOCK, np.uint8))
    return DrawnPair(pair, labels(street, surface, street.time(j)), surface, outlier, x_true)


def block_centres(width: int, height: int) -> np.ndarray:
    """Return the centres (M, 2) of the macroblocks, row by row [px]."""
    x, y = np.meshgrid(np.arange(width // MACROBLOCK), np.arange(height // MACROBLOCK))
    return MACROBLOCK * np.c_[x.ravel(), y.ravel()] + (MACROBLOCK - 1) / 2


def labels(street: Street, surface: np.ndarray, time: float) -> np.ndarray:
    """Return the label of surfaces (N,) as int8; a mover that stands is STATIONARY."""
    moving = [car.id for car in street.movers if car.is_moving(time)]
    found = np.where(surface == SKY, Label.INFINITY, Label.STATIONARY)
    return np.where(np.isin(surface, moving), Label.MOVING, found).astype(np.int8)


def match(street: Street, i: int, j: int,
          x_j: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return where pixels x_j (N, 2) of frame j are in frame i.

    Gives x_i (N, 2) [px], the surface (N,) int32 (SKY where nothing is met), and whether frame i
    sees the point, neither hidden nor outside (N,) bool.
    """
    K = street.camera.K
    quads_j, quads_i = street.quads_in_camera(j), street.quads_in_camera(i)
    first, depth = cast(quads_j, to_rays(K, x_j))
    met = first >= 0
    X_j = to_rays(K, x_j) * np.where(met, depth, 1.0)[:, None]
    surface = np.where(met, quads_j.surface[first], SKY).astype(np.int32)
    X_i = _in_other(street, i, j, X_j, surface)
    front = met & (X_i[:, 2] > 1e-3)
    x_i = to_pixels(K, np.where(front[:, None], X_i, [0.0, 0.0, 1.0]))
    size = np.array([street.camera.width, street.camera.height])
    inside = np.all((x_i >= -0.5) & (x_i <= size - 0.5), axis=1)
    _, depth_i = cast(quads_i, to_rays(K, x_i))
    visible = np.abs(depth_i - X_i[:, 2]) < 1e-4 * X_i[:, 2] + 1e-3
    return x_i, surface, front & inside & visible


def _in_other(street: Street, i: int, j: int, X_j: np.ndarray, surface: np.ndarray) -> np.ndarray:
    """Return points of camera j as they are in camera i at its time."""
    R_j, t_j = street.pose(j)
    R_i, t_i = street.pose(i)
    X = X_j @ R_j.T + t_j
    for id_ in np.unique(surface[surface >= FIRST_MOVER]):
        R, t = street.mover_motion(int(id_), j, i)
        X[surface == id_] = X[surface == id_] @ R.T + t
    return (X - t_i) @ R_i
