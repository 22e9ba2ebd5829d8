"""What the extraction of one key frame pair leaves for the next."""

from dataclasses import dataclass

from mv_slapse.changed import replace
from mv_slapse.motion.estimate import MotionFit
from mv_slapse.movers.reference_depth import Past
from mv_slapse.records import Extraction
from mv_slapse.surfaces.block_map import BaselineRatio, BlockMap
from mv_slapse.surfaces.ground import GroundTrack, Mount
from mv_slapse.surfaces.height import HeightBelief
from mv_slapse.surfaces.plane_track import KnownPlanes
import numpy as np

ANY_RATIO = 1.5  # of the log of a baseline after a stop over the one before it: a factor of 4
STEADY_SIGMA = 0.15  # of the same, unseen: 1.3 m/s at 30 km/h, a hard brake over a dead segment


@dataclass(frozen=True)
class Memory:
    """What the last key frame leaves for the next: motion, depths, ground, planes and movers.

    ``movers`` is the grid of possibly_dynamic.painted; ``height`` is in the last pair's baseline.
    """

    stamp: int | None = None
    motion: MotionFit | None = None
    previous_stamp: int | None = None
    ground: GroundTrack = GroundTrack(Mount())
    noise: float = 1.0
    next_id: int = 0
    planes: KnownPlanes = KnownPlanes.none()
    movers: np.ndarray | None = None
    height: HeightBelief = HeightBelief.blank()
    past: Past = Past()
    map: BlockMap = BlockMap()

    def turned(self, stamp: int, R) -> 'Memory':
        """Return it after the camera has turned by R_cur_from_prev on the spot."""
        floor = self.ground.plane
        floor = floor if floor is None else R @ floor
        return replace(self, stamp=stamp, previous_stamp=None,
                       planes=self.planes.turned(R), movers=None, past=Past(),
                       ground=replace(self.ground, plane=floor))

    def past_at(self, blank: Extraction, fit: MotionFit, ratio: BaselineRatio) -> Past:
        """Return what stood still before in a pair's camera; nothing where lengths are unknown."""
        if self.stamp != blank.previous_stamp or not np.isfinite(ratio.sigma):
            return Past()
        return self.past.carried(blank.stamp, fit.R_cur_from_prev, fit.t_cur_from_prev, ratio.log)

    def log_ratio(self, blank: Extraction, ratio: BaselineRatio) -> tuple[float, float]:
        """Return the logarithm of a pair's baseline over the last one, and its uncertainty.

        At an unchanged speed, where the pair does not tell it.
        """
        if np.isfinite(ratio.sigma):
            return ratio.log, ratio.sigma
        if self.previous_stamp is None:
            return 0.0, ANY_RATIO
        return float(np.log((blank.stamp - blank.previous_stamp)
                            / (self.stamp - self.previous_stamp))), STEADY_SIGMA
