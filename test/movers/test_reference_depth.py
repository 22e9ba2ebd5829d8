"""What stood still a while ago, carried on by the camera: a car ahead of a camera that drives."""

from dataclasses import replace

from mv_slapse.config import ExtractionSettings
from mv_slapse.extraction.extractor import PlaneExtractor
from mv_slapse.geometry.blocks import grid_centres
from mv_slapse.geometry.camera import to_rays
from mv_slapse.motion.observations import Depths
from mv_slapse.movers import reference_depth as past_module
from mv_slapse.movers import score
from mv_slapse.movers.reference_depth import departure, Past
from mv_slapse.records import CameraMotion, Extraction, Label, MotionStatus, SegmentKind
from mv_slapse.simulation.drawn import draw
from mv_slapse.simulation.street import Street, StreetSettings
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

K = np.array([[500.0, 0, 319.5], [0, 500, 239.5], [0, 0, 1]])
SIZE = 640, 480
CENTRES = grid_centres(*SIZE)
PERIOD = 100_000_000  # [ns]
AHEAD = np.array([0.0, 0.0, -1.0])
BEHIND = 26.0  # [baseline] from the face's first place to what stands behind it


def seen(depth, gone=1.0, sigma=0.01, half=2.0, rng=None):
    """Return the Depths of a face that stood at a depth and of what is behind; which are its own.

    It is ``gone`` times as far now.
    """
    rays = to_rays(K, CENTRES)
    on = np.all(np.abs(rays[:, :2] * depth * gone) < half, axis=1)
    rho = 1 / np.where(on, depth * gone, depth + BEHIND)
    noise = 0.0 if rng is None else rng.normal(0, sigma, len(rho))
    return Depths(rays, rho * (1 + noise), sigma * rho, CENTRES), on


def extraction_at(stamp):
    n = len(CENTRES)
    return Extraction(stamp, stamp - PERIOD, *SIZE, SegmentKind.PP, K,
                      CameraMotion(MotionStatus.MOVING), x_cur=CENTRES, x_prev=CENTRES,
                      sigma=np.ones(n), block=np.full((n, 2), 16.0), label=np.zeros(n, np.int8),
                      plane_id=np.full(n, -1))


def drive(depth, pairs=6, rng=None, kept=slice(None)):
    """Return the Past of a face that stands at a depth after some pairs, and the last stamp."""
    past = Past()
    for k in range(pairs):
        past = past.carried(k * PERIOD, np.eye(3), AHEAD, 0.0)
        past = past.noted(k * PERIOD, seen(depth + pairs - 1 - k, rng=rng)[0][kept])
    return past, (pairs - 1) * PERIOD


def judged(past, stamp, depths, ground=None):
    """Return departures in the next key frame, the camera one baseline on."""
    stamp += PERIOD
    return departure(past.carried(stamp, np.eye(3), AHEAD, 0.0), extraction_at(stamp), depths,
                     ground)


def test_points_move_as_the_camera_and_its_baseline_tell(rng):
    R = Rotation.from_rotvec(rng.normal(0, 0.1, 3)).as_matrix()
    t, X = rng.normal(size=3), rng.normal(size=(9, 3))
    past = Past(np.full(9, 5), X).carried(7, R, t, np.log(2.0))
    np.testing.assert_allclose(past.X, [R @ (x / 2) + t for x in X])
    assert past.stamp.tolist() == [5] * 9


def test_what_stands_has_not_departed(rng):
    depths, on = seen(14.0, rng=rng)
    found = judged(*drive(15.0, rng=rng), depths)
    assert not np.any(found > 0)
    assert np.mean(found[on] < 0) > 0.5


def test_what_goes_away_has_departed_but_not_what_is_behind_it(rng):
    depths, on = seen(14.0, 1.2, rng=rng)
    found = judged(*drive(15.0, rng=rng), depths)
    assert np.mean(found[on] > 0) > 0.6  # its outline, too
    assert not np.any(found[~on] > 0)


def test_blocks_at_an_outline_tell_less_than_those_within():
    depths, on = seen(14.0, 1.2)
    within = seen(14.0, 1.2, half=1.0)[1]
    found = judged(*drive(15.0), depths)
    left = found > 0
    assert np.all(found[within & left] == pytest.approx(np.log(0.75 / 0.005)))
    assert np.any(left & ~within)
    assert np.min(found[left]) == pytest.approx(np.log(0.75 / 0.05))


def test_what_has_not_quite_departed_tells_little(rng):
    told = [judged(*drive(15.0), seen(14.0, gone)[0]) for gone in (1.0, 1.07)]
    on = seen(14.0, 1.07)[1]
    stays, unsure = (found[on & (found < 0)] for found in told)
    assert np.median(stays) == pytest.approx(np.log(0.25 / 0.995))
    assert np.median(stays) < np.median(unsure) < 0


@pytest.mark.parametrize(('height', 'departs'), [(2.5, True), (1.2, False)])
def test_no_vehicle_stood_below_the_ground(height, departs):
    """The face hangs from 2 above to 2 below the camera: less of it is below a lower ground."""
    depths, on = seen(14.0, 1.2)
    low = on & (to_rays(K, CENTRES)[:, 1] * 14.0 * 1.2 > 1.6)
    found = judged(*drive(15.0), depths, np.array([0.0, -1 / height, 0.0]))
    assert np.any(found[low] > 0) == departs
    assert np.any(found[on & ~low] > 0)


def test_between_the_points_of_what_came_near_those_around_tell():
    depths, on = seen(14.0, 1.2)
    every_other = np.sum(CENTRES // 16, axis=1) % 2 == 0
    found = judged(*drive(15.0, kept=every_other), depths)
    assert np.mean(found[on] > 0) > 0.15


def test_an_edge_is_no_departure(rng):
    """Blocks at the outline show now the face, now what is behind it."""
    depths, on = seen(14.0, rng=rng)
    edge = on & ~seen(14.0, half=1.5)[1]
    depths.rho[edge] /= 1.3
    assert not np.any(judged(*drive(15.0, rng=rng), depths) > 0)


@pytest.mark.parametrize(('share', 'departs'), [(0.2, True), (1.0, False)])
def test_what_is_much_farther_at_once_is_a_wrong_vector(share, departs):
    depths, on = seen(14.0)
    inner = seen(14.0, half=1.5)[1]
    depths.rho[inner] /= 1 + share
    assert np.any(judged(*drive(15.0), depths) > 0) == departs


def test_a_wrong_vector_alone_departs_from_nothing():
    depths, on = seen(14.0)
    depths.rho[np.flatnonzero(on)[len(on[on]) // 2]] /= 1.2
    assert not np.any(judged(*drive(15.0), depths) > 0)


@pytest.mark.parametrize(('age', 'known'), [(0.2, False), (0.4, True), (0.8, False)])
def test_only_what_was_seen_a_while_ago_counts(age, known):
    stamp = round(age * 1e9)
    past = Past().noted(0, seen(15.0)[0]).carried(stamp, np.eye(3), AHEAD, 0.0)
    found = departure(past, extraction_at(stamp), seen(14.0)[0])
    assert np.any(found) == known


def test_vague_depths_and_unknown_ones_tell_nothing():
    depths, on = seen(14.0, 1.2)
    past = drive(15.0)
    assert not np.any(judged(*past, replace(depths, rho=0 * depths.rho)))
    assert not np.any(judged(*past, replace(depths, sigma=0.3 * depths.rho)))
    assert not len(Past().noted(0, replace(depths, sigma=0.3 * depths.rho)).X)


def found_after(street, seed, first=0):
    """Return for how long [s] a car has driven at 0.3 m/s or more when half of it is moving."""
    rng, extractor = np.random.default_rng(seed), PlaneExtractor(street.camera,
                                                                ExtractionSettings())
    start = next(i for i in range(150) if street.movers[0].profile.speed(street.time(i)) >= 0.3)
    for j in range(first + 4, start + 45, 4):
        drawn = draw(street, j - 4, j, rng, 0.3, 0.05)
        found = extractor.extract(drawn.correspondences)
        on = drawn.label == Label.MOVING
        if j > start and np.mean(found.label[on] == Label.MOVING) > 0.5:
            return (j - start) / street.settings.fps
    return np.inf


@pytest.mark.parametrize('seed', range(3))
def test_a_car_that_starts_is_found_while_it_still_looks_like_one_that_stands(seed, monkeypatch):
    street = Street(StreetSettings(seed=seed, movers=('starting',), n_frames=150))
    # Its foot gives it away as well, later or sooner.
    monkeypatch.setattr(score, 'RULES', score.RULES._replace(bodies=0.0))
    delay = found_after(street, seed)
    assert delay < 0.8
    monkeypatch.setattr(past_module, 'RULES', past_module.RULES._replace(youngest=np.inf))
    assert found_after(street, seed) > delay + 0.2
