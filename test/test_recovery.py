"""The whole on drawn streets whose vectors fail for a while: it says so, and recovers."""

from dataclasses import replace

from mv_slapse.config import SceneSettings, Settings
from mv_slapse.geometry import rotation
from mv_slapse.pipeline import Slapse
from mv_slapse.records import MotionStatus, SegmentKind, TrackingStatus
from mv_slapse.scene.scale.height import ENOUGH
from mv_slapse.simulation.noise import NoisyVectors, VectorNoise
from mv_slapse.simulation.street import Street, StreetSettings
import numpy as np
import pytest

STEP, BEFORE, BAD, AFTER = 3, 12, 15, 15  # frames of a pair at 30 Hz; pairs


def at_random(pair, rng):
    """Return a pair whose vectors say nothing."""
    wild = rng.uniform(-16, 16, pair.x_cur.shape)
    return replace(pair, x_prev=(pair.x_cur + wild).astype(np.float32))


def dropped(pair, rng):
    """Return what the decoder says of a packet that is missing."""
    return replace(pair, kind=SegmentKind.BROKEN, reason='a packet is missing',
                   **{name: getattr(pair, name)[:0]
                      for name in ('x_cur', 'x_prev', 'sigma', 'probability', 'block')})


@pytest.mark.parametrize('fails', [at_random, dropped])
@pytest.mark.parametrize('height', [0.0, 1.65])
def test_lost_after_a_second_and_back_with_the_next_good_pair(fails, height):
    n = BEFORE + BAD + AFTER
    street = Street(StreetSettings(seed=1, n_frames=STEP * n + 1, movers=()))
    rng = np.random.default_rng(1)
    vectors = NoisyVectors(street, VectorNoise(), rng)
    whole = Slapse(street.camera, Settings(scene=SceneSettings(camera_height=height)))
    unit = 1.0 if height else np.linalg.norm(street.pose(STEP)[1])
    estimates, nees = [], []
    for k in range(n):
        pair = vectors.pair(STEP * k, STEP * (k + 1))
        scene = whole.step(fails(pair, rng) if BEFORE <= k < BEFORE + BAD else pair).scene
        R, t = street.pose(STEP * (k + 1))
        error = np.r_[t / unit - scene.t_world_from_cam,
                      rotation.log(R @ scene.R_world_from_cam.T)]
        nees.append(error @ np.linalg.solve(scene.pose_covariance, error))
        estimates.append(scene)
    status = [e.status for e in estimates]
    waiting = ENOUGH - 1 if height else 0  # the height has not told metres yet
    assert status[:BEFORE] == [TrackingStatus.INITIALISING] * waiting + [
        TrackingStatus.OK] * (BEFORE - waiting)
    assert status[BEFORE:BEFORE + 10] == [TrackingStatus.PREDICTED] * 10
    assert status[BEFORE + 10:BEFORE + BAD] == [TrackingStatus.LOST] * (BAD - 10)
    assert status[BEFORE + BAD:] == [TrackingStatus.OK] * AFTER
    assert all(e.reason for e in estimates[BEFORE:BEFORE + BAD])
    assert max(nees[waiting:]) < 22.5  # 99.9 % of chi-square with 6 degrees of freedom
    after = estimates[-1].baseline * unit
    truth = np.linalg.norm(street.pose(STEP * n)[1] - street.pose(STEP * (n - 1))[1])
    assert after == pytest.approx(truth, rel=0.15)


@pytest.mark.parametrize('height', [0.0, 1.65])
def test_a_camera_that_turns_on_the_spot_stays_where_it_is_and_keeps_its_scale(height):
    street = Street(StreetSettings(seed=2, n_frames=150, movers=(), standstill=(1.5, 3.0),
                                   pan=40.0))
    vectors = NoisyVectors(street, VectorNoise(sigma=0.2), np.random.default_rng(0))
    whole = Slapse(street.camera, Settings(scene=SceneSettings(camera_height=height)))
    unit = 1.0 if height else np.linalg.norm(street.pose(STEP)[1])
    places, lengths = [], []
    for i in range(0, 147, STEP):
        step = whole.step(vectors.pair(i, i + STEP))
        if street.time(i) >= 1.65 and street.time(i + STEP) <= 2.9:
            assert step.extraction.motion.status is MotionStatus.ROTATION_ONLY
            places.append(unit * step.scene.t_world_from_cam)
        truth = np.linalg.norm(street.pose(i + STEP)[1] - street.pose(i)[1])
        lengths.append(unit * step.scene.baseline / max(truth, 1e-9))
    assert len(places) > 8
    assert np.ptp(places, axis=0).max() < 0.01
    np.testing.assert_allclose(lengths[-8:], 1, atol=0.08)
