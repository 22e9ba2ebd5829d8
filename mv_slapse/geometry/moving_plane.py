"""A translating plane in two views, and what they do not observe of it.

The homography (11) of [MVO] holds only the product ``(t - t_d) plane^T``. About the ray ``(c, 1)``
of a region's centre that product is ``-g w^T``:

* rate ``g`` (3,): displacement of the surface relative to the camera, ``t - t_d``, over the depth
  Z of the centre; what the vectors show.
* slope (A, B): ``w(x) = 1 + (A, B) @ (x - c)`` is the inverse depth relative to the centre's.
* log depth ``ln Z``: the gauge. Two views say nothing of it.

Lengths are in the unit of t. Motion as in [MVO], X_cur = R X_prev + t; rays have last
coordinate 1.
"""

import numpy as np

# Share of a block that a vehicle must cover to give it its vector: roads are plain, and vehicles
# are not. On rendered streets the lowest blocks end 5 to 8 px below the vehicle, not 0.
COVERED = 0.1


def homography(product: np.ndarray, K: np.ndarray, R_cur_from_prev: np.ndarray) -> np.ndarray:
    """Return H (..., 3, 3), x_prev ~ H x_cur, of moving planes by products, (11) of [MVO]."""
    return K @ R_cur_from_prev.T @ (np.eye(3) + product) @ np.linalg.inv(K)
