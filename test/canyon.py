"""Two views of a canyon with known answers: road, two facades, an end wall and the sky."""

from dataclasses import dataclass

from mv_slapse.geometry.camera import to_pixels, to_rays
from mv_slapse.geometry.two_view import Pair
import numpy as np
from scipy.spatial.transform import Rotation

WIDTH, HEIGHT = 640, 480
K = np.array([[500.0, 0, 319.5], [0, 510, 239.5], [0, 0, 1]])
GRID = np.stack(np.meshgrid(np.arange(7.5, WIDTH, 16), np.arange(7.5, HEIGHT, 16)), -1).reshape(
    -1, 2)
# n / d in the current camera, in baselines: road, left and right facade, end wall.
CANYON = np.array([[0, -1 / 1.6, 0], [1 / 5.0, 0, 0], [-1 / 6.0, 0, 0], [0, 0, -1 / 30]])
SKY = -1
ROOF = 4.0  # what is higher above the camera is sky [baselines]
# Motions X_cur = R X_prev + t, |t| = 1: where the camera goes, and its turn [rad].
MOTIONS = {
    'ahead': ((0.0, 0.0, -1.0), (0.002, 0.01, -0.003)),
    'ahead without turning': ((0.02, 0.01, -1.0), (0, 0, 0)),
    'backward': ((0.05, 0.0, 1.0), (0.0, -0.02, 0.004)),
    'sideways': ((-1.0, 0.02, 0.0), (0.001, 0.015, 0.0)),
    'turning': ((0.15, 0.0, -1.0), (0.0, 0.12, 0.0)),
}


def motion(name):
    """Return R_cur_from_prev and unit t_cur_from_prev."""
    t, w = (np.array(v, float) for v in MOTIONS[name])
    return Rotation.from_rotvec(w).as_matrix(), t / np.linalg.norm(t)


@dataclass(frozen=True)
class Views:
    """Correspondences of a lattice of blocks, and their truth.

    x_true is x_prev without noise; surface the row of ``planes``, SKY at infinity; outlier marks
    vectors wrong on purpose.
    """

    R: np.ndarray
    t: np.ndarray
    planes: np.ndarray
    x_cur: np.ndarray
    x_prev: np.ndarray
    x_true: np.ndarray
    surface: np.ndarray
    outlier: np.ndarray
    sigma: np.ndarray

    @property
    def pair(self):
        return Pair(to_rays(K, self.x_cur), to_rays(K, self.x_prev), self.x_prev, self.sigma, K)

    @property
    def focal(self):
        return np.diag(K)[:2]

    @property
    def rho(self):
        """Inverse depth in the current camera [1/baseline], 0 for the sky."""
        rays = to_rays(K, self.x_cur)
        return np.where(self.surface < 0, 0, -np.sum(rays * self.planes[self.surface], axis=1))

    @property
    def points(self):
        """Points in the current camera; directions for the sky."""
        return to_rays(K, self.x_cur) / np.where(self.rho > 0, self.rho, 1)[:, None]


def views(R, t, rng=None, sigma=0.0, outliers=0.0, planes=CANYON, x_cur=GRID):
    """Draw one vector for each block whose point the previous camera sees."""
    planes = np.asarray(planes, float).reshape(-1, 3)
    rays = to_rays(K, x_cur)
    rho = np.c_[-rays @ planes.T, np.full(len(rays), 1e-12)]
    surface = np.argmax(rho, axis=1)
    rho = rho.max(axis=1)
    surface[(surface == len(planes)) | (rays[:, 1] < -ROOF * rho)] = SKY
    X_prev = (rays - np.where(surface < 0, 0, rho)[:, None] * t) @ R
    seen = X_prev[:, 2] > 0.1
    x_true = to_pixels(K, X_prev[seen])
    n = len(x_true)
    outlier, error = np.zeros(n, bool), np.zeros((n, 2))
    if rng is not None:
        outlier = rng.uniform(size=n) < outliers
        error = np.where(outlier[:, None], rng.uniform(-24, 24, (n, 2)),
                         sigma * rng.normal(size=(n, 2)))
    return Views(R, t, planes, x_cur[seen], x_true + error, x_true, surface[seen], outlier,
                 np.full(n, max(sigma, 1e-3)))


def turn_between(R_a, R_b):
    """Return the angle [rad] between two rotations."""
    return Rotation.from_matrix(R_a.T @ R_b).magnitude()


def angle_between(a, b):
    """Return the angle [rad] between two directions."""
    return np.arctan2(np.linalg.norm(np.cross(a, b)), a @ b)
