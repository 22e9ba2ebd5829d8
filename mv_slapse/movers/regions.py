"""Regions that move: which blocks of a labelled key frame pair belong to moving objects.

Definition 1 of [MVO] judges each block by itself, and a wrong vector looks like a moving object
to it. Here blocks that move alike are joined first, a moving plane is fitted to each region, and
the region is judged as a whole (movers.score). Its score is summed over key frame pairs along the
vectors, so that a slow mover becomes one in time and a wrong vector, which does not last, does
not.
"""

from itertools import pairwise
from typing import NamedTuple

from mv_slapse.changed import replace
from mv_slapse.config import USUAL_HEIGHT
from mv_slapse.geometry.blocks import count_macroblocks, MACROBLOCK
from mv_slapse.geometry.rotation import norm
from mv_slapse.kernels.binding import compiled
from mv_slapse.movers import body
from mv_slapse.movers.identity import FADING, ids_of, Judged, Memory
from mv_slapse.movers.moving_plane import fit_surfaces, Regions, settled, Surfaces, View
from mv_slapse.movers.outlines import NOT_KNOWN, outlines
from mv_slapse.movers.outlines import RULES as OUTLINE
from mv_slapse.movers.score import scores
from mv_slapse.movers.strip_depths import Way, with_strips
from mv_slapse.records import Extraction, Label, PlaneObservation
from mv_slapse.strip_matches import NONE, StripMatches
import numpy as np


class Rules(NamedTuple):
    """Constants of regions, their histories and what they grow by."""

    reach: float = 24.0  # px between centres of neighbours
    alike: float = 1.0  # px by which neighbours' vectors may differ,
    alike_share: float = 0.12  # and share of the longer one
    alike_grown: float = 0.06  # the same share once the growth by depth is taken off
    own_growth: float = 0.12  # of what comes near a standing camera: 2 s away, 0.24 s a pair
    alike_short: float = 0.15  # share of the median vector that the pixel is at most, down to half
    alike_beside: float = 0.25  # share of a vector beside a region that it is at most
    inside: float = 2.5  # times as much within a region
    repeated: float = OUTLINE.repeated
    least: float = 4.0  # blocks, and as many macroblocks less a half
    on_ground: float = 0.2  # share of the ground's inverse depth within which a block is ground
    below_ground: float = 0.7  # share of it below which nothing still can be
    rising: float = 0.3  # share of a car's departed blocks off the ground: 0.3 to 1 as measured,
    rising_blocks: float = 2.0  # and their number
    fits: float = 3.0  # sigma of the epipolar error of a block whose depth tells something
    far: float = 1.5  # px of parallax, less is far off,
    resting: float = 0.75  # px, or rests where the camera stands
    receding: float = 0.5  # share of its depth by which a thing may at most go away in a pair
    fading: float = FADING
    part: float = 0.4  # share of a region that scored before, or else most of it stood still
    same_plane: float = 0.7  # share of a region and of a plane in common if they are one
    macroblock: float = MACROBLOCK
    least_sigma: float = 0.25  # px, of a vector on a small surface, whatever the pair says
    shape: float = 0.04  # share of a vector by which it errs as vehicles are no planes
    kept: float = 0.5  # of the score to move: enough for what was or is beside a mover


RULES = Rules()
# First id of a pair's regions that are not called moving; they fall from there. Nearer to zero are
# -1, no plane, and the complements of planes' ids, their parts (obstacles.footprint).
UNSURE = -2**30


class KnownGround(NamedTuple):
    """What is known of the ground that movers stand on."""

    plane: np.ndarray | None = None  # (3,): n / d in camera k [1/baseline], seen or predicted
    level: np.ndarray | None = None  # (3,): up in camera k, where the plane is not known
    nearer: float = 1.0  # times nearer that it may be: a guess, which tells what looks farther
    camera_height: float = USUAL_HEIGHT  # above the ground [m]
    id: int = -1  # of its plane, -1: none


class _Pair(NamedTuple):
    """Columns of the blocks (N,) of a pair."""

    x: np.ndarray  # (N, 2): centres [px]
    x_prev: np.ndarray  # (N, 2): their matches [px]
    block: np.ndarray  # (N, 2): sizes [px]
    sigma: np.ndarray  # (N,): of the vectors [px]
    departure: np.ndarray  # (N,): log-likelihoods, as of movers.reference_depth.departure
    plane_id: np.ndarray  # (N,) int32
    wrong: np.ndarray  # (N,) bool: nothing still explains the vector


class _Alike(NamedTuple):
    """The same, their motion without rotation, and regions (R,) of those that move alike."""

    x: np.ndarray
    x_prev: np.ndarray
    block: np.ndarray
    sigma: np.ndarray
    departure: np.ndarray
    plane_id: np.ndarray
    wrong: np.ndarray
    parallax: np.ndarray  # (N, 2) [px]
    rho: np.ndarray  # (N,): apparent inverse depth [1/baseline]
    noise: np.ndarray  # (N,): what noise makes of it
    under: np.ndarray  # (N,): inverse depth of the ground there
    ground_like: np.ndarray  # (N,) bool: moves as the ground does and has not left where it stood
    far: np.ndarray  # (N,) bool: above the horizon, without motion
    copied: np.ndarray  # (N,) bool: repeats a neighbour that nothing still explains
    below: np.ndarray  # (N,) bool: looks farther than the ground that it would hide
    fits: np.ndarray  # (N,) bool: moves along its epipolar line
    members: np.ndarray  # (M,) int64: the blocks of one region after the other
    first: np.ndarray  # (R,) int64: where each region begins
    own: int  # number of the pair's own blocks: what strips tell follows

    @property
    def size(self) -> np.ndarray:
        """Return the number of blocks of each region, (R,)."""
        return np.concatenate((self.first[1:], (len(self.members),))) - self.first

    def columns(self) -> dict[str, np.ndarray]:
        """Return what there is of each block."""
        return {name: column for name, column in self._asdict().items()
                if name not in ('members', 'first', 'own')}

    def without_strips(self) -> '_Alike':
        """Return the pair's own blocks, of which each region has one."""
        kept = self.members < self.own
        size = np.add.reduceat(kept, self.first, dtype=np.int64) if len(self.first) else self.first
        columns = {name: column[:self.own] for name, column in self.columns().items()}
        return self._replace(**columns, members=self.members[kept],
                             first=np.cumsum(size) - size)

    def rows(self, i: int) -> slice:
        """Return where the blocks of region i are among the members."""
        return slice(self.first[i], self.first[i + 1] if i + 1 < len(self.first) else None)


class _Scores(NamedTuple):
    """Scores (R,) of regions: of this pair and those before, of departure alone, and what was.

    ``known`` is the id of the mover or stationary plane that each comes from, -1: none, ``moved``
    whether that was called moving; ``score`` and ``left`` (N,) go to the blocks.
    """

    total: np.ndarray
    gone: np.ndarray
    known: np.ndarray
    moved: np.ndarray
    score: np.ndarray
    left: np.ndarray


def with_moving_planes(extraction: Extraction, memory: Memory, threshold: float,
                       ground: KnownGround, departure: np.ndarray | None = None,
                       strips: StripMatches = NONE) -> tuple[Extraction, Memory]:
    """Add the moving planes of a pair to what was found stationary in it.

    The extraction has motion, labels, and the ids of stationary planes; ``memory`` is what the
    last call returned, ``departure`` (N,) is as of movers.reference_depth, None: nothing is known,
    ``strips`` of the pair are without distortion.
    From the score ``threshold`` on, chi-square beyond its mean, a region is called moving: its
    blocks are labelled MOVING with the plane's id. What is half as sure is told as an UNKNOWN
    plane: its blocks get the plane's id where they are of no other one, and keep their labels.
    Both take in the blocks around that move as they do. Returns extraction and memory.
    """
    departure = np.zeros(len(extraction.x_cur)) if departure is None else departure
    pair = _pair(extraction, departure)
    motion = extraction.motion
    view = View(extraction.K, np.ascontiguousarray(motion.R_cur_from_prev, float),
                np.ascontiguousarray(motion.t_cur_from_prev, float))
    seen, evidence, memorable = _regions(extraction, pair, view, ground, memory, strips)
    outline = outlines(seen, view.K, ground.plane,
                       ground.level if ground.plane is None else ground.plane,
                       ground.camera_height)
    # What strips tell of a while ago is no motion of this pair.
    alike = seen.without_strips()
    fit = _fitted(alike, view, ground)
    *now, summed = _scored(alike, fit, outline, view, ground.nearer, evidence)
    # A parked car that starts keeps the id of its plane.
    told = _Scores(*compiled.histories(alike, *now, memory.inherited(extraction), pair.plane_id,
                                       ground.id, RULES))
    told = told._replace(total=np.maximum(told.total, summed))
    moves, unsure = _moves(alike, told, threshold, ground)
    size = alike.size
    ids, next_id = ids_of(size, moves, told.known, memory.next_id)
    known = np.full(len(pair.x), -1)
    known[alike.members] = np.repeat(ids, size)
    ids[unsure] = UNSURE - np.arange(np.count_nonzero(unsure))
    floor = ground.plane if ground.nearer == 1 else None
    planes = {i: plane for i in sorted((ids != -1).nonzero()[0], key=lambda i: -size[i])
              if (plane := settled(fit, alike, i, view, floor)) is not None}
    found = _labelled(extraction, alike, planes, ids, told, view) if planes else extraction
    judged = Judged(pair.x, pair.x_prev, pair.block, told.score, told.left, known)
    return found, replace(memory.after(extraction, judged, next_id), **memorable)


def _pair(extraction, departure):
    """Return the blocks of a pair as the kernels take them."""
    x, x_prev, block, sigma = (np.ascontiguousarray(values, float) for values in (
        extraction.x_cur, extraction.x_prev, extraction.block, extraction.sigma))
    return _Pair(x, x_prev, block, sigma, departure,
                 np.ascontiguousarray(extraction.plane_id, np.int32),
                 extraction.label == Label.UNKNOWN.value)


def _regions(extraction, pair, view, ground, memory, strips):
    """Judge the blocks singly and join those that move alike, or are one body.

    What strips tell counts as blocks that follow the pair's own. Also returns what several pairs
    tell of each region as a body, and what the next pair is told of bodies and of the way.
    """
    alike = _Alike(*pair, *compiled.moving_regions(
        pair, view, NOT_KNOWN if ground.plane is None else ground.plane, ground.nearer, RULES),
        len(pair.x))
    if ground.plane is None:
        return alike, np.zeros(len(alike.first)), {'bodies': body.Bodies(), 'way': Way()}
    stamps = extraction.previous_stamp, extraction.stamp
    before = memory if memory.stamp == stamps[0] else Memory()
    way = before.way.gone_on(stamps, view, norm(ground.plane))
    seen = with_strips(alike, strips, way, view, ground.plane) if len(strips) else alike
    members, first, evidence, bodies = body.with_bodies(
        seen, view, ground.plane, ground.camera_height, (extraction.width, extraction.height),
        before.bodies)
    return (seen._replace(members=members, first=first), evidence,
            {'bodies': bodies, 'way': way})


def _fitted(alike, view, ground) -> Surfaces:
    """Return the moving planes of all regions."""
    at = alike.members
    parallax = alike.parallax.take(at, 0)
    shape = RULES.shape * np.hypot(parallax[:, 0], parallax[:, 1])
    sigma = np.hypot(np.maximum(alike.sigma[at], RULES.least_sigma), shape)
    return fit_surfaces(Regions(alike.x.take(at, 0), alike.x_prev.take(at, 0), sigma, alike.first),
                        view, ground.plane)


def _scored(alike, fit, outline, view, nearer, evidence):
    """Return the scores (R,) of each region: by this pair, that it has left, by several pairs."""
    likelihood = compiled.departed(alike.departure, alike.rho, alike.under, alike.members,
                                   alike.first, RULES)
    return scores(fit, outline, view, alike, nearer, (likelihood, evidence))


def _moves(alike, told, threshold, ground):
    """Return which regions (R,) move, and which of the others are half as sure.

    What was called moving is given up later than it was found. So is what lies beside it and is
    half as sure: the rest of a vehicle that fell to pieces. Not what ends above the horizon.
    """
    score = np.maximum(told.total, told.gone)
    moves = score >= threshold
    suspect = score >= RULES.kept * threshold
    if ground.plane is not None and suspect.any():
        suspect &= np.maximum.reduceat(alike.under[alike.members], alike.first) > 0
    moves |= suspect & told.moved
    if moves.any() and (suspect & ~moves).any():
        x = alike.x[alike.members]
        near = np.concatenate([x[alike.rows(i)] for i in np.flatnonzero(moves)])
        for i in np.flatnonzero(suspect & ~moves):
            apart = np.linalg.norm(x[alike.rows(i)][:, None] - near, axis=2)
            moves[i] = np.min(apart) < RULES.reach
    return moves, suspect & ~moves


def _grown(alike, planes, view):
    """Return the blocks of moving regions and those around that move so, not as the ground."""
    products = np.array([plane.product for plane in planes.values()]).reshape(-1, 3, 3)
    members, first = compiled.grown(alike, alike, np.array([*planes], int), products, view, RULES)
    return [members[begin:end] for begin, end in pairwise((*first, None))]


def _labelled(extraction, alike, planes, ids, told, view):
    """Write the planes {region: plane} over blocks' first labels and planes.

    What is called moving takes its blocks from all, what may move those of no plane.
    """
    label, plane_id, members = extraction.label.copy(), extraction.plane_id.copy(), {}
    for called in (True, False):
        some = {i: plane for i, plane in planes.items() if (ids[i] >= 0) == called}
        for i, member in zip(some, _grown(alike, some, view) if some else (), strict=True):
            members[i] = member if called else member[plane_id[member] == -1]
            plane_id[members[i]] = ids[i]
            if called:
                label[member] = Label.MOVING
    found = [PlaneObservation(
        int(ids[i]), Label.MOVING if ids[i] >= 0 else Label.UNKNOWN, *plane, False,
        count_macroblocks(extraction.x_cur[members[i]]), float(max(told.total[i], told.gone[i])))
        for i, plane in planes.items() if len(members[i])]
    return replace(extraction, label=label, plane_id=plane_id, planes=(*extraction.planes, *found))
