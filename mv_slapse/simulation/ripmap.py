"""Textures averaged beforehand over every power of two along u and v, and their sampling.

A picture element sees a long narrow piece of a wall or road that runs away from the camera. A
pyramid that shrinks u and v together blurs or aliases there, and aliases corrupt motion vectors.
"""

import cv2
from mv_slapse.simulation.textures import SIZE
import numpy as np

LEVELS = SIZE.bit_length() - 1
COLUMNS = 4   # tiles side by side in the atlas
WIDTHS = SIZE >> np.arange(LEVELS)
STARTS = np.r_[0, np.cumsum(WIDTHS + 2)].astype(np.float32)   # each cell has a border of 1
PITCH = int(STARTS[-1])
SHARPNESS = 0.8   # footprint over which is averaged [px]


class Atlas:
    """All tiles with all levels in one picture."""

    def __init__(self, tiles: list[np.ndarray]):
        """Average the tiles (SIZE, SIZE) uint8."""
        rows = -(-len(tiles) // COLUMNS)
        self._atlas = np.zeros((rows * PITCH, COLUMNS * PITCH), np.uint8)
        for n, tile in enumerate(tiles):
            top, left = PITCH * (n // COLUMNS), PITCH * (n % COLUMNS)
            _fill(self._atlas[top:top + PITCH, left:left + PITCH], tile)

    def sample(self, texture: np.ndarray, place: tuple[np.ndarray, np.ndarray],
               footprint: tuple[np.ndarray, np.ndarray]) -> np.ndarray:
        """Return grey values (H, W) float32.

        ``texture`` (H, W) int, ``place`` (u, v) [tile] and ``footprint`` of a pixel along u and
        v [tile], (H, W) float32 each.
        """
        x, mix_u = _levels(place[0], footprint[0], PITCH * (texture % COLUMNS))
        y, mix_v = _levels(place[1], footprint[1], PITCH * (texture // COLUMNS))
        top = _mix(self._look(x[0], y[0]), self._look(x[1], y[0]), mix_u)
        bottom = _mix(self._look(x[0], y[1]), self._look(x[1], y[1]), mix_u)
        return _mix(top, bottom, mix_v)

    def _look(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        return cv2.remap(self._atlas, x, y, cv2.INTER_LINEAR).astype(np.float32)


def _mix(a: np.ndarray, b: np.ndarray, share: np.ndarray) -> np.ndarray:
    return a + share * (b - a)


def _levels(u: np.ndarray, footprint: np.ndarray,
            start: np.ndarray) -> tuple[list[np.ndarray], np.ndarray]:
    """Return the atlas coordinate in the finer and the coarser level, and the coarser's share."""
    level = np.log2(np.maximum(footprint * np.float32(SIZE * SHARPNESS), 1))
    level = np.minimum(level, np.float32(LEVELS - 1.001))
    fine = level.astype(np.intp)
    within = u - np.floor(u)
    shift = start.astype(np.float32) + np.float32(0.5)
    widths = WIDTHS.astype(np.float32)
    found = [within * widths[k] + STARTS[k] + shift for k in (fine, fine + 1)]
    return found, level - fine


def _fill(atlas: np.ndarray, tile: np.ndarray):
    """Write all levels of a tile, each with a border that repeats it."""
    rows = tile.astype(np.float32)
    for v in range(LEVELS):
        cell = rows
        for u in range(LEVELS):
            h, w = cell.shape
            top, left = int(STARTS[v]), int(STARTS[u])
            atlas[top:top + h + 2, left:left + w + 2] = cv2.copyMakeBorder(
                cell + 0.5, 1, 1, 1, 1, cv2.BORDER_WRAP)
            cell = (cell[:, ::2] + cell[:, 1::2]) / 2
        rows = (rows[::2] + rows[1::2]) / 2
