"""Regions that move: which blocks of a labelled key frame pair belong to moving objects.

Definition 1 of [MVO] judges each block by itself, and a wrong vector looks like a moving object
to it. Here blocks that move alike are joined first, a moving plane is fitted to each region, and
the region is judged as a whole (planes.region_scores). Its score is summed over key frame pairs
along the vectors, so that a slow mover becomes one in time and a wrong vector, which does not
last, does not.
"""

from dataclasses import dataclass, replace
from typing import NamedTuple

from mv_slapse.config import USUAL_HEIGHT
from mv_slapse.geometry import epipolar, lattice, moving_plane
from mv_slapse.geometry.camera import to_rays
from mv_slapse.geometry.homography import transfer
from mv_slapse.movers import body
from mv_slapse.movers.identity import better_half, FIRST_ID, ids_of, majority, Memory
from mv_slapse.movers.moving_plane import fit_surfaces, MovingPlane, Regions, settled, Surfaces
from mv_slapse.movers.outlines import Blocks, outlines, REPEATED
from mv_slapse.movers.score import departures, OUTLIER, scores, Seen
from mv_slapse.movers.unsupported import with_lone
from mv_slapse.records import Extraction, Label, MotionStatus, PlaneObservation
import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

REACH = 24.0  # px between centres of neighbours
ALIKE = (1.0, 0.12, 0.06)  # px, share of the longer one: by how much neighbours' vectors may
                           # differ, and this share once the growth by depth is taken off
ALIKE_SHORT = 0.15  # share of the median vector that the former is at most, down to a half
ALIKE_BESIDE = 0.25  # share of a vector beside a region that it is at most, down to a half
INSIDE = 2.5  # times as much within a region
SAME_PLANE = 0.7  # share of a region and of a plane that they have in common if they are one
LEAST = 4  # blocks, and as many macroblocks less a half
LEAST_SIGMA = 0.25  # px, of a vector on a small surface, whatever the pair's calibration says
SHAPE = 0.04  # share of a vector by which it errs as vehicles and people are no planes
ON_GROUND = 0.2  # share of the ground's inverse depth within which a block is ground
BELOW_GROUND = 0.7  # share of the ground's inverse depth below which nothing still can be
RISING = (0.3, 2)  # share of a car's departed blocks off it, 0.3 to 1 as measured, and number
FITS = 3.0  # sigma of the epipolar error of a block whose apparent depth tells something
FAR = 1.5  # px of parallax, less is far off,
RESTING = 0.75  # px, or rests where the camera stands
RECEDING = 0.5  # share of its depth by which a thing may at most go away in a pair
GROWTH = 1.0  # [1/s] to which things grow or shrink before it: contact in a second
FADING = 0.85  # of the score from pair to pair
KEPT = 0.5  # of the score at which a region moves: enough for what was or is beside a mover


@dataclass(frozen=True)
class _Field:
    """Motion of all blocks after removing rotation, and which cannot belong to an obstacle.

    ``ground_like`` blocks move as the ground does and have not left where they stood, ``far`` ones
    above the horizon do not move, ``below`` ones look farther than the ground that they would
    hide; those that ``fits`` tells of move along their epipolar lines. ``growth`` is what their
    depth makes the parallax grow by for each px outwards; to ``free_growth`` it may be any.
    """

    x: np.ndarray
    block: np.ndarray
    parallax: np.ndarray
    rho: np.ndarray
    ground_like: np.ndarray
    far: np.ndarray
    below: np.ndarray
    fits: np.ndarray
    departure: np.ndarray
    growth: np.ndarray
    free_growth: float
    plane_id: np.ndarray
    ground: np.ndarray | None
    nearer: float
    level: np.ndarray | None
    seen: Seen
    seen_or_lone: Seen


class _Fitted(NamedTuple):
    """Blocks (N,) of all regions, one after the other, and the planes fitted to them."""

    at: np.ndarray
    regions: Regions
    fit: Surfaces


def with_moving_planes(extraction: Extraction, ground: np.ndarray | None, memory: Memory,
                       threshold: float, level: np.ndarray | None = None,
                       departure: np.ndarray | None = None, lone: Extraction | None = None,
                       nearer: float = 1.0, camera_height: float = USUAL_HEIGHT
                       ) -> tuple[Extraction, Memory]:
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
    level : (3,) array, optional
        Up in camera k, where the ground is not known.
    departure : (N,) array, optional
        As of planes.past.departure.
    lone : Extraction, optional
        Vectors that no neighbour supports: they tell of the ground below a region.
    nearer : float
        The ground may be this many times nearer, a guess: it tells what looks farther only.
    camera_height : float
        Above the ground [m].

    Returns
    -------
    extraction : Extraction
        Blocks of moving regions are labelled MOVING with the plane's id.
    memory : Memory
        For the next pair.
    """
    motion_field = _motion_field(
        extraction, ground, level if ground is None else ground,
        np.zeros(len(extraction.x_cur)) if departure is None else departure, lone, nearer)
    members = body.with_bodies(_alike(motion_field), motion_field,
                                 (extraction.width, extraction.height), LEAST, REACH)
    found = _fitted(extraction, motion_field, members)
    score, left, before = memory.inherited(extraction)
    now, leaves = _scored(extraction, motion_field, found, camera_height)
    total = now + FADING * better_half(members, score)
    gone = np.maximum(leaves + FADING * better_half(members, left), 0.0)
    known = majority(members, before)
    known = np.where(known >= 0, known, _covered(members, extraction))
    moves = _moves(members, motion_field, np.maximum(total, gone), known, threshold)
    ids, next_id = ids_of(members, moves, known, memory.next_id)
    # What is in no region this time is not forgotten at once.
    score = FADING * np.nan_to_num(score) * ~motion_field.ground_like
    left, before = FADING * np.nan_to_num(left), np.full(len(before), -1)
    for member, *values in zip(members, total, gone, ids, strict=True):
        score[member], left[member], before[member] = values
    moving = sorted(np.flatnonzero(ids >= 0), key=lambda i: -len(members[i]))
    planes = {int(ids[i]): (members[i], _plane(extraction, motion_field, found, i),
                            float(max(total[i], gone[i])), float(gone[i])) for i in moving}
    return (_labelled(extraction, motion_field, planes),
            memory.after(extraction, score, left, before, next_id, FADING))


def _motion_field(extraction, ground, level, departure, lone, nearer):
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
    noise = per_pixel * extraction.sigma
    slack = 3 * noise + ON_GROUND * under
    # The lower rows of a car that starts look as far as the road before it.
    ground_like = ((under > 0) & (error < 4) & (rho - under > -slack)
                   & (rho - nearer * under < slack) & (departure <= 0))
    least = FAR if np.any(t) else RESTING
    far = (under <= 0) & (np.linalg.norm(parallax, axis=1) < least)
    below = rho + 2 * noise < BELOW_GROUND * under
    # What moves against the flow shows no depth.
    nearing = np.maximum(-t[2] * np.maximum(rho, 0.0), -RECEDING)
    pair_time = 1e-9 * (extraction.stamp - extraction.previous_stamp)
    free_growth = GROWTH * pair_time * (motion.status is MotionStatus.STANDSTILL)
    seen = Seen(x, rho, noise, under, _copied(extraction), np.full(len(x), OUTLIER))
    return _Field(x, extraction.block.astype(float), parallax, rho, ground_like, far, below,
                  error < FITS, departure, nearing / (1 + nearing), free_growth,
                  extraction.plane_id, ground, nearer, level, seen,
                  with_lone(seen, lone, motion, ground))


def _copied(extraction):
    """Return the blocks (N,) bool whose vector nothing still explains and a neighbour repeats."""
    copied, wrong = np.zeros(len(extraction.label), bool), extraction.label == Label.UNKNOWN
    vector = (extraction.x_prev - extraction.x_cur)[wrong]
    near = cKDTree(np.c_[extraction.x_cur[wrong] / REACH, vector / REPEATED])
    pairs = near.query_pairs(1.0, p=np.inf, output_type='ndarray')
    copied[np.flatnonzero(wrong)[pairs.ravel()]] = True
    return copied


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
    # Where all vectors are short a pixel would join the whole scene.
    slack = np.clip(ALIKE_SHORT * np.median(np.linalg.norm(m, axis=1)), 0.5, 1.0) * ALIKE[0]
    # What comes near grows, and shrinks before a camera that drives back: the vectors of one
    # surface differ the more the farther apart they are.
    by, (growth, more) = x[a] - x[b], (motion_field.growth[at] for at in (a, b))
    growth = np.where(np.abs(growth) < np.abs(more), growth, more)
    own = _own_growth(motion_field, a, b) if motion_field.free_growth else ()
    apart, *left = (np.linalg.norm(m[a] - m[b] - share[:, None] * by, axis=1)
                    for share in (np.zeros(len(a)), growth, *own))
    same = (apart < slack + ALIKE[1] * longer) | (np.min(left, axis=0) < slack + ALIKE[2] * longer)
    # A car before a facade may move as it does for a while: what is a plane stays by itself.
    same &= (plane[a] == plane[b]) & ~motion_field.far[a] & ~motion_field.far[b]
    # A car ahead may move as what is far behind it does; but that is not farther than the ground.
    same &= motion_field.below[a] == motion_field.below[b]
    a, b = a[same], b[same]
    # What has left where it stood is no part of what stands there, behind it or above it.
    sign = np.sign(motion_field.departure)
    left = sign + np.bincount(a, sign[b], len(x)) + np.bincount(b, sign[a], len(x)) > 0
    same = left[a] == left[b]
    return a[same], b[same]


def _own_growth(motion_field, a, b):
    """Return the growth (P,), (P,) about either block of each pair, by its moving neighbours.

    What parts from what is beside it stretches in one direction only.
    """
    by, m, n = motion_field.x[a] - motion_field.x[b], motion_field.parallax, len(motion_field.x)
    moves = np.linalg.norm(m, axis=1) > RESTING
    stretch, size = (sum(np.bincount(at, (moves[a] & moves[b]) * np.sum(values * by, axis=1), n)
                         for at in (a, b)) for values in (m[a] - m[b], by))
    own = stretch / np.maximum(size, 1.0)
    return tuple((own * (np.abs(own) <= motion_field.free_growth))[at] for at in (a, b))


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


def _fitted(extraction, motion_field, members):
    """Return the moving planes of all regions, None where there is no region."""
    if not members:
        return None
    at = np.concatenate(members)
    first = np.cumsum([0] + [len(member) for member in members[:-1]])
    shape = SHAPE * np.linalg.norm(motion_field.parallax[at], axis=1)
    regions = Regions(to_rays(extraction.K, motion_field.x[at]),
                      extraction.x_prev[at].astype(float),
                      np.hypot(np.maximum(extraction.sigma[at], LEAST_SIGMA), shape), first)
    return _Fitted(at, regions, fit_surfaces(
        regions, extraction.K, extraction.motion.R_cur_from_prev, motion_field.ground))


def _scored(extraction, motion_field, found, camera_height):
    """Return the scores (R,), (R,) of each region in this pair; 0 where no plane fits.

    That it moves, and that it has left where it stood.
    """
    if found is None:
        return np.zeros(0), np.zeros(0)
    fits = np.isfinite(found.fit.variance)
    fit = found.fit._replace(variance=np.where(fits, found.fit.variance, 1.0))
    at = found.at
    vector = extraction.x_prev[at] - motion_field.x[at]
    blocks = Blocks(motion_field.x[at], motion_field.block[at], vector,
                    vector + motion_field.parallax[at], motion_field.rho[at],
                    motion_field.seen.sigma[at], found.regions.first)
    outline = outlines(blocks, extraction.K, motion_field.ground, motion_field.level,
                       camera_height)
    score = scores(fit, outline, extraction.K, extraction.motion.t_cur_from_prev,
                   motion_field.seen, motion_field.seen_or_lone, motion_field.nearer)
    leaves = departures(outline, _departed(motion_field, found), motion_field.seen)
    return np.where(fits, score, 0.0), np.where(fits, leaves, 0.0)


def _departed(motion_field, found):
    """Return the log-likelihood (R,) that each region has left where it stood.

    Where a mover was taken for something still the road is farther afterwards, too; but there
    nothing rises from it.
    """
    first, likelihood = found.regions.first, motion_field.departure[found.at]
    left, under = likelihood > 0, motion_field.seen.under[found.at]
    rises = np.abs(motion_field.rho[found.at] - under) > ON_GROUND * under
    likelihood, off_road, left = (np.add.reduceat(values.astype(float), first)
                                  for values in (likelihood, left & rises, left))
    body = off_road >= np.maximum(RISING[0] * left, RISING[1])
    return np.where(body, likelihood, np.minimum(likelihood, 0.0))


def _plane(extraction, motion_field, found, i) -> MovingPlane | None:
    """Return the moving plane of region i, its gauge settled."""
    first = found.regions.first[i]
    at = found.at[first:first + found.regions.size[i]]
    return settled(found.fit.only(i, found.regions), motion_field.x[at], motion_field.block[at],
                   extraction.K, extraction.motion.t_cur_from_prev,
                   motion_field.ground if motion_field.nearer == 1 else None)


def _covered(members, extraction):
    """Return the stationary plane (R,) that each region is most of, -1 for none.

    A parked car that starts keeps its plane's id, by which its state passes to the obstacles.
    """
    ground = {plane.id for plane in extraction.planes if plane.is_ground} | {-1}
    result = np.full(len(members), -1)
    for i, member in enumerate(members):
        values, count = np.unique(extraction.plane_id[member], return_counts=True)
        id_, n = int(values[count.argmax()]), count.max()
        covers = SAME_PLANE * np.sum(extraction.plane_id == id_)
        if id_ not in ground and n >= max(SAME_PLANE * len(member), covers):
            result[i] = id_
    return result


def _moves(members, motion_field, score, before, threshold):
    """Return which regions (R,) move.

    What was called moving is given up later than it was found. So is what lies beside it and is
    half as sure: the rest of a vehicle that fell to pieces. Not what ends above the horizon.
    """
    x, under = motion_field.x, motion_field.seen.under
    stands = np.array([motion_field.ground is None or np.any(under[member] > 0)
                       for member in members], bool)
    suspect = stands & (score >= KEPT * threshold)
    moves = (score >= threshold) | suspect & (before >= FIRST_ID)
    if np.any(moves) and np.any(suspect & ~moves):
        tree = cKDTree(np.concatenate([x[members[i]] for i in np.flatnonzero(moves)]))
        for i in np.flatnonzero(suspect & ~moves):
            moves[i] = np.min(tree.query(x[members[i]])[0]) < REACH
    return moves


def _grown(extraction, motion_field, moving):
    """Add the blocks in and around each moving region that move with its plane, not the ground."""
    free = ~motion_field.ground_like
    for member, *_ in moving:
        free[member] = False
    grown = []
    for member, fit, *_ in moving:
        x = motion_field.x[member]
        low, high = x.min(axis=0) - lattice.MACROBLOCK, x.max(axis=0) + lattice.MACROBLOCK
        # Of a car ahead the part near the horizon is never clearly farther than the ground.
        low[1] -= 0.5 * (high[1] - low[1])
        near = np.flatnonzero(free & np.all((motion_field.x >= low) & (motion_field.x <= high),
                                            axis=1))
        H = moving_plane.homography(fit.product, extraction.K, extraction.motion.R_cur_from_prev)
        error = np.linalg.norm(transfer(H, motion_field.x[near]) - extraction.x_prev[near], axis=1)
        length = np.linalg.norm(motion_field.parallax[near], axis=1)
        within = np.all((motion_field.x[near] >= x.min(axis=0))
                        & (motion_field.x[near] <= x.max(axis=0)), axis=1)
        # What a vehicle encloses is part of it, also where its vector is wrong or another face's.
        # Beside it a pixel would join all that hardly moves.
        pixel = np.where(within, ALIKE[0], np.clip(ALIKE_BESIDE * length, 0.5, ALIKE[0]))
        slack = np.where(within, INSIDE, 1.0) * (pixel + ALIKE[1] * length)
        # What is far behind a car ahead moves as it does, too.
        fits = (error < slack) & (within | ~motion_field.far[near])
        joins = near[fits | within & (extraction.label[near] == Label.UNKNOWN)]
        free[joins] = False
        grown.append(np.r_[member, joins])
    return grown


def _labelled(extraction, motion_field, planes):
    """Write moving planes {id: (member, plane, score, departed)} over blocks' first labels."""
    label, plane_id = extraction.label.copy(), extraction.plane_id.copy()
    planes = {id_: plane for id_, plane in planes.items() if plane[1] is not None}
    grown = _grown(extraction, motion_field, planes.values())
    found = []
    for (id_, (_, fit, *told)), member in zip(planes.items(), grown, strict=True):
        label[member] = Label.MOVING
        plane_id[member] = id_
        found.append(PlaneObservation(
            id_, Label.MOVING, fit.plane, fit.covariance, fit.t_d, fit.product,
            fit.scale_prior, False, lattice.count_macroblocks(extraction.x_cur[member]), *told))
    return replace(extraction, label=label, plane_id=plane_id,
                   planes=(*extraction.planes, *found))
