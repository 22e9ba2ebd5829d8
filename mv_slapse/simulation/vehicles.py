"""What drives: cars as boxes, and the camera with its vibration."""

from dataclasses import dataclass
from typing import NamedTuple

from mv_slapse.simulation.paths import Path, SpeedProfile
from mv_slapse.simulation.surfaces import Quads
import numpy as np
from scipy.spatial.transform import Rotation

MOVING_SPEED = 0.05
VIBRATION = (  # amplitude (yaw, pitch, roll) [deg], frequency [Hz]: body on its springs, engine
    ((0.10, 0.25, 0.20), 1.3), ((0.05, 0.10, 0.06), 3.1), ((0.01, 0.03, 0.02), 8.7))


class Face(NamedTuple):
    """A face of a car: centre and outward normal in {S} [m], velocity of the centre [m/s]."""

    centre: np.ndarray
    normal: np.ndarray
    velocity: np.ndarray


@dataclass(frozen=True)
class Car:
    """A box on the ground that follows a path.

    Attributes
    ----------
    id, name : int, str
    path, lateral : Path, float
        Line that its centre follows, and how far to the right of it [m].
    start, profile : float, SpeedProfile
        Arc length at time 0 [m] and speed along the path.
    size : (3,) tuple
        Width, height, length [m].
    texture : (3,) tuple of int
        Of rear and front, sides, top.
    facing : int
        1: nose along the path, -1: against it (oncoming traffic has a negative speed).
    shade : float
        Brightness factor.
    """

    id: int
    name: str
    path: Path
    lateral: float
    start: float
    profile: SpeedProfile
    texture: tuple[int, int, int]
    size: tuple[float, float, float] = (1.8, 1.5, 4.2)
    facing: int = 1
    shade: float = 1.0

    def is_moving(self, time: float) -> bool:
        """Return whether the car moves."""
        return abs(self.profile.speed(time)) > MOVING_SPEED

    def pose(self, time: float) -> tuple[np.ndarray, np.ndarray]:
        """Return (R_street_from_car, t): car axes x right, y down, z along the path; on ground."""
        place = self.path.at(self.start + self.profile.distance(time))
        x, z = place.beside(self.lateral)
        return Rotation.from_euler('y', place.heading).as_matrix(), np.array([x, 0.0, z])

    def quads(self, time: float) -> Quads:
        """Return the faces rear, front, left, right, top in {S}."""
        w, h, n = self.size
        corner = np.array([[-w / 2, -h, -n / 2], [w / 2, -h, n / 2], [-w / 2, -h, n / 2],
                           [w / 2, -h, -n / 2], [-w / 2, -h, n / 2]])
        edge_u = np.array([[w, 0, 0], [-w, 0, 0], [0, 0, -n], [0, 0, n], [w, 0, 0.0]])
        edge_v = np.array([[0, h, 0], [0, h, 0], [0, h, 0], [0, h, 0], [0, 0, -n]])
        ends, sides, top = self.texture
        shade = self.shade * np.array([0.85, 0.95, 0.75, 0.9, 1.1])
        faces = Quads(corner, edge_u, edge_v, np.full(5, self.id),
                      np.array([ends, ends, sides, sides, top]),
                      np.tile([1.0, 1.0, 0.0, 0.0], (5, 1)), shade, np.full(5, 3))
        return faces.moved(*self.pose(time))

    def face_towards(self, eye: np.ndarray, time: float) -> Face:
        """Return the rear or front face if the point ``eye`` in {S} sees it at less than 60 deg.

        Else the side on which ``eye`` lies.
        """
        R, t = self.pose(time)
        seen = R.T @ (eye - t)
        along, across = self.size[2] / 2, self.size[0] / 2
        offset = np.array([0.0, -self.size[1] / 2, 0.0])
        gap = abs(seen[2]) - along
        axis = 2 if gap > 0.58 * abs(seen[0]) else 0
        normal = np.zeros(3)
        normal[axis] = np.sign(seen[axis])
        offset += normal * (along if axis == 2 else across)
        return Face(R @ offset + t, R @ normal, self._velocity(offset, time))

    def _velocity(self, offset: np.ndarray, time: float) -> np.ndarray:
        """Return the velocity in {S} of the point ``offset`` of the car."""
        place = self.path.at(self.start + self.profile.distance(time))
        swing = place.curvature * (self.lateral + offset[0])
        flat = (1 - swing) * place.ahead + offset[2] * place.curvature * place.right
        return self.profile.speed(time) * np.array([flat[0], 0.0, flat[1]])


@dataclass(frozen=True)
class Ride:
    """The camera's way: along a path, swaying in its lane, vibrating while it moves.

    Attributes
    ----------
    path, profile : Path, SpeedProfile
    height : float
        Of the camera above the ground [m].
    sway, wavelength : float
        Amplitude of the lane change [m] and its length on the road [m].
    view : float
        Direction of view to the right of the direction of travel [rad].
    pan : tuple of float
        Start [s], end [s] and angle [rad] of a turn on the spot.
    vibration : float
        Factor on VIBRATION.
    phase : (3, 3) float64
        Phases of the vibration [rad].
    """

    path: Path
    profile: SpeedProfile
    height: float
    sway: float
    wavelength: float
    view: float
    pan: tuple[float, float, float]
    vibration: float
    phase: np.ndarray

    def pose(self, time: float) -> tuple[np.ndarray, np.ndarray]:
        """Return (R_street_from_cam, t_street_from_cam)."""
        s = self.profile.distance(time)
        place = self.path.at(s)
        wave = 2 * np.pi / self.wavelength
        lateral = self.sway * (1 - np.cos(wave * s)) / 2
        slip = np.arctan(self.sway * wave * np.sin(wave * s) / 2)
        x, z = place.beside(lateral)
        yaw = place.heading + slip + self.view + self._panned(time)
        shake, bounce = self._shaken(time)
        turn = Rotation.from_euler('y', yaw) * Rotation.from_euler('YXZ', shake, degrees=True)
        return turn.as_matrix(), np.array([x, -self.height + bounce, z])

    def _panned(self, time: float) -> float:
        start, end, angle = self.pan
        share = np.clip((time - start) / max(end - start, 1e-9), 0, 1)
        return angle * (1 - np.cos(np.pi * share)) / 2

    def _shaken(self, time: float) -> tuple[np.ndarray, float]:
        """Return (yaw, pitch, roll) [deg] and the height [m] of the vibration."""
        # A camera that stands still is exactly still: drift is measured against that.
        strength = self.vibration * min(1.0, abs(self.profile.speed(time)) / 3)
        waves = [np.sin(2 * np.pi * f * time + phase)
                 for (_, f), phase in zip(VIBRATION, self.phase, strict=True)]
        amplitudes = [amplitude for amplitude, _ in VIBRATION]
        shake = np.sum(np.multiply(amplitudes, waves), axis=0)
        return strength * shake, strength * 0.005 * float(waves[0][1])
