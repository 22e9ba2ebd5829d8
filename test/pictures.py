"""Pictures whose motion is known: a texture that a camera slides over."""

import cv2
import numpy as np
from scipy import ndimage

WIDTH, HEIGHT = 256, 192


def texture(rng: np.random.Generator, size: int = 900) -> np.ndarray:
    """Grey noise with detail at several scales."""
    layers = [cv2.resize(rng.normal(size=(size // step, size // step)), (size, size),
                         interpolation=cv2.INTER_CUBIC) for step in (2, 6, 20)]
    total = sum(layers)
    return np.clip(128 + 40 * total / total.std(), 0, 255).astype(np.uint8)


def moved(shown: np.ndarray, way) -> np.ndarray:
    """Return a picture (H, W) as float, which goes round: what lay at x lies at x + way [px]."""
    return np.fft.ifft2(ndimage.fourier_shift(np.fft.fft2(shown), way[::-1])).real


def sliding(rng: np.random.Generator, n: int, step: tuple[int, int],
            size: tuple[int, int] = (WIDTH, HEIGHT)) -> list[np.ndarray]:
    """Return n pictures; what lies at x in one lies at x + step in the one before [px]."""
    ground = texture(rng)
    return [ground[300 + i * step[1]:300 + i * step[1] + size[1],
                   300 + i * step[0]:300 + i * step[0] + size[0]].copy() for i in range(n)]
