"""Stationary planes of a key frame pair, [MVO] 4.3: known ones first, then new ones.

One inverse depth is good to a few per cent, and within that a slanted plane passes through a
facade, the end wall beside it and the next facade. A window of macroblocks feels the slope. So in
place of four-point homographies windows of the lattice propose planes, and a plane is right for a
block where it explains the window around the block nearly as well as the window's own plane does.
Of the windows that hold a block the one with the best plane of its own is asked: it ends at the
edge of the surface, as in stereo matching. Those windows' planes also grow to whole surfaces, and
are chosen one after another by the blocks that each explains and none before it does.

A plane is reported once other pairs show it where the first one let it be expected, and it is
well known by then. Chance planes do not return, or stay vague.
"""

from dataclasses import dataclass

from mv_slapse.config import ExtractionSettings
from mv_slapse.geometry.blocks import MACROBLOCK
from mv_slapse.kernels.binding import compiled
from mv_slapse.motion.observations import Depths
from mv_slapse.surfaces.plane_track import GATE, KnownPlanes
import numpy as np

CONFIRMED = 2  # pairs that show a plane before it is reported

# What the kernel goes by, without the settings of the extraction.
POLICY = {
    'cut': 2.0,  # sigma: 95 % of a plane's own blocks; 3 sigma let in half as many strangers again
    # Of mean squared errors: 3 of some 20 degrees of freedom make 0.15; a plane one sigma off 1.
    'max_excess': 0.5,
    'cap': 4.0,  # largest squared error of a block in a window's mean: an outlier is two sigma
    # A block's depth, as a share: at 3 sigma 0.18, and set-backs differ by 0.2.
    'max_blur': 0.06,
    'roughness': 0.01,  # relief within a window, share of depth: frames and sills of windows
    'density': 0.6,  # share of a plane's blocks among those in its outline; less is vegetation
    'vague': 0.35,  # uncertainty, a share, beyond which a plane passes for the next pair's
    'fading': 0.7,  # share of the smallest plane at which a known one is still seen
    'least': 8,  # blocks in a window: three unknowns, and as many errors again
    'judged': 3,  # blocks that ask a window before it proposes a plane: others change no label
    'lean': 0.03,  # rad: how far walls lean
    'upright_gate': 9.0,  # squared, 3 sigma: a plane this near to upright is taken as upright
    'dependence': 6.0,  # neighbouring vectors err together: so many tell as much as one
    'reach': 12 * MACROBLOCK,  # px: a plane grows this far before it is chosen
    # Over the median of squared errors: a Gaussian's is 0.455, and a window's own plane takes 3 of
    # some 20 degrees of freedom away.
    'noise_least': 1 / 0.455 / 0.87,
    'same_gate': GATE,
}


@dataclass(frozen=True)
class PlaneFit:
    """A plane (3,) [1/baseline], its covariance (3, 3), and the mask (N,) of its blocks."""

    plane: np.ndarray
    covariance: np.ndarray
    member: np.ndarray
    id: int = -1
    is_ground: bool = False


def stationary_planes(depths: Depths, free: np.ndarray, known: KnownPlanes,
                      up: np.ndarray, settings: ExtractionSettings, numbers: tuple[int, int]):
    """Find known planes again, then new ones: fits with ids, and what to predict to the next pair.

    ``depths`` are those of all blocks (N,), with the errors of their vectors only; those of them
    that are ``free`` (N,) bool may join a plane. ``known`` is predicted to this pair; ``up`` (3,)
    is the unit normal of the ground in camera k. ``numbers`` are how many planes are looked for
    at most, and the id of the first that is confirmed.
    """
    room, next_id = numbers
    nearby = known[~known.is_away] if len(known) else known
    source, seen, plane, covariance, own, own_covariance, member = compiled.find_planes(
        *depths.columns, free, nearby.plane, nearby.covariance, nearby.seen, up, room,
        {**POLICY, 'min_macroblocks': settings.min_macroblocks})
    id = np.array([-1 if i < 0 else nearby.id[i] for i in source], np.int64)
    found = KnownPlanes(plane, covariance, id, seen, np.zeros(len(seen), np.int64))
    lost = known
    new = (id < 0) & (seen >= CONFIRMED)
    for i in (new & (found.spread < settings.max_uncertainty)).nonzero()[0] if new.any() else ():
        old = lost.recognised(plane[i], covariance[i])
        id[i] = next_id if old < 0 else old
        next_id += old < 0
        lost = lost[lost.id != id[i]]
    fits = [PlaneFit(own[i], own_covariance[i], member[i], int(id[i]))
            for i in (id >= 0).nonzero()[0]]
    left = ~(known.id[:, None] == id).any(axis=1)
    if left.any():
        # A plane that is not confirmed yet lasts while nothing takes its place.
        found += known[left].unseen()
    return fits, found
