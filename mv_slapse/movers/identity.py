"""What is known of the blocks of past key frame pairs: how they scored, which mover they were.

A block's history follows its vector. Where a vehicle has none in a pair, as where an I frame
codes it anew, its history goes on as it last moved, or each I frame would find it again.
"""

from dataclasses import dataclass, field
from typing import NamedTuple

from mv_slapse.kernels.binding import compiled
from mv_slapse.movers.body import Bodies
from mv_slapse.movers.strip_depths import Way
from mv_slapse.records import Extraction
import numpy as np

FIRST_ID = 100_000  # moving planes have ids of their own, from here on
LIFETIME = 500_000_000  # [ns] for which a block is known to be a mover's without a vector
FADING = 0.85  # of a score from pair to pair


class History(NamedTuple):
    """What the blocks (N,) of a pair were in the pair before."""

    score: np.ndarray  # (N,): as of Memory; nan: unknown
    left: np.ndarray  # (N,): the same
    id: np.ndarray  # (N,) int64: as of Memory; -1: none


class Judged(NamedTuple):
    """What a pair tells of its blocks: where they are, and the columns of a Memory."""

    x: np.ndarray
    x_prev: np.ndarray
    block: np.ndarray
    score: np.ndarray
    left: np.ndarray
    id: np.ndarray


def _none(*columns: int, dtype: type = float) -> np.ndarray:
    return field(default_factory=lambda: np.zeros((0, *columns), dtype))


@dataclass(frozen=True)
class Memory:
    """Blocks of the key frame at ``stamp``; later ones hide earlier ones."""

    stamp: int | None = None  # [ns]
    x: np.ndarray = _none(2)  # (N, 2): centres [px]
    block: np.ndarray = _none(2)  # (N, 2): sizes [px]
    velocity: np.ndarray = _none(2)  # (N, 2): in the picture [px/s]
    score: np.ndarray = _none()  # (N,): that it moves, summed over key frame pairs,
    left: np.ndarray = _none()  # (N,): and that it has left where it stood
    # (N,) int64: moving region that each belongs to, -1 for none
    id: np.ndarray = _none(dtype=int)
    seen: np.ndarray = _none(dtype=int)  # (N,) int64: when each had a vector [ns]
    next_id: int = FIRST_ID  # for a region that is new
    bodies: Bodies = Bodies()  # of the pair
    way: Way = Way()  # to the key frame, where the ground was known

    def inherited(self, extraction: Extraction) -> History:
        """Return what the blocks of a pair were before, by where their vectors point.

        Blocks have gone on as they moved; those without a vector for LIFETIME are forgotten.
        """
        return History(*compiled.inherited(
            self, extraction.previous_stamp, extraction.width, extraction.height,
            np.ascontiguousarray(extraction.x_prev, float), LIFETIME))

    def after(self, extraction: Extraction, judged: Judged, next_id: int) -> 'Memory':
        """Return what is known after a pair; without a vector FADING of a score is left."""
        seconds = (extraction.stamp - extraction.previous_stamp) / 1e9
        return Memory(extraction.stamp, *compiled.remembered(
            self, extraction.stamp, extraction.width, extraction.height, judged, seconds, FADING,
            LIFETIME), next_id)


def ids_of(size: np.ndarray, moves: np.ndarray, before: np.ndarray, next_id: int
           ) -> tuple[np.ndarray, int]:
    """Return the ids (R,) of regions that move, -1 of others, and the next id.

    A region keeps the id ``before`` (R,) of what it comes from, -1 for none, the largest by its
    ``size`` (R,) in blocks first; else its id is new.
    """
    ids, taken = np.full(len(size), -1), set()
    for i in sorted(moves.nonzero()[0], key=lambda i: -size[i]):
        ids[i] = before[i] if before[i] >= 0 and before[i] not in taken else next_id
        next_id += int(ids[i] == next_id)
        taken.add(ids[i])
    return ids, next_id
