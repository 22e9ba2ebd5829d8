"""A slow leader in the own lane, told by where its strips were half a second ago: drawn blocks."""

from mv_slapse.movers.identity import Memory
from mv_slapse.movers.regions import KnownGround, with_moving_planes
from mv_slapse.records import CameraMotion, Extraction, Label, MotionStatus, SegmentKind
from mv_slapse.strip_matches import NONE, StripMatches
import numpy as np
import pytest

FOCAL, HEIGHT, SPEED = 500.0, 1.65, 10.0  # px, m, m/s
K = np.array([[FOCAL, 0, 320], [0, FOCAL, 240], [0, 0, 1.0]])
DT, SPAN = 0.1, 0.4  # [s] of a pair, and that strips reach back
CAR = 1.8, 1.5  # [m] wide and high
NOISE = 0.3  # px, of vectors and of strips
THRESHOLD = 20.0


def lattice(height):
    """Centres of blocks 16 px wide, from the horizon down."""
    return np.stack(np.meshgrid(np.arange(7.5, 640, 16), np.arange(
        240 + (height - 1) / 2, 480, height)), -1).reshape(-1, 2)


def matches(x, Z, speed, dt, rng):
    """Where blocks at x were dt ago, of a road and a car Z away that drives at a speed [m/s]."""
    drop = np.maximum(x[:, 1] - 240, 1e-3)
    foot, half = FOCAL * HEIGHT / Z, FOCAL * CAR[0] / 2 / Z
    on_car = (np.abs(x[:, 0] - 320) < half) & (drop < foot) & (
        drop > foot - FOCAL * CAR[1] / Z)
    depth = np.where(on_car, Z, FOCAL * HEIGHT / drop)
    way = np.where(on_car, SPEED - speed, SPEED) * dt
    there = K[:2, 2] + (x - K[:2, 2]) * (depth / (depth + way))[:, None]
    return there + rng.normal(0, NOISE, x.shape), on_car


def pair_of(k, Z, speed, rng):
    x = lattice(16)
    there, on_car = matches(x, Z, speed, DT, rng)
    n = len(x)
    return Extraction(
        round(1e9 * DT * (k + 1)), round(1e9 * DT * k), 640, 480, SegmentKind.PP, K,
        CameraMotion(MotionStatus.MOVING, np.eye(3), np.array([0, 0, -1.0])),
        x_cur=x.astype(np.float32), x_prev=there.astype(np.float32),
        sigma=np.full(n, NOISE, np.float32), block=np.full((n, 2), 16, np.uint8),
        label=np.zeros(n, np.int8), plane_id=np.full(n, -1, np.int32)), on_car


def strips_of(k, Z, speed, rng):
    """Strips of the way ahead."""
    x = lattice(4)
    x = x[np.all(np.abs(x - [320, 272]) < [64, 32], axis=1)]
    there, _ = matches(x, Z, speed, SPAN, rng)
    return StripMatches(round(1e9 * (DT * (k + 1) - SPAN)), x.astype(np.float32),
                        there.astype(np.float32), np.full(len(x), 0.6, np.float32))


def called(speed, nearest, given, seed, pairs=12):
    """Share of the car's blocks that are called moving in the last pair, and of the others."""
    rng, memory = np.random.default_rng(seed), Memory()
    plane = np.array([0, -1.0, 0]) * SPEED * DT / HEIGHT
    for k in range(pairs):
        Z = nearest + (pairs - 1 - k) * (SPEED - speed) * DT
        extraction, on_car = pair_of(k, Z, speed, rng)
        strips = strips_of(k, Z, speed, rng) if given and k * DT >= SPAN else NONE
        found, memory = with_moving_planes(extraction, memory, THRESHOLD,
                                           KnownGround(plane, camera_height=HEIGHT), None, strips)
    moving = found.label == Label.MOVING.value
    return moving[on_car].mean(), moving[~on_car].mean()


@pytest.mark.parametrize('seed', range(3))
@pytest.mark.parametrize(('speed', 'away'), [(2.5, 13.0), (3.0, 14.0), (4.0, 18.0)])
def test_strips_tell_a_slow_leader(speed, away, seed):
    found, false = called(speed, away, True, seed)
    assert found >= 0.5
    assert false < 0.005  # blocks of the road at its edges
    assert called(speed, away, False, seed)[0] == 0  # macroblocks do not yet


@pytest.mark.parametrize('seed', range(3))
def test_what_stands_there_is_not_called_moving(seed):
    assert called(0.0, 16.0, True, seed) == (0, 0)


def test_the_way_goes_on_from_pair_to_pair_and_not_over_a_gap():
    rng = np.random.default_rng(0)
    ground = KnownGround(np.array([0, -1.0, 0]) * SPEED * DT / HEIGHT, camera_height=HEIGHT)
    memory = Memory()
    for k, known in ((0, 1), (1, 2), (2, 3), (4, 1), (5, 2)):
        _, memory = with_moving_planes(pair_of(k, 18.0, 3.0, rng)[0], memory, THRESHOLD, ground)
        assert len(memory.way.stamp) == known
        assert memory.way.stamp[-1] == round(1e9 * DT * k)
    _, memory = with_moving_planes(pair_of(6, 18.0, 3.0, rng)[0], memory, THRESHOLD,
                                   KnownGround())
    assert memory.way.stamp == ()
