"""Procedural textures, seeded: brick, windows, weak road, car panels, all with fine grain.

Every tile repeats seamlessly. Grey values are float32 around a mean; v runs downwards.
"""

from collections.abc import Callable

import cv2
import numpy as np

SIZE = 1024   # of a tile [texel]
TILE_SIZE = {  # side of one tile [m]; 1: the tile covers the quad
    'asphalt': 10.0, 'paving': 8.0, 'paint': 4.0, 'patch': 3.0, 'brick': 8.0, 'plaster': 9.0,
    'windows': 14.0, 'shops': 16.0, 'panels': 12.0, 'tower': 24.0, 'sky': 40000 / 3,
    'car_end': 1.0, 'car_side': 1.0, 'car_top': 1.0}
NAMES = tuple(TILE_SIZE)
FACADES = ('brick', 'plaster', 'windows', 'shops', 'panels')


def index(name: str) -> int:
    """Return the number of a texture."""
    return NAMES.index(name)


def tiles(rng: np.random.Generator, contrast: float = 1.0) -> list[np.ndarray]:
    """Return all tiles in the order of NAMES, (SIZE, SIZE) uint8, contrast about their means."""
    found = []
    for name in NAMES:
        tile = MAKERS[name](rng)
        mean = tile.mean()
        found.append(np.clip(mean + contrast * (tile - mean), 4, 250).astype(np.uint8))
    return found


def noise(rng: np.random.Generator, slope: float, stretch: float = 1.0) -> np.ndarray:
    """Return periodic noise of unit variance with an amplitude ~ frequency^-slope.

    Slope 1 has the same contrast at every scale; ``stretch`` > 1 draws it out along u.
    """
    v, u = np.fft.fftfreq(SIZE)[:, None], np.fft.rfftfreq(SIZE)[None]
    frequency = np.hypot(v, stretch * u) * SIZE
    frequency[0, 0] = np.inf
    white = np.fft.rfft2(rng.standard_normal((SIZE, SIZE), dtype=np.float32))
    field = np.fft.irfft2(white * frequency ** -slope, s=(SIZE, SIZE))
    return (field / field.std()).astype(np.float32)


def _cells(rng: np.random.Generator, rows: int, columns: int, joint: int,
           bond: bool = False) -> tuple[np.ndarray, np.ndarray]:
    """Return a random value for each cell of a grid, drawn to texels, and where the joints are.

    ``bond`` shifts every other row by half a cell, as bricks are laid.
    """
    value = np.kron(rng.standard_normal((rows, columns)).astype(np.float32),
                    np.ones((SIZE // rows, SIZE // columns), np.float32))
    joints = np.zeros((SIZE, SIZE), bool)
    for k in range(joint):
        joints[k::SIZE // rows] = True
        joints[:, k::SIZE // columns] = True
    if bond:
        row = np.arange(SIZE) // (SIZE // rows) % 2 == 1
        shift = SIZE // columns // 2
        value[row] = np.roll(value[row], shift, 1)
        joints[row] = np.roll(joints[row], shift, 1)
    return value, joints


def _windows(tile: np.ndarray, rng: np.random.Generator, grid: tuple[int, int],
             share: tuple[float, float], span: tuple[float, float] = (0.0, 1.0)):
    """Draw windows over a span of v of a tile; ``share`` is their part of a cell (v, u).

    ``grid``: rows and columns.
    """
    (rows, columns), (v0, v1) = grid, span
    high, wide = (v1 - v0) * SIZE / rows, SIZE / columns
    for row in range(rows):
        for column in range(columns):
            top = int(v0 * SIZE + (row + (1 - share[0]) / 2) * high)
            left = int((column + (1 - share[1]) / 2) * wide)
            h, w = int(share[0] * high), int(share[1] * wide)
            frame = tile[top:top + h, left:left + w]
            frame[:] = 205 + rng.normal(0, 10)
            b = max(2, w // 14)
            _glass(frame[b:-b, b:w // 2], rng)
            _glass(frame[b:-b, w // 2 + b:-b], rng)
            tile[top + h:top + h + 2 * b, left:left + w] -= 40


def _glass(pane: np.ndarray, rng: np.random.Generator):
    """Draw one pane: dark, with a reflection and sometimes a curtain."""
    h, w = pane.shape
    slant = np.linspace(0, 1, h)[:, None] + rng.uniform(-1, 1) * np.linspace(0, 1, w)[None]
    pane[:] = rng.uniform(40, 75) + rng.uniform(0, 45) * slant + rng.normal(0, 3, (h, w))
    if rng.uniform() < 0.4:
        pane[:int(h * rng.uniform(0.2, 0.8))] += rng.uniform(40, 90)


def _asphalt(rng: np.random.Generator) -> np.ndarray:
    tile = 98 + 7 * noise(rng, 1.0) + 5 * noise(rng, 0.3) + 4 * noise(rng, 1.2, 0.15)
    mask = np.zeros((SIZE, SIZE), np.uint8)
    for _ in range(7):
        walk = np.cumsum(rng.normal(0, 14, (60, 2)) + rng.normal(0, 6, 2), 0)
        points = (rng.uniform(0.2, 0.8, 2) * SIZE + walk).astype(np.int32)
        cv2.polylines(mask, [points], False, 1, 2)
    return tile - 18 * mask


def _paving(rng: np.random.Generator) -> np.ndarray:
    value, joints = _cells(rng, 16, 16, 3)
    return 135 + 6 * value - 30 * joints + 5 * noise(rng, 0.9)


def _paint(rng: np.random.Generator) -> np.ndarray:
    return 195 + 14 * noise(rng, 0.9) - 30 * (noise(rng, 0.8) > 1.6)


def _patch(rng: np.random.Generator) -> np.ndarray:
    return 82 + 6 * noise(rng, 0.8) + 4 * noise(rng, 0.2)


def _brick(rng: np.random.Generator) -> np.ndarray:
    value, joints = _cells(rng, 64, 32, 2, bond=True)
    tile = 105 + 7 * value + 25 * joints + 5 * noise(rng, 1.0)
    _windows(tile, rng, (3, 3), (0.55, 0.42))
    return tile


def _plaster(rng: np.random.Generator) -> np.ndarray:
    tile = 165 + 5 * noise(rng, 1.1) + 2 * noise(rng, 0.4) - 4 * (noise(rng, 1.0, 0.1) > 1.5)
    _windows(tile, rng, (3, 3), (0.5, 0.36))
    return tile


def _office(rng: np.random.Generator) -> np.ndarray:
    tile = 140 + 4 * noise(rng, 1.0)
    _windows(tile, rng, (4, 6), (0.62, 0.74))
    return tile


def _shops(rng: np.random.Generator) -> np.ndarray:
    tile = 150 + 5 * noise(rng, 1.0) + 2 * noise(rng, 0.3)
    _windows(tile, rng, (3, 5), (0.5, 0.4), (0.0, 0.72))
    _windows(tile, rng, (1, 4), (0.8, 0.85), (0.8, 1.0))
    for left in range(0, SIZE, SIZE // 4):
        sign = tile[int(0.735 * SIZE):int(0.79 * SIZE), left + 12:left + SIZE // 4 - 12]
        sign[:] = rng.uniform(50, 220)
        letters = rng.uniform(size=sign.shape[1] // 9 + 1) < 0.5
        stripes = np.repeat(letters, 9)[:sign.shape[1]]
        sign[14:-14] += 60 * stripes * (1 if sign.mean() < 130 else -1)
    return tile


def _panels(rng: np.random.Generator) -> np.ndarray:
    value, joints = _cells(rng, 16, 8, 4)
    tile = 150 + 7 * value - 35 * joints + 4 * noise(rng, 1.0, 0.2)
    _windows(tile, rng, (4, 2), (0.4, 0.6))
    return tile


def _tower(rng: np.random.Generator) -> np.ndarray:
    tile = 135 + 5 * noise(rng, 1.0)
    _windows(tile, rng, (7, 8), (0.6, 0.6))
    return tile


def _sky(rng: np.random.Generator) -> np.ndarray:
    return 212 + 11 * noise(rng, 1.7) + 1.0 * noise(rng, 1.0)


def _bodywork(rng: np.random.Generator) -> np.ndarray:
    """Return painted sheet metal: reflections and dirt, darker to the ground."""
    dirt = np.linspace(0, 1, SIZE)[:, None] ** 3
    return 128 + 6 * noise(rng, 1.2, 0.3) + 2.5 * noise(rng, 0.6) - 35 * dirt


def _box(tile: np.ndarray, v0: float, v1: float, u0: float, u1: float) -> np.ndarray:
    """Return a view of part of a tile, in fractions."""
    return tile[int(v0 * SIZE):int(v1 * SIZE), int(u0 * SIZE):int(u1 * SIZE)]


def _car_end(rng: np.random.Generator) -> np.ndarray:
    tile = _bodywork(rng)
    _glass(_box(tile, 0.08, 0.42, 0.14, 0.86), rng)
    for u in (0.03, 0.77):
        _box(tile, 0.48, 0.62, u, u + 0.2)[:] += 75
        _box(tile, 0.51, 0.56, u + 0.04, u + 0.13)[:] -= 90
    _box(tile, 0.62, 0.72, 0.34, 0.66)[:] = 215
    for u in 0.36 + 0.04 * np.arange(7):
        _box(tile, 0.64, 0.70, u, u + 0.02)[:] = 60
    _box(tile, 0.76, 0.80, 0.0, 1.0)[:] -= 40
    for u in (0.02, 0.82):
        _box(tile, 0.84, 1.0, u, u + 0.16)[:] = 35 + rng.normal(0, 4)
    return tile


def _car_side(rng: np.random.Generator) -> np.ndarray:
    tile = _bodywork(rng)
    for u0, u1 in ((0.2, 0.46), (0.5, 0.76)):
        _glass(_box(tile, 0.08, 0.4, u0, u1), rng)
    for u in (0.18, 0.48, 0.78):
        _box(tile, 0.4, 0.85, u, u + 0.008)[:] -= 50
    for u in (0.26, 0.56):
        _box(tile, 0.47, 0.5, u, u + 0.06)[:] += 60
    for u in (0.17, 0.83):
        centre = (int(u * SIZE), int(0.8 * SIZE))
        # The tile is 4.2 m long and 1.5 m high: a round wheel is an ellipse in it.
        cv2.ellipse(tile, centre, (int(0.08 * SIZE), int(0.2 * SIZE)), 0, 0, 360, 35, -1)
        cv2.ellipse(tile, centre, (int(0.045 * SIZE), int(0.12 * SIZE)), 0, 0, 360, 150, -1)
        cv2.ellipse(tile, centre, (int(0.02 * SIZE), int(0.05 * SIZE)), 0, 0, 360, 70, -1)
    return tile


MAKERS: dict[str, Callable[[np.random.Generator], np.ndarray]] = {
    'asphalt': _asphalt, 'paving': _paving, 'paint': _paint, 'patch': _patch, 'brick': _brick,
    'plaster': _plaster, 'windows': _office, 'shops': _shops, 'panels': _panels, 'tower': _tower,
    'sky': _sky, 'car_end': _car_end, 'car_side': _car_side, 'car_top': _bodywork}
