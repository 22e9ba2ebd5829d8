"""Records with made-up values in every field, for round trips and file writers."""

from mv_slapse import records as r
from mv_slapse.records import Label
from mv_slapse.strip_matches import StripMatches
import numpy as np
from scipy.spatial.transform import Rotation


def rotation(rng) -> np.ndarray:
    return Rotation.random(random_state=int(rng.integers(1 << 31))).as_matrix()


def covariance(rng, n: int) -> np.ndarray:
    A = rng.normal(size=(n, n))
    return A @ A.T


def points(rng, n: int) -> dict:
    """Return the columns that correspondences and extractions share."""
    return {'x_cur': rng.uniform(0, 300, (n, 2)).astype(np.float32),
            'x_prev': rng.uniform(0, 300, (n, 2)).astype(np.float32),
            'sigma': rng.uniform(0.1, 1, n).astype(np.float32),
            'block': rng.choice([8, 16], (n, 2)).astype(np.uint8)}


def correspondences(rng, n: int = 30, stamp: int = 400_000_000) -> r.Correspondences:
    strips = StripMatches(stamp - 300_000_000, *rng.uniform(0, 300, (2, n // 3, 2)).astype(
        np.float32), rng.uniform(0.5, 1, n // 3).astype(np.float32))
    return r.Correspondences(
        stamp, stamp - 100_000_000, 320, 240, r.SegmentKind.PI, 2, 'none',
        probability=rng.uniform(0, 1, n).astype(np.float32), strips=strips, **points(rng, n))


def observation(rng, label: Label, id_: int = 7) -> r.PlaneObservation:
    size = 3 if label is Label.STATIONARY else 6
    return r.PlaneObservation(id_, label, rng.normal(size=3), covariance(rng, size),
                              rng.normal(size=3), rng.normal(size=(3, 3)),
                              r.ScalePrior.GROUND_CONTACT, True, 25, 17.5)


def extraction(rng, n: int = 30, stamp: int = 400_000_000) -> r.Extraction:
    motion = r.CameraMotion(r.MotionStatus.MOVING, rotation(rng), rng.normal(size=3),
                            covariance(rng, 6), False)
    planes = (observation(rng, Label.STATIONARY), observation(rng, Label.MOVING, 9))
    K = np.array([[500.0, 0, 160], [0, 500, 120], [0, 0, 1]])
    return r.Extraction(stamp, stamp - 100_000_000, 320, 240, r.SegmentKind.IP, K, motion, planes,
                        'why', label=rng.integers(-1, 3, n).astype(np.int8),
                        plane_id=rng.choice([-1, 7, 9], n).astype(np.int32),
                        macroblock_label=rng.integers(-1, 3, 20 * 15).astype(np.int8),
                        macroblock_plane=rng.choice([-1, 7, 9], 20 * 15).astype(np.int32),
                        **points(rng, n))


def map_plane(rng, id_: int = 7) -> r.MapPlane:
    normal = rng.normal(size=3)
    return r.MapPlane(id_, normal / np.linalg.norm(normal), float(rng.normal()),
                      covariance(rng, 4), rng.normal(size=(4, 3)), 100_000_000, 400_000_000,
                      5, 42, True)


def scene(rng, stamp: int = 400_000_000, status=r.TrackingStatus.OK) -> r.SceneEstimate:
    return r.SceneEstimate(stamp, status, 'why', rotation(rng), rng.normal(size=3),
                           covariance(rng, 6), rng.normal(size=3), rng.normal(size=3),
                           covariance(rng, 6), r.ScaleStatus.METRIC, 'camera height',
                           (map_plane(rng),), 0.8, unit=0.7)


def obstacle(rng, id_: int = 9, stamp: int = 400_000_000) -> r.Obstacle:
    return r.Obstacle(id_, stamp, r.ObstacleState.CONFIRMED, rng.normal(0, 0.2, 3),
                      rng.normal(size=3), rng.normal(size=3), covariance(rng, 6), np.inf, 2.5,
                      np.array([10.0, 20.0, 48.0, 32.0]), rng.normal(size=(5, 3)), 6, 0.5,
                      stamp - 100_000_000, r.ScalePrior.SMALLEST_MOTION)


def handover(rng, stamp: int = 400_000_000) -> r.PlaneHandover:
    return r.PlaneHandover(stamp, 9, Label.MOVING, rng.normal(0, 0.2, 3), rng.normal(size=3),
                           covariance(rng, 6))
