"""Regions that move: which blocks of a labelled key frame pair belong to moving objects.

Definition 1 of [MVO] judges each block by itself, and a wrong vector looks like a moving object
to it. Here blocks that move alike are joined first, a moving plane is fitted to each region, and
the region is judged as a whole by two questions:

* Does any depth at or above the ground explain it as a still surface? Its rate g must then be
  rho t, with rho at least the ground's (direction, epipolar and below-ground constraints in one).
* Does it stand where it seems to be? An oncoming car looks like something still and nearer, which
  would hover over the ground that is seen right below it (the magnitude constraint).

The answers are squared distances. They are summed over key frame pairs along the vectors, so
that a slow mover becomes one in time and a wrong vector, which does not last, does not.
"""

from dataclasses import dataclass, replace

from mv_slapse.geometry import epipolar, moving_plane
from mv_slapse.geometry.camera import to_rays
from mv_slapse.geometry.homography import transfer
from mv_slapse.planes import lattice
from mv_slapse.planes.moving import fit_moving_plane, MovingPlane
from mv_slapse.records import Extraction, Label, PlaneObservation
import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

FIRST_ID = 100_000  # moving planes have ids of their own, from here on
REACH = 24.0  # px between centres of neighbours
ALIKE = (1.0, 0.12)  # px, share of the longer one: by how much neighbours' vectors may differ
LEAST = 4  # blocks, and as many macroblocks less a half
LEAST_SIGMA = 0.25  # px, of a vector on a small surface, whatever the pair's calibration says
BIAS = 0.35  # px that a region's vectors have in common
ON_GROUND = 0.2  # share of the ground's inverse depth within which a block is ground
BELOW_GROUND = 0.75  # share of the ground's inverse depth below which nothing still can be
LEAST_DROP = 12.0  # px below the horizon from which on a lower edge tells something
LOWEST, TALLEST = 0.35, 2.0  # heights of a camera, of what may be a vehicle or a person
RELIEF = 0.04  # share of a region's rate by which it errs where the region is no plane,
WIDE = 250.0  # px, if it is as wide as this
HOVER_SIGMA = 0.15  # of the log of apparent over ground's inverse depth: the edge's block
STEP = 60.0  # largest part of the score of one pair
FADING = 0.7  # of the score from pair to pair


@dataclass(frozen=True)
class Region:
    """Blocks that move alike, and how badly a still surface explains them.

    Attributes
    ----------
    member : (M,) int
        Indices of its correspondences.
    fit : MovingPlane
    score : float
        Sum of squared distances beyond what noise gives.
    id : int
        -1 until it is called moving.
    """

    member: np.ndarray
    fit: MovingPlane
    score: float
    id: int = -1


@dataclass(frozen=True)
class Memory:
    """Regions of the previous key frame: a grid of their numbers, and the regions."""

    stamp: int | None = None
    grid: np.ndarray | None = None
    regions: tuple[Region, ...] = ()
    next_id: int = FIRST_ID


@dataclass(frozen=True)
class _Field:
    """Motion of all blocks after removing rotation, and which cannot belong to an obstacle.

    ``ground_like`` blocks move as the ground does, ``far`` ones above the horizon do not move.
    """

    x: np.ndarray
    block: np.ndarray
    parallax: np.ndarray
    ground_like: np.ndarray
    far: np.ndarray
    plane_id: np.ndarray
    ground: np.ndarray | None


def with_moving_planes(extraction: Extraction, ground: np.ndarray | None, memory: Memory,
                       threshold: float) -> tuple[Extraction, Memory]:
    """Add the moving planes of a pair to what was found stationary in it.

    Parameters
    ----------
    extraction : Extraction
        With motion, stationary planes and labels.
    ground : (3,) array or None
        Ground plane n / d in camera k [1/baseline], seen or predicted.
    memory : Memory
        What the last call returned.
    threshold : float
        Score from which on a region is called moving; chi-square beyond its mean.

    Returns
    -------
    extraction : Extraction
        Blocks of moving regions are labelled MOVING with the plane's id.
    memory : Memory
        For the next pair.
    """
    motion_field = _motion_field(extraction, ground)
    came_from = _origin(extraction, memory)
    regions = [_scored(extraction, motion_field, member, came_from, memory)
               for member in _alike(motion_field)]
    regions = [region for region in regions if region is not None]
    regions, next_id = _named(regions, came_from, memory, threshold)
    numbers = np.full(len(extraction.x_cur), -1, np.int32)
    for i, region in enumerate(regions):
        numbers[region.member] = i
    grid = lattice.paint(extraction.width, extraction.height, extraction.x_cur,
                         extraction.block, numbers)
    moving = [region for region in regions if region.id >= 0]
    moving = _grown(extraction, motion_field, moving)
    return _labelled(extraction, moving), Memory(extraction.stamp, grid, tuple(regions), next_id)


def _motion_field(extraction, ground):
    """Judge the blocks singly: those on the ground and those without parallax are left out."""
    K, motion = extraction.K, extraction.motion
    R, t = motion.R_cur_from_prev, motion.t_cur_from_prev
    x = extraction.x_cur.astype(float)
    rays, before = to_rays(K, x), to_rays(K, extraction.x_prev.astype(float))
    focal = np.diag(K)[:2]
    parallax = epipolar.parallax(rays, before, focal, R)
    under = -(rays @ ground) if ground is not None else np.zeros(len(x))
    rho, per_pixel = epipolar.inverse_depth(rays, before, focal, R, t)
    error = np.abs(epipolar.epipolar_error(rays, before, focal, R, t)) / extraction.sigma
    slack = 3 * per_pixel * extraction.sigma + ON_GROUND * under
    ground_like = (under > 0) & (error < 4) & (np.abs(rho - under) < slack)
    far = (under <= 0) & (np.linalg.norm(parallax, axis=1) < 1.5)
    return _Field(x, extraction.block.astype(float), parallax, ground_like, far,
                  extraction.plane_id, ground)


def _origin(extraction, memory):
    """Return the number of the previous region that each block comes from, -1 for none."""
    if memory.grid is None or memory.stamp != extraction.previous_stamp:
        return np.full(len(extraction.x_cur), -1)
    return lattice.lookup(memory.grid, extraction.x_prev.astype(float))


def _alike(motion_field):
    """Return the members of each connected set of neighbours whose vectors are alike."""
    a, b = _alike_pairs(motion_field)
    usable = ~motion_field.ground_like | _bridges(motion_field, a, b)
    joined = usable[a] & usable[b]
    index = np.flatnonzero(usable & ~motion_field.far)
    n = len(motion_field.x)
    graph = coo_matrix((np.ones(joined.sum()), (a[joined], b[joined])), shape=(n, n))
    part = connected_components(graph, directed=False)[1][index]
    order = np.argsort(part, kind='stable')
    sets = np.split(index[order], np.flatnonzero(np.diff(part[order])) + 1)
    area = motion_field.block.prod(axis=1) / lattice.MACROBLOCK**2
    return [s for s in sets if len(s) >= LEAST and area[s].sum() >= LEAST - 0.5]


def _alike_pairs(motion_field):
    """Return the two blocks (P,), (P,) of each pair of neighbours whose vectors are alike."""
    x, m, plane = motion_field.x, motion_field.parallax, motion_field.plane_id
    if not len(x):
        return np.zeros((2, 0), int)
    a, b = cKDTree(x).query_pairs(REACH, output_type='ndarray').T
    longer = np.maximum(np.linalg.norm(m[a], axis=1), np.linalg.norm(m[b], axis=1))
    same = np.linalg.norm(m[a] - m[b], axis=1) < ALIKE[0] + ALIKE[1] * longer
    # A car before a facade may move as it does for a while: what is a plane stays by itself.
    same &= (plane[a] == plane[b]) & ~motion_field.far[a] & ~motion_field.far[b]
    return a[same], b[same]


def _bridges(motion_field, a, b):
    """Return the blocks that move as the ground does, but as their neighbours up and down, too.

    A car ahead shows all its blocks at one depth, and at one of its rows the ground has it.
    """
    y = motion_field.x[:, 1]
    found = np.zeros((2, len(y)), bool)
    for one, other in ((a, b), (b, a)):
        beside = ~motion_field.ground_like[other] & (np.abs(
            motion_field.x[one, 0] - motion_field.x[other, 0]) < lattice.MACROBLOCK / 2)
        found[0, one[beside & (y[other] < y[one])]] = True
        found[1, one[beside & (y[other] > y[one])]] = True
    return motion_field.ground_like & found[0] & found[1]


def _scored(extraction, motion_field, member, came_from, memory):
    """Return the Region of a set of blocks with its score, None where no plane fits."""
    motion = extraction.motion
    x = motion_field.x[member]
    sigma = np.maximum(extraction.sigma[member], LEAST_SIGMA)
    fit = fit_moving_plane(x, extraction.x_prev[member], sigma, motion_field.block[member],
                           extraction.K, motion.R_cur_from_prev, motion.t_cur_from_prev,
                           motion_field.ground)
    if fit is None:
        return None
    score = float(np.clip(_distance(extraction, motion_field, x, member, fit), -5, STEP))
    number = _majority(came_from[member])
    if number >= 0:
        score += FADING * memory.regions[number].score
    return Region(member, fit, score)


def _distance(extraction, motion_field, x, member, fit):
    """Return how far a region is from all still surfaces, less what noise gives."""
    t, K = extraction.motion.t_cur_from_prev, extraction.K
    theta, by_state = moving_plane.from_plane(fit.plane, fit.t_d, fit.centre, t)
    rate = theta[moving_plane.RATE]
    size = np.ptp(x, axis=0) + lattice.MACROBLOCK
    bias = np.r_[BIAS / np.diag(K)[:2], BIAS / (0.5 * np.min(size))]
    # A surface that is not one plane shifts its rate by a share of it.
    shape = (RELIEF * np.linalg.norm(rate) * min(1.0, np.max(size) / WIDE))**2
    W = np.linalg.inv((by_state @ fit.covariance @ by_state.T)[:3, :3] + np.diag(bias**2 + shape))
    apparent, sigma = (rate @ W @ t) / (t @ W @ t), 1 / np.sqrt(t @ W @ t)
    contact = moving_plane.contact(x, motion_field.block[member])
    under, drop = _ground_at(motion_field.ground, contact, K)
    # The lower edge may lie a block higher than it seems, where the ground is farther.
    least = BELOW_GROUND * under * max(drop - lattice.MACROBLOCK, 0) / drop if drop > 0 else 0
    error = rate - max(apparent, least) * t
    distance = error @ W @ error - 3
    if not drop > LEAST_DROP:
        return distance
    if size[1] < LOWEST * drop:
        # Flat on the road: wrong vectors of the road, as no vehicle is that low.
        return min(distance, 0.0)
    if size[1] > TALLEST * drop:
        return distance
    return distance + _hovering(motion_field, x, contact, apparent / under, sigma / under, size)


def _ground_at(ground, contact, K):
    """Return the ground's inverse depth at a lower edge and its rows below the horizon."""
    if ground is None or ground[1] >= 0:
        return 0.0, 0.0
    under = -ground @ np.linalg.solve(K, np.r_[contact.point, 1.0])
    return under, under / (-ground[1] / K[1, 1])


def _hovering(motion_field, x, contact, ratio, sigma, size):
    """Return the squared distance of a region from standing on the ground seen right below."""
    if ratio < 1.2:
        return 0.0
    across = np.abs(motion_field.x[:, 0] - contact.point[0]) < size[0] / 2
    below = motion_field.x[:, 1] - contact.point[1]
    seen = across & (below > 0) & (below < 1.75 * lattice.MACROBLOCK)
    if not seen.any() or motion_field.ground_like[seen].mean() <= 0.5:
        return 0.0
    return (np.log(ratio) / np.hypot(HOVER_SIGMA, sigma / ratio))**2 - 1


def _majority(numbers):
    """Return the number that at least half of the blocks have, else -1."""
    known = numbers[numbers >= 0]
    if 2 * len(known) < len(numbers):
        return -1
    return int(np.argmax(np.bincount(known)))


def _named(regions, came_from, memory, threshold):
    """Give ids to the regions that move: that of the region they come from, or a new one."""
    named, taken, next_id = [], set(), memory.next_id
    for region in sorted(regions, key=lambda item: -len(item.member)):
        number = _majority(came_from[region.member])
        before = memory.regions[number].id if number >= 0 else -1
        # What was called moving is given up later than it was found.
        if region.score >= (0.5 if before >= 0 else 1.0) * threshold:
            id_ = before if before >= 0 and before not in taken else next_id
            next_id += id_ == next_id
            taken.add(id_)
            region = replace(region, id=id_)
        named.append(region)
    return named, next_id


def _grown(extraction, motion_field, moving):
    """Add the blocks in and around each moving region that move with its plane, not the ground."""
    free = ~motion_field.ground_like
    for region in moving:
        free[region.member] = False
    grown = []
    for region in sorted(moving, key=lambda item: -len(item.member)):
        x = motion_field.x[region.member]
        low, high = x.min(axis=0) - lattice.MACROBLOCK, x.max(axis=0) + lattice.MACROBLOCK
        near = np.flatnonzero(free & np.all((motion_field.x >= low) & (motion_field.x <= high),
                                            axis=1))
        H = moving_plane.homography(region.fit.product, extraction.K,
                                    extraction.motion.R_cur_from_prev)
        error = np.linalg.norm(transfer(H, motion_field.x[near]) - extraction.x_prev[near], axis=1)
        length = np.linalg.norm(motion_field.parallax[near], axis=1)
        joins = near[error < ALIKE[0] + ALIKE[1] * length]
        free[joins] = False
        grown.append(replace(region, member=np.r_[region.member, joins]))
    return grown


def _labelled(extraction, moving):
    """Write the moving regions down, over what their blocks were taken for."""
    label, plane_id = extraction.label.copy(), extraction.plane_id.copy()
    found = []
    for region in moving:
        label[region.member] = Label.MOVING
        plane_id[region.member] = region.id
        fit = region.fit
        found.append(PlaneObservation(
            region.id, Label.MOVING, fit.plane, fit.covariance, fit.t_d, fit.product,
            fit.scale_prior, False, lattice.count_macroblocks(extraction.x_cur[region.member])))
    return replace(extraction, label=label, plane_id=plane_id,
                   planes=(*extraction.planes, *found))
