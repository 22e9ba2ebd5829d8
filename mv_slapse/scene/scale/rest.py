"""What stands in for a length where a camera has been at rest, or the ground is not seen yet."""

from typing import NamedTuple

from mv_slapse.changed import replace
from mv_slapse.config import SceneSettings
from mv_slapse.geometry import two_view
from mv_slapse.geometry.camera import to_rays
from mv_slapse.geometry.rotation import norm
from mv_slapse.records import Extraction, Label, MotionStatus, SceneEstimate
from mv_slapse.scene.state import plane_in_camera, SceneState
import numpy as np

STANDING = 'the camera stands still'
TURNING = 'the camera turns on the spot'
RESTS = (MotionStatus.STANDSTILL, MotionStatus.ROTATION_ONLY)  # where the camera does not move on
ABRUPT = ('the picture stands still, but the camera moved too fast just before to have stopped: '
          'the stream may be frozen')
DRIVEN = ('the picture stands still, but the speed given says that the camera goes on: the stream '
          'may be frozen, or the wheels slip')
SUDDEN = 5.0  # standard deviations of the random walk of a speed by which it hardly changes
SEEN = 5.0  # px that the nearest plane would have moved by: no picture passes for still with that
LOW = 0.07  # tangent of the angle below the horizon: the ground within 14 camera heights
SUPPOSED_SIGMA = 0.2  # of the log of a baseline so supposed: 4 to 12 % was met, and 50 % once
ROAD = 1.5  # camera heights to either side, which a road is wide


class Stop(NamedTuple):
    """When [ns] a picture began to stand still, and the velocity (3,) in {W} just before [m/s].

    ``way`` [m]: that speeds given have told since.
    """

    stamp: int
    velocity: np.ndarray
    way: float = 0.0

    def is_doubtful(self, stamp: int, settings: SceneSettings) -> bool:
        """Tell whether nothing could have stopped so soon as to be at rest at a stamp [ns].

        A stream that freezes looks like a stop; the longer it lasts the more likely it is one.
        """
        brakes = SUDDEN * settings.acceleration * np.sqrt((stamp - self.stamp) * 1e-9)
        return bool(norm(self.velocity) > brakes)

    def doubted(self, scene: SceneEstimate) -> SceneEstimate:
        """Return an estimate as unsure as the camera may have gone on."""
        seconds = (scene.stamp - self.stamp) * 1e-9
        way, speed = self.velocity * seconds, self.way / seconds if seconds > 0 else 0.0
        pose, twist = scene.pose_covariance.copy(), scene.twist_covariance.copy()
        pose[:3, :3] += np.outer(way, way) + np.eye(3) * self.way**2
        twist[:3, :3] += np.outer(self.velocity, self.velocity) + np.eye(3) * speed**2
        return replace(scene, pose_covariance=pose, twist_covariance=twist)


def doubt(stop: Stop | None, extraction: Extraction, state: SceneState, way: float,
          settings: SceneSettings) -> tuple[Stop | None, str]:
    """Return a stop that may be none, and why; None and nothing where the camera is at rest.

    ``way`` [m]: of this pair by a speed that is given, 0 without one.
    """
    if way > SEEN * reach(state) / extraction.K[0, 0]:
        stop = stop or Stop(extraction.previous_stamp, np.zeros(3))
        return stop._replace(way=stop.way + way), DRIVEN
    if stop and stop.is_doubtful(extraction.stamp, settings):
        return stop, ABRUPT
    return None, ''


def supposed_baseline(extraction: Extraction, camera_height: float) -> float:
    """Return the first baseline [m] where no ground is seen yet, 0 where nothing tells it.

    As if most of what lies low ahead of a level camera were ground.
    """
    rays, before = (to_rays(extraction.K, x.astype(float))
                    for x in (extraction.x_cur, extraction.x_prev))
    motion, focal = extraction.motion, np.diag(extraction.K)[:2]
    rho, _ = two_view.inverse_depth(rays, before, focal, motion.R_cur_from_prev,
                                    motion.t_cur_from_prev)
    across, down = np.abs(rays[:, 0]), rays[:, 1]
    road = (down > LOW) & (across < ROAD * down) & (rho > 0)
    road &= extraction.label == Label.STATIONARY.value
    return camera_height * float(np.median(rho[road] / down[road])) if road.any() else 0.0


def reach(state: SceneState) -> float:
    """Return the distance of the nearest plane: there a way of it / focal makes one pixel.

    Where no plane is known, that of a baseline seen under an angle of 3 degrees.
    """
    planes = [plane_in_camera(state, id) for id in state.planes]
    nearest = max((np.linalg.norm(plane) for plane in planes), default=0.0)
    return float(1 / nearest) if nearest else 20 * float(np.exp(state.depth_scale))
