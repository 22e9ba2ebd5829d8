"""What the pictures say of matches in numpy, see kernels/texture.cpp."""

from mv_slapse.geometry.blocks import grid_shape, macroblock_of
import numpy as np

NOISE, SHARE, USUAL, SMOOTH = 3, 15, 1.5, 0.7


def texture(picture):
    """Smaller eigenvalue of the structure tensor of each macroblock, (rows, columns)."""
    grey, (columns, rows) = picture.astype(float), grid_shape(*picture.shape[::-1])
    out = np.zeros((rows, columns))
    for r, c in np.ndindex(rows, columns):
        y = np.arange(16 * r or 1, min(16 * r + 16, len(grey) - 1), 2)[:, None]
        x = np.arange(16 * c or 1, min(16 * c + 16, grey.shape[1] - 1))
        dx, dy = (grey[y, x + 1] - grey[y, x - 1]) / 2, (grey[y + 1, x] - grey[y - 1, x]) / 2
        tensor = [[np.sum(dx * dx), np.sum(dx * dy)], [np.sum(dx * dy), np.sum(dy * dy)]]
        out[r, c] = 2 * max(np.linalg.eigvalsh(tensor)[0], 0)
    return out


def residual(now, then, x, vector):
    """Variance of what the macroblock around x differs by from its match."""
    left, top = np.floor(x).astype(int) - 7
    there = np.array([left, top]) + vector
    i, j = np.floor(there).astype(int)
    if min(left, top, i, j) < 0 or any(
            corner[0] + 15 + more >= picture.shape[1] or corner[1] + 15 + more >= len(picture)
            for picture, corner, more in ((now, (left, top), 0), (then, (i, j), 1))):
        return USUAL
    a, b = np.floor((there - (i, j)) * 16).astype(int)
    y, x = np.mgrid[0:16:4, 0:16]
    grey = then.astype(int)[j:j + 17, i:i + 17]
    moved = ((16 - a) * (16 - b) * grey[y, x] + a * (16 - b) * grey[y, x + 1]
             + (16 - a) * b * grey[y + 1, x] + a * b * grey[y + 1, x + 1] + 128) // 256
    return np.var(now[top + y, left + x] - moved)


def match_sigma(now, before, x_cur, x_prev, sigma):
    """Standard deviation of each match [px]."""
    picture, x = (now, x_cur) if now is not None else (before, x_prev)
    shown = texture(picture)
    column, row = np.clip(macroblock_of(x), 0, (shown.shape[1] - 1, shown.shape[0] - 1)).T
    left = np.array([USUAL if now is None or before is None else residual(now, before, *pair)
                     for pair in zip(x_cur, x_prev - x_cur, strict=True)])
    noise = NOISE ** 2 + SHARE * left
    return np.sqrt(sigma ** 2 + noise / (shown[row, column] + noise / SMOOTH ** 2))
