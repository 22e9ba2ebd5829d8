"""What moves before a camera that stands, where no depth tells how a surface grows."""

from dataclasses import replace

from mv_slapse.config import ExtractionSettings
from mv_slapse.extraction.extractor import PlaneExtractor
from mv_slapse.geometry.camera import to_rays
from mv_slapse.movers.identity import Memory
from mv_slapse.movers.regions import KnownGround, with_moving_planes
from mv_slapse.records import CameraMotion, Extraction, Label, MotionStatus, SegmentKind
from mv_slapse.simulation.drawn import draw
from mv_slapse.simulation.street import Street, StreetSettings
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

K = np.array([[700.0, 0, 320], [0, 700, 180], [0, 0, 1]])
GRID = np.stack(np.meshgrid(np.arange(7.5, 640, 16), np.arange(7.5, 360, 16)), -1).reshape(-1, 2)
CAR = (np.abs(GRID[:, 0] - 320) < 60) & (GRID[:, 1] > 180) & (GRID[:, 1] < 290)


def moved(motion, threshold):
    """Return what 0.2 s show of a car whose blocks move by ``motion(x)`` [px] before all else."""
    n, off = len(GRID), motion(GRID) * CAR[:, None]
    return with_moving_planes(Extraction(
        10**9, 8 * 10**8, 640, 360, SegmentKind.PP, K,
        CameraMotion(MotionStatus.STANDSTILL, np.eye(3), np.zeros(3)), (), '',
        GRID.astype(np.float32), (GRID - off).astype(np.float32), np.full(n, 0.3, np.float32),
        np.full((n, 2), 16, np.uint8), np.zeros(n, np.int8), np.full(n, -1, np.int32)),
        Memory(), threshold, KnownGround())[0]


def test_what_parts_is_two_regions():
    found = moved(lambda x: np.sign(x - (320, 0)) * (1.6, 0), 5.0)
    sides = [found.plane_id[CAR & (side * (GRID[:, 0] - 320) > 0)] for side in (-1, 1)]
    assert [len(set(ids)) for ids in sides] == [1, 1]
    assert sides[0][0] != sides[1][0]
    assert -1 not in (sides[0][0], sides[1][0])


def test_what_comes_near_is_one_region():
    """Two seconds away, in a pair over a fifth of a second: vectors from 2 to 11 px."""
    found = moved(lambda x: 0.1 * (x - (400, 240)), 5.0)
    assert len(set(found.plane_id[CAR])) == 1
    assert np.all(found.label[CAR] == Label.MOVING)


def test_a_standing_camera_sees_traffic(rng):
    street = Street(StreetSettings(seed=1, movers=('oncoming',), n_frames=200,
                                   standstill=(0.0, 20.0)))
    extractor, hits, wrong = PlaneExtractor(street.camera, ExtractionSettings()), [], []
    for j in range(148, 196, 4):
        drawn = draw(street, j - 4, j, rng, 0.05, 0.0)
        found = extractor.extract(drawn.correspondences)
        assert found.motion.status is MotionStatus.STANDSTILL
        on_it = drawn.label == Label.MOVING
        hits.append(np.mean(found.label[on_it] == Label.MOVING) >= 0.5)
        wrong.append(np.mean(found.label[~on_it] == Label.MOVING))
    assert np.mean(hits[3:]) > 0.7
    assert max(wrong) < 0.01


@pytest.mark.parametrize(('turn', 'status'), [
    (0.0, MotionStatus.STANDSTILL), (0.006, MotionStatus.ROTATION_ONLY)])
def test_vectors_that_jump_by_half_a_pixel_are_of_what_stands(rng, turn, status):
    """As of MPEG-2: else they pass for copies of wrong vectors, and no car's are believed."""
    street = Street(StreetSettings(seed=1, movers=('oncoming',), n_frames=200,
                                   standstill=(0.0, 20.0)))
    extractor, found = PlaneExtractor(street.camera, ExtractionSettings()), []
    R = Rotation.from_euler('y', turn).as_matrix()
    for j in range(168, 192, 4):
        drawn = draw(street, j - 4, j, rng, 0.05, 0.0)
        given = drawn.correspondences
        turned = to_rays(street.camera.K, given.x_prev) @ (street.camera.K @ R).T
        jump = rng.choice((-0.5, 0.5), given.x_prev.shape) * (rng.random((len(given), 1)) < 0.35)
        shown = extractor.extract(replace(
            given, x_prev=(turned[:, :2] / turned[:, 2:] + jump).astype(np.float32)))
        still = drawn.label != Label.MOVING
        assert shown.motion.status is status
        assert np.mean(shown.label[still] == Label.STATIONARY) > 0.97
        found.append(np.mean(shown.label[~still] == Label.MOVING) >= 0.5)
    assert all(found[2:])
