"""Flat textured quadrilaterals, stacked, and the rays that meet them.

A point of quad q is corner + u edge_u + v edge_v with u, v in [0, 1]. For a ray r = X / Z,
[edge_u edge_v corner]^-1 r = (u, v, 1) / Z: one 3x3 product gives place and inverse depth.
"""

from dataclasses import dataclass, fields

import numpy as np

SKY = -1
FIRST_MOVER = 1000


@dataclass(frozen=True)
class Quads:
    """Q parallelograms.

    Attributes
    ----------
    corner, edge_u, edge_v : (Q, 3) float64
        Corner and edges [m].
    surface : (Q,) int
        Plane id, mover id from FIRST_MOVER, or SKY.
    texture : (Q,) int
        Index of the texture.
    tile : (Q, 4) float64
        Texture tiles along u and v, and the tile coordinates of the corner [tile].
    shade : (Q,) float64
        Brightness factor.
    layer : (Q,) int
        Of coplanar quads the higher one is seen.
    """

    corner: np.ndarray
    edge_u: np.ndarray
    edge_v: np.ndarray
    surface: np.ndarray
    texture: np.ndarray
    tile: np.ndarray
    shade: np.ndarray
    layer: np.ndarray

    def __len__(self) -> int:
        """Return the number of quads."""
        return len(self.corner)

    def moved(self, R: np.ndarray, t: np.ndarray) -> 'Quads':
        """Return the quads in another frame, X' = R X + t."""
        rest = [getattr(self, item.name) for item in fields(self)[3:]]
        return Quads(self.corner @ R.T + t, self.edge_u @ R.T, self.edge_v @ R.T, *rest)

    def corners(self) -> np.ndarray:
        """Return the corners in order around each quad, (Q, 4, 3)."""
        a, u, v = self.corner, self.edge_u, self.edge_v
        return np.stack([a, a + u, a + u + v, a + v], 1)

    def inverses(self) -> np.ndarray:
        """Return (Q, 3, 3) that map a ray X / Z to (u, v, 1) / Z; zero for a quad seen edge on."""
        frames = np.stack([self.edge_u, self.edge_v, self.corner], 2)
        volumes = np.linalg.det(frames)
        flat = np.abs(volumes) < 1e-9 * np.prod(np.linalg.norm(frames, axis=1), axis=1)
        frames[flat] = np.eye(3)
        found = np.linalg.inv(frames)
        found[flat] = 0
        return found


def stack(parts: list[Quads]) -> Quads:
    """Return several stacks as one."""
    return Quads(*(np.concatenate([getattr(part, item.name) for part in parts])
                   for item in fields(Quads)))


def nearness(w: np.ndarray, layer: np.ndarray) -> np.ndarray:
    """Return inverse depth w with coplanar layers told apart, larger is seen first."""
    return w * (1 + 3e-5 * layer)


def cast(quads: Quads, rays: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the quad (N,) int that each ray meets first, -1 for none, and its depth (N,) [m].

    ``quads`` and ``rays`` (N, 3), last coordinate 1, are in the camera's frame.
    """
    U, V, W = np.moveaxis(quads.inverses() @ rays.T, 1, 0)
    hit = (W > 0) & (U >= 0) & (U <= W) & (V >= 0) & (V <= W)
    near = np.where(hit, nearness(W, quads.layer[:, None]), 0)
    first = near.argmax(0)
    met = near.max(0) > 0
    w = W[first, np.arange(len(rays))]
    return np.where(met, first, -1), np.where(met, 1 / np.where(met, w, 1), np.inf)
