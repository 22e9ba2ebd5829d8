"""Planes that earlier key frames have shown, and what they let expect of the next."""

from dataclasses import dataclass, replace

from mv_slapse.geometry import plane as plane_geometry
import numpy as np

WOBBLE = 0.01  # rad, and share of the depth: change from pair to pair that a fit does not tell
GATE = 14.2  # squared distance of the same plane seen again: 99.7 % of chi-square, 3 degrees
PATIENCE = 3  # pairs in which a plane may be missing: an I frame's is poor in vectors


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
        wobble = WOBBLE**2 * (plane @ plane) * np.eye(3)
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
        """Return it after a pair that does not show it; None where it is given up."""
        lost = self.seen < 2 or self.missed >= PATIENCE
        return None if lost else replace(self, missed=self.missed + 1)
