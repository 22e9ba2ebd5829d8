"""Stationary planes of a key frame pair: known ones first, then one after another, [MVO] 4.3."""

from dataclasses import dataclass, replace

from mv_slapse.planes import consensus, lattice
from mv_slapse.planes.consensus import Depths
import numpy as np


@dataclass(frozen=True)
class PlaneFit:
    """A plane (3,) [1/baseline], its covariance (3, 3), and the mask (N,) of its blocks."""

    plane: np.ndarray
    covariance: np.ndarray
    member: np.ndarray
    id: int = -1
    is_ground: bool = False


@dataclass(frozen=True)
class Rules:
    """What makes a plane: settings of the extraction, see ExtractionSettings."""

    cut: float
    min_macroblocks: int
    trials: int
    radius: float
    max_planes: int
    max_uncertainty: float


def known_planes(depths: Depths, free: np.ndarray, prior_id: np.ndarray, rules: Rules,
                 rng: np.random.Generator) -> list[PlaneFit]:
    """Fit again the planes of the previous key frame, sampling inside their macroblocks only.

    Parameters
    ----------
    depths : Depths
        All blocks, (N,).
    free : (N,) bool array
        Blocks that may join a plane.
    prior_id : (N,) int array
        Id of the plane in whose macroblocks x_prev lies, -1 for none.
    """
    found = []
    names, counts = np.unique(prior_id[free & (prior_id >= 0)], return_counts=True)
    for name in names[np.argsort(-counts, kind='stable')]:
        seed = free & (prior_id == name)
        fit = fit_plane(depths, seed, free, rules, rng)
        if fit is not None and np.sum(fit.member & seed) > 0.5 * np.sum(seed):
            found.append(replace(fit, id=int(name)))
            free = free & ~fit.member
    return found


def new_planes(depths: Depths, free: np.ndarray, n: int, rules: Rules,
               rng: np.random.Generator) -> list[PlaneFit]:
    """Extract up to n planes, the largest first, from blocks that no plane holds yet."""
    found = []
    while len(found) < n:
        fit = fit_plane(depths, free, free, rules, rng)
        if fit is None:
            break
        found.append(fit)
        free = free & ~fit.member
    return found


def fit_plane(depths: Depths, seed, free, rules: Rules, rng) -> PlaneFit | None:
    """Find the plane with most support in ``seed`` (N,) and gather its blocks from ``free``.

    Returns None where no plane has ``min_macroblocks`` connected macroblocks, or where it is
    known too poorly to be of use.
    """
    sample = depths[seed]
    if len(sample) < 4:
        return None
    hypotheses = consensus.sample_planes(sample, rules.radius, rules.trials, rng)
    plane, _ = consensus.best_plane(sample, hypotheses, rules.cut)
    if plane is None:
        return None
    member = gather(depths, plane, free, rules)
    if not member.any():
        return None
    plane, covariance = consensus.refine_plane(depths[member], plane)
    member = gather(depths, plane, free, rules)
    weak = np.sqrt(np.trace(covariance)) > rules.max_uncertainty * np.linalg.norm(plane)
    if weak or lattice.count_macroblocks(depths.x[member]) < rules.min_macroblocks:
        return None
    return PlaneFit(plane, covariance, member)


def gather(depths: Depths, plane, free, rules: Rules) -> np.ndarray:
    """Return the mask (N,) of free blocks that agree with a plane and lie together.

    A block far from all others that agrees does so by chance: components of less than a quarter
    of the smallest plane are left out.
    """
    member = free & (np.abs(depths.error(plane)) < rules.cut)
    index = np.flatnonzero(member)
    member[index] = lattice.largest_components(depths.x[index], rules.min_macroblocks // 4)
    return member
