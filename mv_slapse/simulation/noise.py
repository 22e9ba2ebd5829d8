"""Errors of motion vectors as encoders make them, on exact correspondences: for filter tests.

Encoders do not err at random: neighbours share their error, a surface as a whole looks too near
or too far, all vectors of a stream lean a little one way or tell of a point beside the middle of
their block, and some are plainly wrong. The road itself is not at the same height everywhere.
"""

from dataclasses import dataclass, replace

from mv_slapse.config import Checked, setting
from mv_slapse.geometry.blocks import MACROBLOCK
from mv_slapse.geometry.camera import to_pixels, to_rays
from mv_slapse.geometry.rotation import exp
from mv_slapse.records import Correspondences, Label
from mv_slapse.simulation.drawn import draw, DrawnPair, match, SEARCH
from mv_slapse.simulation.street import Street
from mv_slapse.simulation.surfaces import SKY
import numpy as np
from scipy import ndimage


@dataclass(frozen=True)
class VectorNoise(Checked):
    """Sizes of the errors; the defaults are about what was measured on real streams."""

    sigma: float = setting(0.3, 'px', 'standard deviation of a right vector', 0.0, 10.0)
    together: float = setting(
        0.1, '-', 'share of its variance that a block has in common with its neighbours', 0.0, 1.0)
    outliers: float = setting(0.1, '-', 'share of wrong vectors', 0.0, 1.0)
    relief: float = setting(
        0.03, '-', 'depth of a block about its surface, as a share of depth', 0.0, 1.0)
    surface_bias: float = setting(
        0.01, '-', 'share by which a whole surface looks too near in one pair', 0.0, 1.0)
    depth_bias: float = setting(
        0.01, '-', 'share by which everything looks too near in all pairs', 0.0, 1.0)
    offset: float = setting(
        0.012, 'px', 'error that all vectors of a pair share, and again that all pairs share', 0.0,
        10.0)
    mover_lean: float = setting(
        0.2, 'px', 'the same for each share of the vectors that movers have, and a roll where '
        'sides differ: encoders predict vectors from those around', 0.0, 16.0)
    place: float = setting(
        0.4, 'px', 'standard deviation of the place in its block that a vector tells of, to the '
        'right and down, which all pairs share', 0.0, 16.0)
    heave: float = setting(
        0.0, '-', 'standard deviation of the height above the road that is seen, as a share: '
        'of a vehicle 0.02', 0.0, 1.0)
    heave_time: float = setting(0.3, 's', 'for which that height lasts', 1e-3)


class NoisyVectors:
    """Draws the correspondences of a street, pair after pair, with errors that last."""

    def __init__(self, street: Street, noise: VectorNoise, rng: np.random.Generator):
        """Draw what lasts over the pairs."""
        self._street, self._noise, self._rng = street, noise, rng
        self._turn = rng.normal(0, 1, 3)  # in standard deviations
        self._depth = rng.normal(0, noise.depth_bias)
        self._beside = rng.normal(0, noise.place, 2)
        self._heave = rng.normal(0, noise.heave)

    def pair(self, i: int, j: int) -> Correspondences:
        """Return what a codec would tell of frames i (previous) and j (current)."""
        noise, rng = self._noise, self._rng
        drawn = draw(self._street, i, j, rng, 0.0, 0.0)
        x_cur = drawn.correspondences.x_cur.astype(float)
        self._sway(abs(j - i) / self._street.settings.fps)
        x_prev = self._turned(drawn.x_true, float(np.mean(drawn.label == Label.MOVING)))
        x_prev += noise.sigma * self._common(x_cur)
        x_prev += self._share(drawn.surface)[:, None] * self._parallax(i, j, x_cur, drawn.x_true)
        x_prev += self._misplaced(i, j, x_cur, drawn)
        wrong = rng.uniform(size=len(x_cur)) < noise.outliers
        x_prev[wrong] = drawn.x_true[wrong] + rng.uniform(-SEARCH, SEARCH, (wrong.sum(), 2))
        return replace(
            drawn.correspondences, x_prev=x_prev.astype(np.float32),
            sigma=np.full(len(x_cur), max(noise.sigma, 1e-3), np.float32),
            probability=np.full(len(x_cur), 1 - noise.outliers, np.float32))

    def _sway(self, time: float):
        """Let the height above the ground change for a time [s]."""
        left = np.exp(-time / self._noise.heave_time)
        self._heave = left * self._heave + np.sqrt(1 - left**2) * self._rng.normal(
            0, self._noise.heave)

    def _misplaced(self, i: int, j: int, x: np.ndarray, drawn: DrawnPair) -> np.ndarray:
        """Return what a point beside each block's middle (N, 2) moves otherwise (N, 2) [px].

        Blocks at the edge of a surface keep to their middle.
        """
        if not self._beside.any():
            return np.zeros_like(x)
        there, surface, seen = match(self._street, i, j, x + self._beside)
        same = seen & (surface == drawn.surface)
        return np.where(same[:, None], there - self._beside - drawn.x_true, 0.0)

    def _turned(self, x: np.ndarray, movers: float) -> np.ndarray:
        """Return pixels (N, 2) as a camera sees them that is turned a little.

        ``movers`` is their share of the vectors.
        """
        K, noise = self._street.camera.K, self._noise
        rays = to_rays(K, x)
        arm = np.array([1.0, 1.0, 1 / np.sqrt(2 * np.mean(np.square(rays[:, :2])))])
        sigma = np.hypot(noise.offset, noise.mover_lean * movers * arm) / K[0, 0]
        turn = sigma * (self._turn + self._rng.normal(0, 1, 3))
        return to_pixels(K, rays @ exp(turn).T)

    def _common(self, x: np.ndarray) -> np.ndarray:
        """Return unit errors (N, 2) that neighbouring blocks have partly in common."""
        camera, share = self._street.camera, self._noise.together
        rows, columns = camera.height // MACROBLOCK, camera.width // MACROBLOCK
        wide = self._rng.normal(size=(rows + 2, columns + 2, 2))
        smooth = 3 * ndimage.uniform_filter(wide, (3, 3, 0))[1:-1, 1:-1]
        own = self._rng.normal(size=smooth.shape)
        cell = (x // MACROBLOCK).astype(int)
        return (np.sqrt(1 - share) * own + np.sqrt(share) * smooth)[cell[:, 1], cell[:, 0]]

    def _share(self, surface: np.ndarray) -> np.ndarray:
        """Return the share (N,) of its parallax by which each block errs."""
        noise, rng = self._noise, self._rng
        share = self._depth + noise.relief * rng.normal(size=len(surface))
        for id_ in np.unique(surface):
            share[surface == id_] += rng.normal(0, noise.surface_bias)
        share[surface == self._street.names.index('ground')] -= self._heave
        return np.where(surface == SKY, 0.0, share)

    def _parallax(self, i: int, j: int, x_cur: np.ndarray, x_prev: np.ndarray) -> np.ndarray:
        """Return what of the motion (N, 2) the camera's way makes [px]."""
        R = self._street.pose(j)[0].T @ self._street.pose(i)[0]
        K = self._street.camera.K
        return x_prev - to_pixels(K, to_rays(K, x_cur) @ R)
