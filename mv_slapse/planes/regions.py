"""Moving regions: blocks that no stationary point can explain and that move alike, [MVO] 4.2.

A wrong vector contradicts the camera's motion as well as a mover's does. What tells them apart is
support: a mover's blocks touch, agree with each other, and rise from the ground; wrong vectors
scatter, and where the encoder goes wrong in bulk, on the road, they lie flat.
"""

from dataclasses import dataclass

from mv_slapse.geometry import epipolar, homography, two_view
from mv_slapse.planes import lattice
from mv_slapse.planes.labeling import Evidence
from mv_slapse.planes.moving import fit_moving_plane, MovingPlane
import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

REACH = 25.0  # px: blocks of 16 px touch at 16 and, over a corner, at 23
ALIKE = 1.0, 0.1  # px and share of motion by which vectors of one body differ between neighbours
LEAST_ERROR = 1.0  # px: less than this is an inexact vector, not a motion
AGREE = 3.0  # standard deviations


@dataclass(frozen=True)
class MovingRegion:
    """A moving plane and the mask (N,) of its blocks; id -1: not seen before."""

    fit: MovingPlane
    member: np.ndarray
    id: int = -1


@dataclass(frozen=True)
class Scene:
    """What a region is judged against.

    Attributes
    ----------
    pair : Pair
    x_cur, block : (N, 2) arrays
        [px].
    R, t : (3, 3), (3,) arrays
        Camera motion, |t| = 1 or, for a standing camera, 0.
    ground : (3,) array or None
        n / d in camera k [1/baseline].
    min_macroblocks : int
        Smallest region.
    """

    pair: two_view.Pair
    x_cur: np.ndarray
    block: np.ndarray
    R: np.ndarray
    t: np.ndarray
    ground: np.ndarray | None
    min_macroblocks: int


def suspects(scene: Scene, evidence: Evidence) -> np.ndarray:
    """Return the blocks (N,) that no stationary point before the camera explains.

    Off the epipolar line, against the stationary flow (the direction constraint), or slower
    than the ground on their ray: a stationary point would lie below it. The last takes the place
    of [MVO]'s magnitude constraint, a line fitted along each epipolar line.
    """
    sigma = scene.pair.sigma
    off_line = ~evidence.epipolar_inlier & (np.abs(evidence.epipolar_error) * sigma > LEAST_ERROR)
    suspect = off_line | evidence.backward
    if scene.ground is None:
        return suspect
    on_ground = -scene.pair.rays_cur @ scene.ground
    per_pixel = _per_pixel(scene, np.maximum(on_ground, 0))
    short = (on_ground - evidence.rho) / np.maximum(per_pixel, 1e-12)
    slow = (on_ground > 0) & (short > 2 * LEAST_ERROR) & (short > 4 * sigma)
    # The ground's own relief leaves it a share of its parallax.
    slow &= short > 0.2 * on_ground / np.maximum(per_pixel, 1e-12)
    return suspect | (evidence.epipolar_inlier & slow)


def _per_pixel(scene: Scene, rho) -> np.ndarray:
    """Return the inverse depth (N,) that a pixel of parallax is worth at inverse depth rho."""
    g = (scene.t[:2] - scene.pair.rays_cur[:, :2] * scene.t[2]) * scene.pair.focal
    return np.square(1 - rho * scene.t[2]) / np.maximum(np.hypot(g[:, 0], g[:, 1]), 1e-9)


def bodies(scene: Scene, suspect: np.ndarray) -> list[np.ndarray]:
    """Group suspects into sets of touching blocks that move alike; masks (N,), largest first."""
    index = np.flatnonzero(suspect)
    if len(index) < 2:
        return []
    x = scene.x_cur[index]
    flow = epipolar.parallax(scene.pair.rays_cur, scene.pair.rays_prev, scene.pair.focal,
                             scene.R)[index]
    i, j = cKDTree(x).query_pairs(REACH, output_type='ndarray').T
    length = np.minimum(*np.linalg.norm(flow[[i, j]], axis=2))
    alike = np.linalg.norm(flow[i] - flow[j], axis=1) < ALIKE[0] + ALIKE[1] * length
    graph = coo_matrix((np.ones(alike.sum()), (i[alike], j[alike])), shape=(len(x), len(x)))
    count, label = connected_components(graph, directed=False)
    groups = [index[label == k] for k in range(count)]
    groups = [g for g in groups
              if lattice.count_macroblocks(scene.x_cur[g]) >= scene.min_macroblocks]
    masks = np.zeros((len(groups), len(suspect)), bool)
    for mask, group in zip(masks, groups, strict=True):
        mask[group] = True
    return sorted(masks, key=lambda mask: -mask.sum())


def find(scene: Scene, suspect: np.ndarray, free: np.ndarray,
         prior_id: np.ndarray) -> list[MovingRegion]:
    """Find the moving regions of a key frame pair, the largest first.

    Parameters
    ----------
    scene : Scene
    suspect : (N,) bool array
        See suspects.
    free : (N,) bool array
        Blocks that a region may take in besides, when they move with it.
    prior_id : (N,) int array
        Id that the region had in whose macroblocks x_prev lies, -1 for none.
    """
    found = []
    for body in bodies(scene, suspect):
        body = body & ~np.any([region.member for region in found], axis=0) if found else body
        region = _region(scene, body, free, prior_id, {region.id for region in found})
        if region is not None:
            found.append(region)
    return found


def _region(scene, body, free, prior_id, taken) -> MovingRegion | None:
    """Fit one body and gather its blocks; None where it is no moving surface."""
    fit = _fit(scene, body)
    if fit is None or fit.inlier.mean() < 0.6:
        return None
    member = body.copy()
    member[np.flatnonzero(body)] = fit.inlier
    member |= _joining(scene, fit, member, free)
    if lattice.count_macroblocks(scene.x_cur[member]) < scene.min_macroblocks:
        return None
    if lies_flat(scene, member):
        return None
    fit = _fit(scene, member)
    if fit is None:
        return None
    names, counts = np.unique(prior_id[member & (prior_id >= 0)], return_counts=True)
    keep = [int(name) for name, count in zip(names, counts, strict=True)
            if name not in taken and count > 0.3 * member.sum()
            and count > 0.5 * np.sum(prior_id == name)]
    return MovingRegion(fit, member, keep[0] if keep else -1)


def _fit(scene, member) -> MovingPlane | None:
    """Fit the moving plane of a set of blocks."""
    pair = scene.pair
    return fit_moving_plane(scene.x_cur[member], pair.x_prev[member], pair.sigma[member],
                            scene.block[member], pair.K, scene.R, scene.t, scene.ground)


def _joining(scene, fit: MovingPlane, member, free) -> np.ndarray:
    """Return free blocks (N,) that touch a body's box and move with it."""
    low = scene.x_cur[member].min(axis=0) - lattice.MACROBLOCK
    high = scene.x_cur[member].max(axis=0) + lattice.MACROBLOCK
    near = free & ~member & np.all((scene.x_cur >= low) & (scene.x_cur <= high), axis=1)
    pair = scene.pair
    predicted = homography.plane_transfer(pair.rays_cur[near], pair.K, scene.R,
                                          scene.t - fit.t_d, fit.plane)
    error = np.linalg.norm(predicted - pair.x_prev[near], axis=1) / pair.sigma[near]
    near[np.flatnonzero(near)] = error < AGREE
    return near


def lies_flat(scene: Scene, member: np.ndarray) -> bool:
    """Tell whether a region is a patch of road: it does not rise from where it stands.

    A body whose lowest row stands on the ground at depth Z and whose top row lies a share s of
    that drop below the horizon is 1 - s camera heights tall. Bodies that matter are at least
    half as tall as the camera rides; a patch of road with wrong vectors is not.
    """
    if scene.ground is None:
        return False
    drop = -scene.pair.rays_cur[member] @ scene.ground
    half = scene.block[member, 1] / 2 * abs(scene.ground[1]) / scene.pair.focal[1]
    bottom, top = np.max(drop + half), np.min(drop - half)
    return bottom > 0 and top > 0.5 * bottom
