"""Planes that earlier key frames have shown, and what they let expect of the next."""

from dataclasses import dataclass, fields

from mv_slapse.changed import replace
from mv_slapse.geometry.plane import MOST_KEPT, WELL_SEEN
from mv_slapse.geometry.two_view import numbers
from mv_slapse.kernels.binding import compiled
import numpy as np

WOBBLE = 0.01  # rad, and share of the depth: change from pair to pair that a fit does not tell
GATE = 14.2  # squared distance of the same plane seen again: 99.7 % of chi-square, 3 degrees
DRIFT = 0.003  # the same where a pair does not show it: what the motion of a pair is wrong by
PATIENCE = 3  # pairs in which a plane may be missing: an I frame's is poor in vectors
USEFUL = 0.15  # spread at which one plane cannot be told from the next: set-backs differ by 0.2


@dataclass(frozen=True)
class KnownPlanes:
    """K planes over several pairs, in the camera and the baseline of the last one."""

    plane: np.ndarray  # (K, 3): n / d [1/baseline]
    covariance: np.ndarray  # (K, 3, 3): with neighbouring vectors' common errors counted
    id: np.ndarray  # (K,) int: -1 until it is confirmed
    seen: np.ndarray  # (K,) int: pairs that have shown it
    missed: np.ndarray  # (K,) int: pairs since then

    @classmethod
    def none(cls) -> 'KnownPlanes':
        """Return no planes."""
        number = np.zeros(0, np.int64)
        return cls(np.zeros((0, 3)), np.zeros((0, 3, 3)), number, number, number)

    def __getitem__(self, rows) -> 'KnownPlanes':
        """Return those of a mask or an index."""
        columns = tuple(getattr(self, name) for name in COLUMNS)
        return KnownPlanes(*compiled.take_rows(columns, numbers(rows, len(self))))

    def __len__(self) -> int:
        """Return their number."""
        return len(self.id)

    def __add__(self, other: 'KnownPlanes') -> 'KnownPlanes':
        """Return these, then others."""
        if not len(other):
            return self
        return KnownPlanes(*(np.concatenate((getattr(self, name), getattr(other, name)))
                             for name in COLUMNS))

    @property
    def is_away(self) -> np.ndarray:
        """Tell which are out of view, rather than missed for a moment, (K,)."""
        return self.missed > PATIENCE

    @property
    def spread(self) -> np.ndarray:
        """Return the standard deviation of each plane, as a share of it, (K,)."""
        return np.sqrt(self.covariance.trace(axis1=1, axis2=2) / (self.plane**2).sum(axis=1))

    def predicted(self, R, t, log_ratio: float, ratio_sigma: float) -> 'KnownPlanes':
        """Predict them through X_cur = R X_prev + t, |t| = 1 = exp(log_ratio) old baselines.

        Those that the camera has passed through are gone.
        """
        if not len(self):
            return self
        plane, covariance, good = compiled.predict_planes(
            self.plane, self.covariance, np.ascontiguousarray(R), np.ascontiguousarray(t),
            log_ratio, ratio_sigma, np.where(self.missed > 0, DRIFT, WOBBLE))
        moved = replace(self, plane=plane, covariance=covariance)
        return moved if good.all() else moved[good]

    def turned(self, R: np.ndarray) -> 'KnownPlanes':
        """Return them after the camera has turned by R_cur_from_prev on the spot."""
        return replace(self, plane=self.plane @ R.T, covariance=R @ self.covariance @ R.T)

    def unseen(self) -> 'KnownPlanes':
        """Return them after a pair that does not show them, without those that are given up.

        A plane that was well seen leaves the view and may come back. Of too many those out of
        view for the longest are given up.
        """
        soon = (self.seen >= 2) & (self.missed < PATIENCE)
        later = (self.id >= 0) & (self.seen >= WELL_SEEN) & (self.spread < USEFUL)
        left = replace(self, missed=self.missed + 1)[soon | later]
        if np.count_nonzero(left.is_away) <= MOST_KEPT:
            return left
        away = left[left.is_away]
        return left[~left.is_away] + away[np.argsort(away.missed, kind='stable')[:MOST_KEPT]]

    def near(self, plane: np.ndarray, covariance: np.ndarray) -> np.ndarray:
        """Tell which of them another plane (3,) with its covariance (3, 3) may be, (K,)."""
        off, *_ = compiled.compare_planes(self.plane, self.covariance, plane, covariance)
        return off < GATE

    def recognised(self, plane: np.ndarray, covariance: np.ndarray) -> int:
        """Return the id of the plane out of view that a new one is, the nearest; -1: of none."""
        near = self[self.is_away & self.near(plane, covariance)]
        off = np.linalg.norm(near.plane - plane, axis=1)
        return int(near.id[np.argmin(off)]) if len(near) else -1


COLUMNS = tuple(item.name for item in fields(KnownPlanes))
