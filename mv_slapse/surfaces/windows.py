"""What windows of the lattice tell of the surfaces in them.

One inverse depth is good to a few per cent, and within that a slanted plane passes through a
facade, the end wall beside it and the next facade. A window of macroblocks feels the slope. So
windows propose planes, and a plane is right for a block where it explains the window around the
block nearly as well as the window's own plane does. Of the windows that hold a block the one with
the best plane of its own is asked: it ends at the edge of the surface, as in stereo matching.
"""

from dataclasses import dataclass

from mv_slapse.geometry import rotation
from mv_slapse.geometry.blocks import macroblock_of
from mv_slapse.geometry.lattice import MACROBLOCK
from mv_slapse.surfaces.consensus import Depths
import numpy as np
from scipy import sparse

SQUARE, TALL = (5, 5), (3, 9)  # macroblocks: small ones know no slope, large ones no edge
LEAST = 8  # blocks in a window: three unknowns, and as many errors again
CAP = 4.0  # largest squared error of a block in a window's mean: an outlier counts as two sigma
UPRIGHT = 0.03  # rad: how far walls lean
DEPENDENCE = 6.0  # neighbouring vectors err together: so many tell as much as one
REACH = 12 * MACROBLOCK  # px: a plane grows this far from its window before it is chosen
GATE = 9.0  # squared, 3 sigma: a plane this near to upright is taken as upright


@dataclass(frozen=True)
class Windows:
    """Windows of the lattice, W of them, over N blocks.

    Attributes
    ----------
    mean : (W, N) sparse matrix
        Takes values of blocks to their means over the windows.
    planes, centres : (W, 3), (W, 2) arrays
        Plane of each window [1/baseline] and the mean of its pixels.
    noise : float
        Errors that the windows show, in standard deviations of the blocks.
    best, cost : (N,) arrays
        Window that judges each block, -1 for none; how badly its own plane fits there.
    """

    mean: sparse.csr_matrix
    planes: np.ndarray
    centres: np.ndarray
    noise: float
    best: np.ndarray
    cost: np.ndarray

    def excess(self, squared: np.ndarray) -> np.ndarray:
        """Return how much worse than their windows' own planes do planes fit about each block.

        Parameters
        ----------
        squared : (N, H) array
            Squared errors of the blocks on each of H planes, in standard deviations.

        Returns
        -------
        excess : (N, H) array
            Difference of mean squared errors, each at most CAP; infinite without a window.
        """
        mean = self.mean @ np.minimum(squared.astype(np.float32), np.float32(CAP))
        worse = mean[self.best] - self.cost[:, None]
        worse[self.best < 0] = np.inf
        return worse


def look(depths: Depths, up: np.ndarray) -> Windows | None:
    """Fit a plane in each window; None where no window holds enough blocks.

    Parameters
    ----------
    depths : Depths
        Of the blocks, with the errors of their vectors only.
    up : (3,) array
        Unit normal of the ground. Tall windows are taken for walls: three columns know no slant.
    """
    cell = macroblock_of(depths.x)
    window, block, is_tall = _tiled(cell - cell.min(axis=0))
    if not len(window):
        return None
    count = np.bincount(window)
    planes, squared = _fitted(depths[block], window, up, is_tall)
    noise = _noise(squared[(count[window] >= 1.5 * LEAST) & ~is_tall[window]])
    weight = 1 / count[window]
    capped = np.minimum(np.square(depths[block].error_each(planes[window]) / noise), CAP)
    cost = np.bincount(window, weight * capped)
    best = _best(window, block, cost + 3 / count, len(depths))
    size = (len(count), len(depths))
    mean = sparse.csr_matrix((weight.astype(np.float32), (window, block)), size)
    return Windows(mean, planes, mean @ depths.x, noise, best, cost[best].astype(np.float32))


def _tiled(cell: np.ndarray):
    """Return pairs (window, block), ordered by window, and which windows are tall."""
    parts, is_tall, first = [], [], 0
    for shape in (SQUARE, TALL):
        window, block = _members(cell, shape)
        keep = np.bincount(window, minlength=1)[window] >= LEAST
        names, window = np.unique(window[keep], return_inverse=True)
        order = np.argsort(window, kind='stable')
        parts.append((window[order] + first, block[keep][order]))
        is_tall += [shape == TALL] * len(names)
        first += len(names)
    window, block = (np.concatenate(column) for column in zip(*parts, strict=True))
    return window, block, np.array(is_tall, bool)


def _members(cell: np.ndarray, shape: tuple[int, int]):
    """Return pairs (window, block) of windows that overlap by half, for cells (N, 2)."""
    step = np.array(shape) // 2
    columns = cell[:, 0].max() // step[0] + 1
    pairs = []
    for back in np.ndindex(*(-(-np.array(shape) // step))):
        corner = cell // step - back
        inside = np.all((corner >= 0) & (cell - corner * step < shape), axis=1)
        number = corner[:, 1] * columns + corner[:, 0]
        pairs.append((number[inside], np.flatnonzero(inside)))
    return (np.concatenate(column) for column in zip(*pairs, strict=True))


def _fitted(depths: Depths, window: np.ndarray, up, is_tall, steps: int = 3):
    """Fit planes (W, 3) to windows of blocks, robustly, and return the squared errors too."""
    start = np.flatnonzero(np.r_[True, np.diff(window) > 0])
    terms, inverse = _terms(depths), 1 / np.square(depths.sigma)
    weight = inverse
    for _ in range(steps):
        A, b = _equations(np.add.reduceat(terms * weight[:, None], start))
        planes = np.linalg.solve(A, b[..., None])[..., 0]
        squared = np.square(depths.error_each(planes[window]))
        weight = inverse / np.square(1 + squared / CAP)
    B = rotation.tangent_basis(up)
    along = np.linalg.solve(B.T @ A[is_tall] @ B, (b[is_tall] @ B)[..., None])[..., 0]
    planes[is_tall] = along @ B.T
    return planes, squared


def _terms(depths: Depths) -> np.ndarray:
    """Return what each block adds to the normal equations of its plane, (N, 12)."""
    outer = (depths.rays[:, :, None] * depths.rays[:, None, :]).reshape(-1, 9)
    return np.c_[outer, -depths.rays * depths.rho[:, None]]


def _equations(sums: np.ndarray):
    """Return A (H, 3, 3), never singular, and b (H, 3) from sums of terms (H, 12)."""
    A = sums[:, :9].reshape(-1, 3, 3)
    ridge = 10 * np.finfo(float).eps * np.trace(A, axis1=1, axis2=2) + 1e-12
    return A + ridge[:, None, None] * np.eye(3), sums[:, 9:]


def _noise(squared: np.ndarray) -> float:
    """Return the scale of errors from their squares: median over a Gaussian's.

    A window's own plane takes 3 of some 20 degrees of freedom away. Better than they claim to be
    vectors never are: where windows agree beyond that, the encoder has predicted them.
    """
    if not len(squared):
        return 1.0
    return float(np.clip(np.sqrt(np.median(squared) / 0.455 / 0.87), 1.0, 4.0))


def _best(window, block, cost: np.ndarray, n: int) -> np.ndarray:
    """Return the window of least cost of each of n blocks, -1 where there is none."""
    order = np.lexsort((cost[window], block))
    first = order[np.r_[True, np.diff(block[order]) > 0]]
    best = np.full(n, -1)
    best[block[first]] = window[first]
    return best


def grown(windows: Windows, which: np.ndarray, depths: Depths, up: np.ndarray, steps: int = 3):
    """Fit the windows' planes to all blocks in reach, so that they settle on whole surfaces.

    Parameters
    ----------
    which : (W,) bool array
        The H windows to begin with.

    Returns
    -------
    planes : (H, 3) array
    squared : (N, H) array
        Squared errors of the blocks, infinite out of reach.
    """
    planes, centres = windows.planes[which], windows.centres[which]
    near = np.abs(centres[:, [0]] - depths.x[:, 0]) < REACH
    near &= np.abs(centres[:, [1]] - depths.x[:, 1]) < REACH
    rays, rho = depths.rays.T / depths.sigma, depths.rho / depths.sigma
    terms = _terms(depths) / np.square(depths.sigma)[:, None]
    for width in (2.0, *[1.0] * (steps - 1)):
        weight = _squared(planes, rays, rho)
        weight /= width**2
        weight += 1
        np.square(weight, out=weight)
        A, b = _equations(np.divide(near, weight, out=weight) @ terms)
        covariance = np.linalg.inv(A)
        planes = upright(np.einsum('nij,nj->ni', covariance, b), covariance, up)[0]
    squared = _squared(planes, rays, rho)
    squared[~near] = np.inf
    return planes, squared.T


def _squared(planes: np.ndarray, rays: np.ndarray, rho: np.ndarray) -> np.ndarray:
    """Return squared errors (H, N) on planes (H, 3) of rays (3, N) and rho (N,) over sigma."""
    # In place: each further array of this size costs as much as a sum.
    squared = planes @ rays
    squared += rho
    return np.square(squared, out=squared)


def upright(planes: np.ndarray, covariance: np.ndarray, up: np.ndarray):
    """Make planes (H, 3) with covariances (H, 3, 3) upright where they may be.

    Most walls are, and a wall seen in a few rows hardly knows its own slant. A plane that is not
    upright, for what is known of it, stays as it is.
    """
    toward = covariance @ up
    lean = np.square(UPRIGHT) * np.sum(planes**2, axis=1) / DEPENDENCE
    variance = toward @ up + lean
    off = planes @ up
    near = np.square(off) < GATE * DEPENDENCE * variance
    gain = np.where(near, 1 / variance, 0.0)[:, None] * toward
    return planes - gain * off[:, None], covariance - gain[:, :, None] * toward[:, None, :]
