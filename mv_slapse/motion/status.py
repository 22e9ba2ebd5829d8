"""Correspondences of a key frame pair as the extraction takes them, and which it cannot use."""

from mv_slapse.changed import replace
from mv_slapse.config import ExtractionSettings
from mv_slapse.geometry import two_view
from mv_slapse.kernels.binding import compiled
from mv_slapse.motion import estimate
from mv_slapse.motion.observations import BlockObservations
from mv_slapse.records import Extraction
import numpy as np

STILL = 0.25  # px, by which a vector of what stands may be off
PARTS = 4  # of the picture, along each side, that stand or move
COLUMNS = ('x_cur', 'x_prev', 'sigma', 'block', 'label', 'plane_id')


def pair(blank: Extraction) -> two_view.Pair:
    """Return the correspondences with their rays."""
    return two_view.Pair(*compiled.rays_of(blank.K, blank.x_cur, blank.x_prev),
                         blank.sigma.astype(float), blank.K)


def only(whole: Extraction, rows: np.ndarray) -> Extraction:
    """Return an extraction of some rows, which grow."""
    if len(rows) == len(whole.x_cur):
        return whole
    taken = compiled.take_rows(tuple(getattr(whole, name) for name in COLUMNS), rows)
    return replace(whole, **dict(zip(COLUMNS, taken, strict=True)))


def scene(whole: Extraction, x: np.ndarray, settings: ExtractionSettings) -> np.ndarray:
    """Return the rows whose pixels (N, 2) do not show the vehicle itself.

    The middle of a macroblock that the edge cuts may lie beyond it.
    """
    if not any((settings.own_left, settings.own_right, settings.own_top, settings.own_bottom)):
        return np.arange(len(x))
    share = ((x + 0.5) / (whole.width, whole.height)).clip(0, 1)
    return np.flatnonzero(
        (share[:, 0] >= settings.own_left) & (share[:, 0] <= 1 - settings.own_right)
        & (share[:, 1] >= settings.own_top) & (share[:, 1] <= 1 - settings.own_bottom))


def scattered(whole: Extraction, shown: Extraction, rows: np.ndarray) -> Extraction:
    """Return what some rows show as part of the whole, whose places and sizes stay."""
    columns = {name: getattr(whole, name) for name in COLUMNS}
    for name in ('sigma', 'label', 'plane_id'):
        columns[name] = columns[name].copy()
        columns[name][rows] = getattr(shown, name)
    return replace(shown, **columns)


def too_few(n: int) -> str:
    """Say why a pair of n correspondences cannot be used, or nothing."""
    least = estimate.MIN_CORRESPONDENCES
    return '' if n >= least else f'{n} motion vectors, at least {least} are needed'


def disagreement(seen: BlockObservations) -> str:
    """Say how little a motion explains."""
    share = 100 * seen.epipolar_inlier.mean()
    return (f'no camera motion explains more than {share:.0f} % of the motion vectors: '
            'the picture moves faster than the encoder searches, or movers fill it')


def stands_still(whole: Extraction, rows: np.ndarray, share: float) -> bool:
    """Tell whether so many vectors are zero, in so many parts of the picture, that it stands.

    A bonnet that fills a third of the picture may have most of its vectors. The ``rows`` count.
    """
    square = (whole.x_prev - whole.x_cur)**2
    still = (square[:, 0] + square[:, 1])[rows] < STILL**2
    if np.count_nonzero(still) < share * len(still):
        return False
    part = np.floor(whole.x_cur[rows] * PARTS / (whole.width, whole.height)).clip(0, PARTS - 1)
    part = (PARTS * part[:, 1] + part[:, 0]).astype(int)
    n, n_still = np.bincount(part), np.bincount(part, still)
    return bool(np.mean((n_still >= share * n)[n > 0]) >= share)
