"""What is known of the blocks of past key frame pairs: how they scored, which mover they were.

A block's history follows its vector. Where a vehicle has none in a pair, as where an I frame
codes it anew, its history goes on as it last moved, or each I frame would find it again.
"""

from dataclasses import dataclass, field, replace

from mv_slapse.geometry import lattice
from mv_slapse.records import Extraction
import numpy as np

FIRST_ID = 100_000  # moving planes have ids of their own, from here on
LIFETIME = 500_000_000  # [ns] for which a block is remembered without a vector
SECOND = 1e9  # [ns]


def _none(*columns: int, dtype: type = float) -> np.ndarray:
    return field(default_factory=lambda: np.zeros((0, *columns), dtype))


@dataclass(frozen=True)
class Memory:
    """Blocks of the key frame at ``stamp``; later ones hide earlier ones.

    Attributes
    ----------
    stamp : int or None
        [ns].
    x, block : (N, 2), (N, 2) float64
        Centres and sizes [px].
    velocity : (N, 2) float64
        In the picture [px/s].
    score, left : (N,), (N,) float64
        That it moves, and that it has left where it stood, summed over key frame pairs.
    id : (N,) int
        Moving region that each belongs to, -1 for none.
    seen : (N,) int
        When each had a vector [ns].
    next_id : int
        For a region that is new.
    """

    stamp: int | None = None
    x: np.ndarray = _none(2)
    block: np.ndarray = _none(2)
    velocity: np.ndarray = _none(2)
    score: np.ndarray = _none()
    left: np.ndarray = _none()
    id: np.ndarray = _none(dtype=int)
    seen: np.ndarray = _none(dtype=int)
    next_id: int = FIRST_ID

    def at(self, stamp: int) -> 'Memory':
        """Return it for a later key frame [ns]: blocks go on as they moved, old ones go."""
        if self.stamp is None or stamp < self.stamp:
            return Memory(stamp, next_id=self.next_id)
        moved = self.x + self.velocity * ((stamp - self.stamp) / SECOND)
        return replace(self, stamp=stamp, x=moved).only(stamp - self.seen < LIFETIME)

    def only(self, kept: np.ndarray) -> 'Memory':
        """Return it with some blocks only, (N,) bool."""
        return replace(self, x=self.x[kept], block=self.block[kept],
                       velocity=self.velocity[kept], score=self.score[kept],
                       left=self.left[kept], id=self.id[kept], seen=self.seen[kept])

    def inherited(self, extraction: Extraction) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return score and left (N,), nan: unknown, and id (N,), -1: none, that blocks had."""
        at = self.at(extraction.previous_stamp)
        at = at.only(_inside(at.x, extraction))
        if not len(at.x):
            n = len(extraction.x_cur)
            return np.full(n, np.nan), np.full(n, np.nan), np.full(n, -1)
        grid = lattice.paint(extraction.width, extraction.height, at.x, at.block,
                             np.arange(len(at.x)))
        source = lattice.lookup(grid, extraction.x_prev.astype(float))
        return (np.where(source < 0, np.nan, at.score[source]),
                np.where(source < 0, np.nan, at.left[source]),
                np.where(source < 0, -1, at.id[source]))

    def after(self, extraction: Extraction, score: np.ndarray, left: np.ndarray, id_: np.ndarray,
              next_id: int, fading: float) -> 'Memory':
        """Return what is known after a pair.

        Parameters
        ----------
        extraction : Extraction
        score, left, id_ : (N,), (N,), (N,) arrays
            Of its blocks.
        next_id : int
        fading : float
            Share of their scores that blocks without a vector keep.
        """
        x, block = extraction.x_cur.astype(float), extraction.block.astype(float)
        seconds = (extraction.stamp - extraction.previous_stamp) / SECOND
        old = self.at(extraction.stamp)
        old = old.only(_inside(old.x, extraction))
        covered = lattice.paint(extraction.width, extraction.height, x, block,
                                np.zeros(len(x), int))
        old = old.only(lattice.lookup(covered, old.x) < 0)
        seen = np.full(len(x), extraction.stamp)
        return Memory(extraction.stamp, *(np.concatenate(pair) for pair in (
            (old.x, x), (old.block, block), (old.velocity, (x - extraction.x_prev) / seconds),
            (fading * old.score, score), (fading * old.left, left),
            (old.id, id_), (old.seen, seen))), next_id)


def _inside(x: np.ndarray, extraction: Extraction) -> np.ndarray:
    """Return which pixels (N, 2) lie in the picture."""
    return np.all((x >= -0.5) & (x < (extraction.width - 0.5, extraction.height - 0.5)), axis=1)


def better_half(members: list[np.ndarray], score: np.ndarray) -> np.ndarray:
    """Return the mean (R,) of the upper half of each region's known scores, 0: few are known.

    Half, since a region of a few blocks came from cells that it held in part.
    """
    result = np.zeros(len(members))
    for i, member in enumerate(members):
        known = np.sort(score[member][np.isfinite(score[member])])
        if 3 * len(known) >= len(member):
            result[i] = known[len(known) // 2:].mean()
    return result


def majority(members: list[np.ndarray], ids: np.ndarray) -> np.ndarray:
    """Return the id (R,) that most of each region's blocks come from, -1: less than a third."""
    result = np.full(len(members), -1)
    for i, member in enumerate(members):
        known = ids[member][ids[member] >= 0]
        if 3 * len(known) >= len(member):
            values, count = np.unique(known, return_counts=True)
            result[i] = values[count.argmax()]
    return result


def ids_of(members: list[np.ndarray], moves: np.ndarray, before: np.ndarray, next_id: int
           ) -> tuple[np.ndarray, int]:
    """Return the ids (R,) of regions that move: of the region they come from, or a new one."""
    ids, taken = np.full(len(members), -1), set()
    for i in sorted(np.flatnonzero(moves), key=lambda i: -len(members[i])):
        ids[i] = before[i] if before[i] >= 0 and before[i] not in taken else next_id
        next_id += int(ids[i] == next_id)
        taken.add(ids[i])
    return ids, next_id
