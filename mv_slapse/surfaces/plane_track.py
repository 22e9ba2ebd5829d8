"""Planes that earlier key frames have shown, and what they let expect of the next."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

from mv_slapse.geometry import plane as plane_geometry
import numpy as np

WOBBLE = 0.01  # rad, and share of the depth: change from pair to pair that a fit does not tell
GATE = 14.2  # squared distance of the same plane seen again: 99.7 % of chi-square, 3 degrees
DRIFT = 0.003  # the same where it is out of view: what the motion of a pair is wrong by
PATIENCE = 3  # pairs in which a plane may be missing: an I frame's is poor in vectors
WELL_SEEN = 5  # pairs that show a plane which is worth being known again
USEFUL = 0.15  # spread at which one plane cannot be told from the next: set-backs differ by 0.2
MOST = 30  # planes out of view that are kept


@dataclass(frozen=True)
class KnownPlane:
    """A plane over several pairs, in the camera and the baseline of the last one.

    Attributes
    ----------
    plane, covariance : (3,), (3, 3) arrays
        n / d [1/baseline], with neighbouring vectors' common errors counted.
    id : int
        -1 until it is confirmed.
    seen, missed : int
        Pairs that have shown it; pairs since then.
    """

    plane: np.ndarray
    covariance: np.ndarray
    id: int = -1
    seen: int = 1
    missed: int = 0

    @property
    def is_away(self) -> bool:
        """Tell whether it is out of view, rather than missed for a moment."""
        return self.missed > PATIENCE

    @property
    def spread(self) -> float:
        """Return the standard deviation of the plane, as a share of it."""
        return float(np.sqrt(np.trace(self.covariance)) / np.linalg.norm(self.plane))

    def predicted(self, R, t, log_ratio: float, ratio_sigma: float) -> 'KnownPlane | None':
        """Predict it through X_cur = R X_prev + t, |t| = 1 = exp(log_ratio) old baselines.

        None where the camera has passed through it.
        """
        scale = np.exp(log_ratio)
        rotated = R @ self.plane * scale
        nearer = 1 - rotated @ t
        if nearer <= 0:
            return None
        plane = plane_geometry.transform(self.plane * scale, R, t)
        J = scale * (R / nearer + np.outer(rotated, t @ R) / nearer**2)
        wobble = (DRIFT if self.missed else WOBBLE)**2 * (plane @ plane) * np.eye(3)
        covariance = (J @ self.covariance @ J.T + ratio_sigma**2 * np.outer(plane, plane) + wobble)
        return replace(self, plane=plane, covariance=covariance)

    def is_near(self, plane: np.ndarray, covariance: np.ndarray) -> bool:
        """Tell whether another plane (3,) with its covariance (3, 3) may be the same."""
        off = plane - self.plane
        return float(off @ np.linalg.solve(self.covariance + covariance, off)) < GATE

    def fused(self, plane: np.ndarray, covariance: np.ndarray) -> 'KnownPlane':
        """Return the mean with what one more pair shows, each by its information."""
        gain = np.linalg.solve(self.covariance + covariance, self.covariance).T
        rest = (np.eye(3) - gain) @ self.covariance
        return replace(self, plane=self.plane + gain @ (plane - self.plane),
                       covariance=0.5 * (rest + rest.T), seen=self.seen + 1, missed=0)

    def unseen(self) -> 'KnownPlane | None':
        """Return it after a pair that does not show it; None where it is given up.

        A plane that was well seen leaves the view and may come back.
        """
        soon = self.seen >= 2 and self.missed < PATIENCE
        later = self.id >= 0 and self.seen >= WELL_SEEN and self.spread < USEFUL
        return replace(self, missed=self.missed + 1) if soon or later else None


def recognised(track: KnownPlane, known: Sequence[KnownPlane]) -> KnownPlane | None:
    """Return the plane out of view that a new one is, the nearest; None where it is another."""
    near = [old for old in known if old.is_away and old.is_near(track.plane, track.covariance)]
    return min(near, key=lambda old: np.linalg.norm(old.plane - track.plane), default=None)


def kept(known: Sequence[KnownPlane]) -> list[KnownPlane]:
    """Return the planes without those that were out of view for the longest, if too many."""
    away = sorted((plane for plane in known if plane.is_away), key=lambda plane: plane.missed)
    return [plane for plane in known if not plane.is_away] + away[:MOST]
