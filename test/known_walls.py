"""A corner of a street as two runs see it: ground, facades, and walls across."""

from mv_slapse.geometry import rotation
from mv_slapse.records import MapPlane, ScaleStatus, SceneEstimate, TrackingStatus
from mv_slapse.ros_frames import Pose
import numpy as np

SIGMA = np.array([0.01, 0.01, 0.1])  # of two angles [rad] and the distance at the middle [m]
#: normal, a point of it; x right, y down, z forward [m]
GROUND = (0, -1, 0), (0, 1.6, 20)
LEFT, RIGHT = ((1, 0, 0), (-8, -2, 25)), ((-1, 0, 0), (9, -2, 30))
AHEAD = (0, 0, -1), (0, -2, 60)
CORNER, STREET = (GROUND, LEFT, RIGHT, AHEAD), (GROUND, LEFT, RIGHT)


def seen(walls, known_from_world: Pose, seed: int = 0, first_id: int = 0) -> tuple[MapPlane, ...]:
    """Return walls, given in the frame of the map, as a run sees them whose {W} lies there."""
    rng, R, t = np.random.default_rng(seed), known_from_world.R, known_from_world.t
    return tuple(_plane(rng, first_id + i, R.T @ np.array(normal, float), R.T @ (point - t))
                 for i, (normal, point) in enumerate(walls))


def _plane(rng, id_, normal, centre):
    across = np.linalg.svd(normal[None])[2][1:]
    error = rng.normal(0, SIGMA)
    wrong = normal + error[:2] @ across
    wrong /= np.linalg.norm(wrong)
    # of (normal, depth): what the distance at the middle and the angles leave for the origin
    J = np.zeros((4, 3))
    J[:3, :2], J[3, :2], J[3, 2] = across.T, -across @ centre, 1
    outline = centre + np.array([[a, b] for a in (-9, 9) for b in (-2, 2)]) @ across
    return MapPlane(id_, wrong, float(-wrong @ centre + error[2]), J @ np.diag(SIGMA**2) @ J.T,
                    outline, 0, 10**9, 20, 12, normal[1] < -0.9)


def scene(planes, stamp=10**9, scale=ScaleStatus.METRIC, status=TrackingStatus.OK):
    eye = np.eye(6) * 1e-4
    return SceneEstimate(stamp, status, '', np.eye(3), np.zeros(3), eye, np.array([0, 0, 8.0]),
                         np.zeros(3), eye, scale, 'camera height', tuple(planes), 0.8)


def pose(rng, metres=3.0, radians=0.1) -> Pose:
    """Return where a run may begin: about the origin."""
    return Pose(rotation.exp(rng.normal(0, radians, 3)), rng.normal(0, metres, 3))


def corner(rng):
    """Return a corner of any street: facades and a wall across, each turned a little."""
    def turned(x, z):
        c, s = np.cos(angle := rng.uniform(-0.26, 0.26)), np.sin(angle)
        return c * x + s * z, 0, c * z - s * x

    return (GROUND, (turned(1, 0), (-rng.uniform(4, 15), -2, rng.uniform(15, 40))),
            (turned(-1, 0), (rng.uniform(4, 15), -2, rng.uniform(15, 40))),
            (turned(0, -1), (rng.uniform(-5, 5), -2, rng.uniform(25, 90))))


ORIGIN = Pose(np.eye(3), np.zeros(3))
