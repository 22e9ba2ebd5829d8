"""A moving plane as rate, slope and log depth, as of ``mv_slapse.movers.moving_plane``.

``theta`` is (g, A, B, ln Z), shape (6,). The tests of kernels compare with these formulas, too.
"""

from typing import NamedTuple

from mv_slapse.geometry.blocks import COVERED
import numpy as np

RATE, SLOPE, LOG_DEPTH = slice(0, 3), slice(3, 5), 5


class Contact(NamedTuple):
    """Where a region ends at its bottom."""

    # (2,): middle of its lower edge, in the mean of where that may lie in the lowest row [px]
    point: np.ndarray
    # standard deviation of the row [px]: an edge inside a block may lie anywhere in it
    sigma: float


class ContactDepth(NamedTuple):
    """Log depth of a region's centre when its lower edge stands on the ground."""

    value: float  # of ln Z, for given slopes
    variance: float  # of that value
    by_slope: np.ndarray  # (2,): derivative of ``value``


def weights(slope: np.ndarray, centre: np.ndarray) -> np.ndarray:
    """Return w (3,): inverse depth of a ray is ``w @ ray / Z``."""
    return np.array([slope[0], slope[1], 1 - slope @ centre])


def product(theta: np.ndarray, centre: np.ndarray) -> np.ndarray:
    """Return ``(t - t_d) plane^T`` (3, 3), in which the depth has no part."""
    return -np.outer(theta[RATE], weights(theta[SLOPE], centre))


def to_plane(theta: np.ndarray, centre: np.ndarray,
             t_cur_from_prev: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return (plane, t_d) (6,) of the state (14) in camera k and the derivative (6, 6)."""
    depth, w = np.exp(theta[LOG_DEPTH]), weights(theta[SLOPE], centre)
    plane, relative = -w / depth, theta[RATE] * depth
    jacobian = np.zeros((6, 6))
    jacobian[:3, SLOPE] = -np.vstack([np.eye(2), -centre]) / depth
    jacobian[:3, LOG_DEPTH] = -plane
    jacobian[3:, RATE] = -depth * np.eye(3)
    jacobian[3:, LOG_DEPTH] = -relative
    return np.r_[plane, t_cur_from_prev - relative], jacobian


def contact(x: np.ndarray, block: np.ndarray) -> Contact:
    """Return where a region of blocks, centres x (N, 2) and sizes (N, 2) [px], meets the ground.

    A single block below all others is taken for a stray: the row above it counts then. The
    lowest row is covered by COVERED at least, so that the edge lies above its middle in the mean.
    """
    bottom = x[:, 1] + 0.5 * block[:, 1]
    edge = np.sort(bottom)[-2] if len(bottom) > 3 else bottom.max()
    lowest = bottom >= edge - 0.5
    height = float(np.max(block[lowest, 1]))
    edge -= (0.5 - COVERED) * height
    return Contact(np.array([np.mean(x[lowest, 0]), edge]), height / np.sqrt(12))


def contact_depth(ground: np.ndarray, contact_: Contact, K: np.ndarray, slope: np.ndarray,
                  centre: np.ndarray) -> ContactDepth | None:
    """Depth of a region's centre from the ground plane under its lower edge, the scale prior.

    ``ground`` (3,) is n / d in camera k; ``slope`` and ``centre`` (2,) are the region's. None
    where the contact lies at the horizon or above: it tells nothing then.
    """
    ray = np.linalg.solve(K, np.r_[contact_.point, 1.0])
    offset = ray[:2] - centre
    inverse_depth, relative = -ground @ ray, 1 + slope @ offset
    by_row = -ground[1] / K[1, 1]
    sigma = abs(by_row) * contact_.sigma / inverse_depth if inverse_depth > 0 else np.inf
    if not sigma < 0.5 or relative < 0.2:
        return None
    return ContactDepth(float(np.log(relative / inverse_depth)), float(sigma**2),
                        offset / relative)
