"""What vectors that no neighbour supports tell of the ground around a region."""

from mv_slapse.geometry import epipolar
from mv_slapse.geometry.camera import to_rays
from mv_slapse.movers.score import Seen
from mv_slapse.records import CameraMotion, Extraction
import numpy as np

LONE_GATE = 2.0  # [sigma] of the epipolar error of one that may be right
LONE_OUTLIER = 0.4  # as region_scores.OUTLIER: they are a fifth as often right as others


def with_lone(seen: Seen, lone: Extraction | None, motion: CameraMotion,
              ground: np.ndarray | None) -> Seen:
    """Return what is seen with the lone vectors of the pair that may be right."""
    if lone is None or ground is None:
        return seen
    x, R, t = lone.x_cur.astype(float), motion.R_cur_from_prev, motion.t_cur_from_prev
    rays, before = to_rays(lone.K, x), to_rays(lone.K, lone.x_prev.astype(float))
    focal = np.diag(lone.K)[:2]
    rho, per_pixel = epipolar.inverse_depth(rays, before, focal, R, t)
    error = np.abs(epipolar.epipolar_error(rays, before, focal, R, t)) / lone.sigma
    columns = (x, rho, per_pixel * lone.sigma, -(rays @ ground), np.zeros(len(x), bool),
               np.full(len(x), LONE_OUTLIER))
    return Seen(*(np.concatenate([own, other[error < LONE_GATE]])
                  for own, other in zip(seen, columns, strict=True)))
