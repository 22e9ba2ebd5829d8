"""Speeds as wheels would tell them along a true trajectory: drawn_speeds."""

from mv_slapse.records import Speed
from mv_slapse.storage.tum import Trajectory
import numpy as np

NOISE = 0.01  # share of the speed by which each one errs


def drawn_speeds(truth: Trajectory, seed: int, noise: float = NOISE) -> list[Speed]:
    """Return a speed [m/s] for each true pose, but for noise, a share of it.

    Of the camera's place, by the poses on both sides; forward is where the camera looks.
    """
    stamps, positions = truth.stamps, truth.positions
    velocity = np.gradient(positions, (stamps - stamps[0]) / 1e9, axis=0)
    forward = np.sum(velocity * truth.rotations()[:, :, 2], axis=1)
    value = np.copysign(np.linalg.norm(velocity, axis=1), forward)
    value *= 1 + np.random.default_rng(seed).normal(0, noise, len(value))
    return [Speed(int(stamp), float(speed)) for stamp, speed in zip(stamps, value, strict=True)]
