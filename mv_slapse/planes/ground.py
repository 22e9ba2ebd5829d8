"""The ground plane: below the camera, nearly level, and hard to see.

Road texture is weak and moves fast, so most of its vectors may be wrong and the largest consensus
in the lower picture may be a wrong one. What is known helps: its normal hardly changes from one
key frame to the next, and next to nothing lies below it.
"""

from mv_slapse.planes import consensus, lattice
from mv_slapse.planes.consensus import Depths
from mv_slapse.planes.extraction import gather, PlaneFit, Rules
import numpy as np

UP_CAM = np.array([0.0, -1.0, 0.0])  # a level camera: optical axes have y down


def find_ground(depths: Depths, free: np.ndarray, normal: np.ndarray, tilt: float, rules: Rules,
                rng: np.random.Generator) -> PlaneFit | None:
    """Find the ground among stationary blocks.

    Parameters
    ----------
    depths : Depths
    free : (N,) bool array
        Stationary blocks that are not at infinity.
    normal : (3,) array
        Expected unit normal, up, in camera k.
    tilt : float
        Standard deviation of its direction [rad]; beyond three of them it is not the ground.

    Returns
    -------
    fit : PlaneFit or None
        None where too few blocks agree, or too many lie below.
    """
    drop = -depths.rays @ normal
    below_horizon = free & (drop > 0.03) & (depths.rho > 0)
    sample = depths[below_horizon]
    if lattice.count_macroblocks(sample.x) < rules.min_macroblocks:
        return None
    level = normal * (sample.rho / drop[below_horizon])[:, None]
    level = level[rng.integers(len(level), size=rules.trials)]
    tilted = consensus.sample_planes(sample, 4 * rules.radius, rules.trials, rng)
    hypotheses = np.vstack([level, tilted])
    angle = _angle(hypotheses, normal) / tilt
    hypotheses, angle = hypotheses[angle < 3], angle[angle < 3]
    plane, _ = consensus.best_plane(sample, hypotheses, rules.cut, prior=angle**2)
    if plane is None:
        return None
    information = _direction_information(plane, normal, tilt)
    for _ in range(2):
        plane, covariance = consensus.refine_plane(
            sample, plane, prior_plane=normal * np.linalg.norm(plane),
            prior_information=information)
    member = gather(depths, plane, below_horizon, rules)
    n = lattice.count_macroblocks(depths.x[member])
    below = np.sum(sample.error(plane) < -rules.cut)
    if n < rules.min_macroblocks or below > member.sum() or plane @ normal <= 0:
        return None
    return PlaneFit(plane, covariance, member, is_ground=True)


def _angle(planes: np.ndarray, normal: np.ndarray) -> np.ndarray:
    """Angle [rad] between planes (N, 3) and a unit normal."""
    return np.arccos(np.clip(planes @ normal / np.linalg.norm(planes, axis=1), -1, 1))


def _direction_information(plane, normal, tilt) -> np.ndarray:
    """Information (3, 3) of a plane whose direction is known to ``tilt`` [rad], not its depth."""
    return (np.eye(3) - np.outer(normal, normal)) / (np.linalg.norm(plane) * tilt) ** 2
