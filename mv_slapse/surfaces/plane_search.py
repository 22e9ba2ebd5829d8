"""Stationary planes of a key frame pair, [MVO] 4.3: known ones first, then new ones.

In place of four-point homographies, the planes that windows of the lattice propose are chosen
one after another by the blocks that each explains and none before it does; a plane is reported
once other pairs show it where the first one let it be expected, and it is well known by then.
Chance planes do not return, or stay vague.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
import itertools

from mv_slapse.geometry import lattice
from mv_slapse.geometry.blocks import macroblock_of
from mv_slapse.surfaces import consensus, windows
from mv_slapse.surfaces.consensus import Depths
from mv_slapse.surfaces.plane_track import kept, KnownPlane, recognised
from mv_slapse.surfaces.windows import DEPENDENCE, Windows
import numpy as np
from scipy import ndimage

CUT = 2.0  # sigma: 95 % of a plane's own blocks; 3 sigma let in half as many strangers again
MAX_EXCESS = 0.5  # 3 of some 20 degrees of freedom make 0.15; a plane one sigma off makes 1
MAX_BLUR = 0.06  # a block's depth, as a share: at 3 sigma 0.18, and set-backs differ by 0.2
ROUGHNESS = 0.01  # relief within a window, as a share of depth: frames and sills of windows
DENSITY = 0.6  # share of a plane's blocks among those in its outline; less is vegetation
CONFIRMED = 2  # pairs that show a plane before it is reported
VAGUE = 0.35  # uncertainty, as a share, beyond which a plane cannot be told from the next pair's
FADING = 0.7  # share of the smallest plane at which a known one is still seen


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


@dataclass(frozen=True)
class Blocks:
    """Sharp stationary blocks, their windows, the ground's normal (3,) and the rules."""

    depths: Depths
    windows: Windows
    up: np.ndarray
    rules: Rules

    def gain(self, squared: np.ndarray) -> np.ndarray:
        """Return how well planes explain each block, (N, H) from 0 to MAX_EXCESS or more.

        ``squared`` (N, H) are squared errors in standard deviations.
        """
        good = np.maximum(MAX_EXCESS - self.windows.excess(squared), 0)
        return np.where(squared < CUT**2, good, 0)

    def gain_of(self, plane: np.ndarray) -> np.ndarray:
        """Return how well one plane (3,) explains each block, (N,)."""
        return self.gain(np.square(self.depths.error(plane))[:, None])[:, 0]

    def fit(self, member: np.ndarray, plane: np.ndarray):
        """Return the plane of some blocks, and its covariance with common errors counted."""
        fitted = consensus.refine_plane(self.depths[member], plane, steps=2)
        plane, covariance = windows.upright(*(value[None] for value in fitted), self.up)
        return plane[0], DEPENDENCE * covariance[0]

    def together(self, member: np.ndarray) -> np.ndarray:
        """Return the largest connected part of a mask; empty where it is no plane's."""
        index = np.flatnonzero(member)
        part = np.zeros_like(member)
        if len(index) >= windows.LEAST:
            component = lattice.components(self.depths.x[index])
            part[index] = component == np.argmax(np.bincount(component))
        return part if part.sum() >= windows.LEAST else np.zeros_like(member)


def stationary_planes(depths: Depths, free: np.ndarray, known: Sequence[KnownPlane],
                      up: np.ndarray, rules: Rules, room: int, next_id: int):
    """Find known planes again, then new ones.

    Parameters
    ----------
    depths : Depths
        All blocks, (N,), with the errors of their vectors only.
    free : (N,) bool array
        Blocks that may join a plane.
    known : sequence of KnownPlane
        Predicted to this pair.
    up : (3,) array
        Unit normal of the ground in camera k.
    rules : Rules
    room, next_id : int
        Most planes to look for; id of the first that is confirmed.

    Returns
    -------
    fits : list of PlaneFit
        Confirmed planes, with ids.
    known : list of KnownPlane
        To predict to the next pair.
    """
    blocks, index = _sharp_blocks(depths, free, up, rules)
    nearby = [track for track in known if not track.is_away]
    chosen = [] if blocks is None else _chosen(blocks, nearby, room)
    ids = itertools.count(next_id)
    fits, after, taken = [], [], set()
    for track, plane, covariance, part in chosen:
        if track.id < 0 and track.seen >= CONFIRMED and (
                track.spread < blocks.rules.max_uncertainty):
            old = recognised(track, [old for old in known if old.id not in taken])
            track = replace(track, id=next(ids) if old is None else old.id)
            taken.add(track.id)
        after.append(track)
        if track.id >= 0:
            member = np.zeros(len(depths), bool)
            member[index[part]] = True
            fits.append(PlaneFit(plane, covariance, member, track.id))
    seen = {track.id for track in after}
    unseen = [track.unseen() for track in known if track.id not in seen]
    return fits, after + kept([track for track in unseen if track is not None])


def _sharp_blocks(depths: Depths, free: np.ndarray, up, rules: Rules):
    """Return Blocks of those that can tell one plane from the next, and their numbers."""
    sigma = np.hypot(depths.sigma, ROUGHNESS * depths.rho) + 1e-9
    index = np.flatnonzero(free & (sigma < MAX_BLUR * depths.rho))
    if len(index) < rules.min_macroblocks:
        return None, index
    sharp = replace(depths, sigma=sigma)[index]
    seen = windows.look(sharp, up)
    if seen is None:
        return None, index
    return Blocks(replace(sharp, sigma=seen.noise * sharp.sigma), seen, up, rules), index


def _chosen(blocks: Blocks, known: Sequence[KnownPlane], room: int):
    """Choose planes, share the blocks out among them, and drop those that do not last."""
    found, taken = _seen_again(blocks, known)
    found += _new(blocks, taken, room - len(found))
    if not found:
        return []
    for _ in range(2):
        gains = np.stack([blocks.gain_of(track.plane) for track, _ in found], axis=1)
        owner = np.where(gains.max(axis=1) > 0, gains.argmax(axis=1), -1)
        parts = [blocks.together(owner == i) for i in range(len(found))]
        found = [(_fused(blocks, part, track, before), before) for part, (track, before)
                 in zip(parts, found, strict=True)]
    pairs = zip(found, parts, strict=True)
    return [(track, *blocks.fit(part, track.plane), part)
            for (track, before), part in pairs
            if _is_plane(blocks, part, track, before)]


def _fused(blocks: Blocks, part: np.ndarray, track: KnownPlane, before: KnownPlane | None):
    """Fit a plane's part again, together with what was known before."""
    if not part.any():
        return track
    plane, covariance = blocks.fit(part, track.plane)
    return KnownPlane(plane, covariance) if before is None else before.fused(plane, covariance)


def _seen_again(blocks: Blocks, known: Sequence[KnownPlane]):
    """Find known planes, the longest known first; return (now, before) of each, and gains."""
    found, taken = [], np.zeros(len(blocks.depths), np.float32)
    for before in sorted(known, key=lambda track: -track.seen):
        track, gain = before, blocks.gain_of(before.plane)
        for _ in range(2):
            part = blocks.together(gain > taken)
            if not part.any():
                break
            plane, covariance = blocks.fit(part, track.plane)
            if not before.is_near(plane, covariance):
                part[:] = False
                break
            track = before.fused(plane, covariance)
            gain = blocks.gain_of(track.plane)
        part &= gain > taken
        if np.sum((gain - taken)[part]) >= 0.5 * _least_gain(blocks):
            found.append((track, before))
            taken = np.where(part, gain, taken)
    return found, taken


def _new(blocks: Blocks, taken: np.ndarray, room: int):
    """Find new planes, the one that explains most first, as (now, None)."""
    vacant = blocks.windows.mean @ (taken == 0) > 0.5
    if room <= 0 or not vacant.any():
        return []
    planes, squared = windows.grown(blocks.windows, vacant, blocks.depths, blocks.up)
    gains = blocks.gain(squared)
    found = []
    for _ in range(2 * room):
        more = np.maximum(gains - taken[:, None], 0).sum(axis=0)
        best = int(np.argmax(more))
        if more[best] < _least_gain(blocks) or len(found) == room:
            break
        track, part, gain = _settled(blocks, planes[best], gains[:, best], taken)
        gains[:, best] = 0
        if np.sum((gain - taken)[part]) >= _least_gain(blocks):
            found.append((track, None))
            taken = np.where(part, np.maximum(gain, taken), taken)
    return found


def _settled(blocks: Blocks, plane: np.ndarray, gain: np.ndarray, taken: np.ndarray):
    """Fit a plane to the connected blocks that it explains best, and again."""
    track = KnownPlane(plane, np.eye(3))
    for _ in range(2):
        part = blocks.together(gain > taken)
        if not part.any():
            break
        track = KnownPlane(*blocks.fit(part, track.plane))
        gain = blocks.gain_of(track.plane)
    return track, blocks.together(gain > taken), gain


def _least_gain(blocks: Blocks) -> float:
    """Return the gain of the smallest plane: as many blocks again as it must keep in the end."""
    return 1.4 * MAX_EXCESS * blocks.rules.min_macroblocks


def _is_plane(blocks: Blocks, part, track: KnownPlane, before: KnownPlane | None) -> bool:
    """Tell whether what remains of a plane is one: large, dense and well known."""
    least = blocks.rules.min_macroblocks * (1.0 if before is None else FADING)
    return (lattice.count_macroblocks(blocks.depths.x[part]) >= least
            and track.spread < VAGUE
            and _density(blocks.depths.x, part) >= DENSITY)


def _density(x: np.ndarray, member: np.ndarray) -> float:
    """Return which share of the blocks (N, 2) in a plane's outline is its own."""
    cell = macroblock_of(x)
    cell -= cell.min(axis=0)  # what a wide lens sees lies far outside an undistorted picture
    own = np.zeros(cell.max(axis=0) + 5, bool)
    own[tuple(cell[member].T + 2)] = True
    inside = ndimage.binary_closing(own, np.ones((3, 3)))[tuple(cell.T + 2)]
    return float(np.mean(member[inside])) if inside.any() else 0.0


def gather(depths: Depths, plane, free, rules: Rules) -> np.ndarray:
    """Return the mask (N,) of free blocks that agree with a plane and lie together.

    A block far from all others that agrees does so by chance: components of less than a quarter
    of the smallest plane are left out.
    """
    member = free & (np.abs(depths.error(plane)) < rules.cut)
    index = np.flatnonzero(member)
    member[index] = lattice.largest_components(depths.x[index], rules.min_macroblocks // 4)
    return member
