"""A map of blocks that persists, on drawn drives through the canyon."""

from canyon import CANYON, HEIGHT, K, motion, views, WIDTH
from mv_slapse.geometry import plane as plane_geometry
from mv_slapse.geometry import rotation
from mv_slapse.geometry.rotation import exp
from mv_slapse.motion.estimate import MotionFit
from mv_slapse.surfaces.block_map import BlockMap
import numpy as np
import pytest
from scipy.spatial import cKDTree

SIZE = (WIDTH, HEIGHT)
STEP = 100_000_000  # ns


class Drive:
    """A camera among planes, and the map of what its pairs show."""

    def __init__(self, rng, sigma=0.2, outliers=0.1):
        self.rng, self.noise = rng, {'sigma': sigma, 'outliers': outliers}
        self.planes, self.map, self.stamp = CANYON, BlockMap().at(0), 0

    def pair(self, R, t):
        """Return what a pair shows that moves by t [the first baseline]."""
        length = np.linalg.norm(t)
        planes = self.planes if self.stamp == 0 else np.array(
            [plane_geometry.transform(plane, R, t) for plane in self.planes])
        scene = views(R, t / length, self.rng, planes=planes * length, **self.noise)
        self.planes, self.stamp = planes, self.stamp + STEP
        return scene.pair

    def step(self, R, t):
        """Take in a pair; returns its motion against the map, None for the first."""
        pair, before = self.pair(R, t), self.map
        fit = MotionFit(R, t / np.linalg.norm(t), np.eye(6), 0.0)
        known = before.known(pair, SIZE)
        found = before.moving(pair, known, fit, 0.1)
        moved = (found.R, found.t) if found else (R, t)
        self.map = before.moved(self.stamp, moved, pair, known, SIZE)
        return found

    def turn(self, R, t):
        """Take in a pair that seems to turn on the spot."""
        pair, before = self.pair(R, t), self.map
        known = before.known(pair, SIZE)
        found = before.turning(pair, known, R)
        self.map = before.moved(self.stamp, (found.R, found.t), pair, known, SIZE)
        return found


@pytest.fixture
def drive(rng):
    """Return a drive of some pairs, all with the first baseline."""
    drive = Drive(rng)
    R, t = motion('ahead')
    assert drive.step(R, t) is None
    for _ in range(4):
        found = drive.step(R, t)
        assert found.length == pytest.approx(1.0, rel=0.03)
    return drive


def test_a_pair_has_the_length_of_its_way(drive):
    R, t = motion('ahead')
    for length in (1.3, 0.7, 0.4):
        found = drive.step(R, length * t)
        assert found.length == pytest.approx(length, rel=0.02)
        assert abs(np.log(found.length / length)) < 5 * np.hypot(found.sigma, 0.003)
        assert np.linalg.norm(rotation.log(found.R @ R.T)) < 0.002


@pytest.mark.parametrize('direction', ['ahead', 'sideways'])
def test_what_comes_into_view_nearer_than_usual_makes_no_way_longer(rng, direction):
    """Of noisy pairs the map does not know the nearer half: they are as long as with all of it."""
    drive = Drive(rng, sigma=0.5)
    R, t = motion(direction)
    fit = MotionFit(R, t, np.eye(6), 0.0)
    drive.step(R, t)
    drive.step(R, t)
    longer = []
    for _ in range(4):
        pair = drive.pair(R, t)
        known = drive.map.known(pair, SIZE)
        far = known[:, 0] < np.median(known[np.isfinite(known[:, 1]), 0])
        hidden = np.where(far[:, None], known, (0.0, np.inf, 0.0))
        found = drive.map.moving(pair, known, fit, 0.1)
        longer.append(drive.map.moving(pair, hidden, fit, 0.1).length / found.length - 1)
        drive.map = drive.map.moved(drive.stamp, (found.R, found.t), pair, known, SIZE)
    assert abs(np.mean(longer)) < 0.004


def test_the_length_is_kept_through_a_rest(drive):
    R, t = motion('ahead')
    drive.stamp += 20 * STEP
    drive.map = drive.map.rested(drive.stamp)
    assert not drive.map.velocity.any()
    assert drive.step(R, 0.5 * t).length == pytest.approx(0.5, rel=0.02)


def test_the_length_is_kept_through_turns_on_the_spot(drive):
    """Turned away by 29 degrees and back, with a hundredth of the way in each pair."""
    R, t = motion('ahead without turning')
    for angle in [0.1] * 5 + [-0.1] * 5:
        found = drive.turn(exp(np.array([0, angle, 0])), 0.01 * t)
        assert found.length < 0.05
        assert np.linalg.norm(found.R - exp(np.array([0, angle, 0]))) < 0.002
    assert drive.step(R, t).length == pytest.approx(1.0, rel=0.03)


def test_a_hover_keeps_the_length(drive, rng):
    R, t = motion('sideways')
    for _ in range(10):
        way = 0.02 * rng.normal(size=3)
        drive.turn(exp(0.01 * rng.normal(size=3)), way)
    assert drive.step(R, 0.8 * t).length == pytest.approx(0.8, rel=0.08)


def test_a_rotation_that_starts_wrong_is_put_right(drive):
    R, t = motion('ahead')
    pair = drive.pair(R, t)
    known = drive.map.known(pair, SIZE)
    wrong = exp(np.array([0.002, -0.004, 0.001])) @ R
    found = drive.map.moving(pair, known, MotionFit(
        wrong, exp(np.array([0.1, 0.1, 0])) @ t, np.eye(6), 0.0), 0.1)
    error = np.r_[rotation.log(found.R @ R.T), found.t / found.length - t]
    assert np.abs(error[:3]).max() < 0.001
    assert np.abs(error[3:]).max() < 0.02
    assert error[:3] @ np.linalg.solve(found.covariance[:3, :3], error[:3]) < 60


def test_what_is_out_of_view_is_kept(drive):
    before = len(drive.map.points)
    R = exp(np.array([0, 1.2, 0]))
    turned = drive.map.moved(drive.stamp + STEP, (R, np.zeros(3)), drive.pair(*motion('ahead'))[
        np.zeros(0, int)], np.zeros((0, 3)), SIZE)
    assert len(turned.points) > 0.9 * before
    np.testing.assert_allclose(np.linalg.norm(turned.points[:, :3], axis=1), 1)


def test_what_contradicts_the_map_takes_its_place_in_the_end(drive):
    """The scene comes to half its distance: the first pair does not overwrite it, ten do."""
    R, t = motion('ahead without turning')

    def median(x):
        """Return the usual inverse distance."""
        return np.median(x.points[:, 3])

    before = median(drive.map)
    drive.planes = 2 * drive.planes
    pair = drive.pair(R, t)
    known = drive.map.known(pair, SIZE)
    drive.map = drive.map.moved(drive.stamp, (R, t), pair, known, SIZE)
    assert median(drive.map) < 1.4 * before
    for _ in range(10):
        pair = drive.pair(R, 0.1 * t)
        known = drive.map.known(pair, SIZE)
        drive.map = drive.map.moved(drive.stamp, (R, 0.1 * t), pair, known, SIZE)
    assert median(drive.map) > 1.4 * before


def test_a_gap_begins_a_new_map(drive):
    assert drive.map.at(drive.stamp) is drive.map
    assert len(drive.map.at(drive.stamp + 1).points) == 0


def test_without_a_view_the_last_motion_goes_on(drive):
    coasted = drive.map.coasted(drive.stamp + STEP // 2, K, SIZE)
    np.testing.assert_allclose(coasted.velocity, drive.map.velocity, rtol=1e-6)
    assert coasted.usual(coasted.stamp + STEP) == pytest.approx(1.0, rel=0.03)
    assert BlockMap().at(7).usual(8) == 1.0


def test_without_a_view_a_turn_goes_on_for_as_long_as_it_takes(drive):
    R = exp(np.array([0, 0.04, 0]))
    drive.turn(R, 0.01 * motion('ahead without turning')[1])
    before = drive.map.points[:, :3]
    coasted = drive.map.coasted(drive.stamp + 3 * STEP, K, SIZE)
    np.testing.assert_allclose(coasted.R, exp(np.array([0, 0.12, 0])), atol=0.005)
    off, _ = cKDTree(before).query(coasted.points[:, :3] @ coasted.R)
    assert np.median(off) < 0.005
