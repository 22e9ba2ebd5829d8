"""Pictures of a street with an exact depth test for each pixel, and what each pixel shows."""

from collections.abc import Iterator
from functools import lru_cache
from typing import NamedTuple

import cv2
from mv_slapse.simulation import textures
from mv_slapse.simulation.ripmap import Atlas
from mv_slapse.simulation.street import Street
from mv_slapse.simulation.surfaces import nearness, Quads, SKY
import numpy as np

NEAREST = 0.05   # [m]
LENS_BLUR = 0.5   # standard deviation of the lens' point spread [px]


class Frame(NamedTuple):
    """A rendered frame: grey picture (H, W) uint8 and the surface (H, W) int32 of each pixel."""

    image: np.ndarray
    surface: np.ndarray


@lru_cache(maxsize=2)  # of 68 MB, drawn in 2.4 s
def _atlas(seed: int, contrast: float) -> Atlas:
    """Return the textures of a street's seed."""
    return Atlas(textures.tiles(np.random.default_rng((seed, 1)), contrast))


class Renderer:
    """Renders any frame of a street; frame i is the same however it is reached."""

    def __init__(self, street: Street):
        """Draw the textures of the street's seed."""
        settings = street.settings
        self._street = street
        self._atlas = _atlas(settings.seed, settings.contrast)
        K = street.camera.K
        self._x = (np.arange(street.camera.width) - K[0, 2]).astype(np.float32)
        self._y = (np.arange(street.camera.height) - K[1, 2]).astype(np.float32)[:, None]

    def frames(self) -> Iterator[Frame]:
        """Render all frames in order."""
        for i in range(self._street.settings.n_frames):
            yield self.frame(i)

    def frame(self, i: int) -> Frame:
        """Render frame i."""
        quads = self._street.quads_in_camera(i)
        focal = self._street.camera.K[0, 0]
        # Rows (u, v, 1) / Z as functions of the pixel, counted from the principal point.
        maps = (quads.inverses() / (focal, focal, 1)).astype(np.float32)
        quad = self._first_quads(quads, maps)
        image = self._shaded(quads, maps, quad)
        image = cv2.GaussianBlur(image, (0, 0), LENS_BLUR)
        noise = np.random.default_rng((self._street.settings.seed, 2, i))
        image += self._street.settings.noise * noise.standard_normal(image.shape, np.float32)
        surface = np.where(quad < 0, SKY, quads.surface[quad]).astype(np.int32)
        return Frame(np.clip(image + 0.5, 0, 255).astype(np.uint8), surface)

    def _first_quads(self, quads: Quads, maps: np.ndarray) -> np.ndarray:
        """Return the quad (H, W) that each pixel sees, -1 for none."""
        height, width = len(self._y), len(self._x)
        first = np.full((height, width), -1, np.intp)
        nearest = np.zeros((height, width), np.float32)
        boxes = _boxes(quads, self._street.camera.K, width, height)
        scale = nearness(np.ones(len(quads)), quads.layer).astype(np.float32)
        for n in np.flatnonzero((boxes[:, 0] < boxes[:, 2]) & (boxes[:, 1] < boxes[:, 3])):
            left, top, right, bottom = boxes[n]
            part = (slice(top, bottom), slice(left, right))
            U, V, W = (a * self._x[part[1]] + (b * self._y[part[0]] + c) for a, b, c in maps[n])
            near = W * scale[n]
            seen = (U >= 0) & (U <= W) & (V >= 0) & (V <= W) & (near > nearest[part])
            np.copyto(nearest[part], near, where=seen)
            first[part][seen] = n
        return first

    def _shaded(self, quads: Quads, maps: np.ndarray, quad: np.ndarray) -> np.ndarray:
        """Return the picture (H, W) float32 of the seen quads, without lens and noise."""
        tile = quads.tile.astype(np.float32)
        rows = maps.copy()
        rows[:, :2] = tile[:, :2, None] * maps[:, :2] + tile[:, 2:, None] * maps[:, 2:]
        coefficients = np.ascontiguousarray(rows.reshape(-1, 9).T)
        Ux, Uy, U1, Vx, Vy, V1, Wx, Wy, W1 = (np.take(c, quad) for c in coefficients)
        depth = 1 / np.maximum(Wx * self._x + Wy * self._y + W1, 1e-9)
        u = (Ux * self._x + Uy * self._y + U1) * depth
        v = (Vx * self._x + Vy * self._y + V1) * depth
        along_u = depth * np.sqrt((Ux - u * Wx) ** 2 + (Uy - u * Wy) ** 2)
        along_v = depth * np.sqrt((Vx - v * Wx) ** 2 + (Vy - v * Wy) ** 2)
        grey = self._atlas.sample(quads.texture[quad], (u, v), (along_u, along_v))
        return grey * np.take(quads.shade.astype(np.float32), quad)


def _boxes(quads: Quads, K: np.ndarray, width: int, height: int) -> np.ndarray:
    """Return (Q, 4) int: left, top, right, bottom of what a quad may cover; empty if nothing."""
    corners = quads.corners()
    following = np.roll(corners, -1, 1)
    z, z_next = corners[..., 2], following[..., 2]
    crossing = (z < NEAREST) != (z_next < NEAREST)
    share = (NEAREST - z) / np.where(crossing, z_next - z, 1)
    cut = corners + share[..., None] * (following - corners)
    points = np.concatenate([corners, cut], 1)
    valid = np.concatenate([z >= NEAREST, crossing], 1)
    depth = np.where(valid, points[..., 2], 1)
    pixels = points[..., :2] / depth[..., None] * (K[0, 0], K[1, 1]) + K[:2, 2]
    low = np.where(valid[..., None], pixels, np.inf).min(1)
    high = np.where(valid[..., None], pixels, -np.inf).max(1)
    size = (width, height)
    return np.c_[np.clip(np.floor(low), 0, size), np.clip(np.ceil(high) + 1, 0, size)].astype(int)
