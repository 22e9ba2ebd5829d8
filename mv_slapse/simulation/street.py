"""A street with known geometry: ground, facades, cars, and a camera that drives through it.

Built in {S} (the street: ground at y = 0, z along the road at its start) and given in {W}, the
camera of the first frame.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

from mv_slapse.config import Checked, setting
from mv_slapse.errors import UsageError
from mv_slapse.geometry.camera import Camera
from mv_slapse.simulation import buildings, traffic
from mv_slapse.simulation.paths import Path, steady, with_stop
from mv_slapse.simulation.surfaces import FIRST_MOVER, Quads, stack
from mv_slapse.simulation.vehicles import Car, Ride
import numpy as np

ROAD_BEFORE_TURN = 12.0


@dataclass(frozen=True)
class StreetSettings(Checked):
    """What a street looks like and how the camera drives; the seed settles the rest."""

    seed: int = setting(0, '-', 'another seed is another street', 0)
    n_frames: int = setting(150, '-', 'length of the clip', 1)
    fps: float = setting(30.0, 'Hz', 'frame rate', 1.0, 240.0)
    width: int = setting(640, 'px', 'picture width', 32, 4096)
    height: int = setting(480, 'px', 'picture height', 32, 4096)
    focal: float = setting(500.0, 'px', 'focal length', 50.0)
    camera_height: float = setting(1.65, 'm', 'height of the camera above the ground', 0.1)
    speed: float = setting(10.0, 'm/s', 'speed of the camera, negative: backwards', -40.0, 40.0)
    sway: float = setting(0.8, 'm', 'amplitude of the lane change', -3.0, 3.0)
    turn: float = setting(0.0, 'deg', 'how far the street turns to the right', -120.0, 120.0)
    view: float = setting(0.0, 'deg', 'direction of view to the right of travel', -180.0, 180.0)
    standstill: tuple[float, float] = setting((0.0, 0.0), 's', 'from when to when it stands')
    pan: float = setting(0.0, 'deg', 'turn on the spot while standing', -180.0, 180.0)
    vibration: float = setting(1.0, '-', 'factor on the vibration of the camera', 0.0, 20.0)
    movers: tuple[str, ...] = setting(
        ('slower', 'faster', 'oncoming'), '-', 'kinds of cars that move, of traffic.KINDS')
    parked: int = setting(1, '-', 'number of parked cars', 0, 6)
    parking: float = setting(traffic.PARKING, 'm', 'how far to the right they stand', 2.0, 10.0)
    shadows: int = setting(0, '-', 'number of shadows across the road', 0, 50)
    houses: bool = setting(True, '-', 'whether anything stands beside and beyond the road')
    noise: float = setting(1.8, 'grey', 'standard deviation of the sensor noise', 0.0, 50.0)
    contrast: float = setting(1.0, '-', 'factor on the contrast of the textures', 0.0, 3.0)


class Plane(NamedTuple):
    """A stationary plane of the street in {W}.

    Attributes
    ----------
    id, name : int, str
    normal, depth : (3,), float
        normal @ X + depth = 0 with depth >= 0 [m].
    corners : (M, 3) float64
        Of all its quads, four each in order around it [m].
    """

    id: int
    name: str
    normal: np.ndarray
    depth: float
    corners: np.ndarray


class Street:
    """A street, its traffic and its camera; the same settings give the same street."""

    def __init__(self, settings: StreetSettings = StreetSettings()):
        """Build the street of the seed."""
        unknown = set(settings.movers) - set(traffic.KINDS)
        if unknown:
            raise UsageError(f'movers {sorted(unknown)} are unknown: use {traffic.KINDS}')
        rng = np.random.default_rng(settings.seed)
        self.settings = settings
        self.camera = _camera(settings)
        path = _path(settings)
        self.ride = _ride(settings, path, rng)
        reach = self.ride.profile.distance(self.time(settings.n_frames - 1))
        crossings = traffic.crossings(settings.movers)
        scene = buildings.build(path, reach, crossings, rng, settings.houses)
        self.movers: tuple[Car, ...] = traffic.drive(settings.movers, path, settings.speed, rng)
        scene.add_cars(traffic.park(settings.parked, path, rng, settings.parking))
        buildings.add_shadows(scene, path, settings.shadows, reach, rng)
        self.names = scene.names
        R, t = self.ride.pose(0.0)
        self.R_world_from_street, self.t_world_from_street = R.T, -R.T @ t
        self._still = scene.quads().moved(R.T, -R.T @ t)

    def time(self, i: int) -> float:
        """Return the time of frame i [s]."""
        return i / self.settings.fps

    def stamp(self, i: int) -> int:
        """Return the time of frame i [ns]."""
        return round(i * 1e9 / self.settings.fps)

    def pose(self, i: int) -> tuple[np.ndarray, np.ndarray]:
        """Return (R_world_from_cam, t_world_from_cam) of frame i."""
        R, t = self.ride.pose(self.time(i))
        A, a = self.R_world_from_street, self.t_world_from_street
        return (np.eye(3), np.zeros(3)) if i == 0 else (A @ R, A @ t + a)

    def quads(self, i: int) -> Quads:
        """Return all surfaces at frame i in {W}."""
        A, a = self.R_world_from_street, self.t_world_from_street
        cars = [car.quads(self.time(i)).moved(A, a) for car in self.movers]
        return stack([self._still, *cars])

    def quads_in_camera(self, i: int) -> Quads:
        """Return all surfaces at frame i in the camera of frame i."""
        R, t = self.pose(i)
        return self.quads(i).moved(R.T, -R.T @ t)

    def mover(self, id_: int) -> Car:
        """Return the mover with an id."""
        return self.movers[id_ - FIRST_MOVER]

    def mover_motion(self, id_: int, i: int, j: int) -> tuple[np.ndarray, np.ndarray]:
        """Return (R, t) in {W}: where the points of a mover at frame i are at frame j."""
        A, a = self.R_world_from_street, self.t_world_from_street
        (R_i, t_i), (R_j, t_j) = (self.mover(id_).pose(self.time(k)) for k in (i, j))
        R = A @ R_j @ R_i.T @ A.T
        return R, A @ t_j + a - R @ (A @ t_i + a)

    @cached_property
    def planes(self) -> tuple[Plane, ...]:
        """Return the stationary planes; the id of a plane is its place in the tuple."""
        corners = self._still.corners()
        return tuple(_plane(id_, name, corners[self._still.surface == id_])
                     for id_, name in enumerate(self.names))


def _plane(id_: int, name: str, corners: np.ndarray) -> Plane:
    """Return the plane of its quads' corners (Q, 4, 3)."""
    # The largest quad gives the normal: coplanar ones agree, up to rounding.
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 3] - corners[:, 0])
    normal = normals[np.linalg.norm(normals, axis=1).argmax()]
    normal = normal / np.linalg.norm(normal)
    depth = -float(normal @ corners[0, 0])
    sign = -1.0 if depth < 0 else 1.0
    return Plane(id_, name, sign * normal, sign * depth, corners.reshape(-1, 3))


def _camera(settings: StreetSettings) -> Camera:
    K = np.array([[settings.focal, 0, (settings.width - 1) / 2],
                  [0, settings.focal, (settings.height - 1) / 2], [0, 0, 1]])
    return Camera(settings.width, settings.height, K)


def _path(settings: StreetSettings) -> Path:
    """Return the middle of the camera's lane: straight, or with one turn on an arc."""
    if not settings.turn:
        return Path()
    angle = np.radians(settings.turn)
    radius = 25.0
    return Path(((ROAD_BEFORE_TURN, 0.0), (radius * abs(angle), np.sign(angle) / radius)))


def _ride(settings: StreetSettings, path: Path, rng: np.random.Generator) -> Ride:
    start, end = settings.standstill
    stands = end > start
    profile = with_stop(settings.speed, start, end) if stands else steady(settings.speed)
    return Ride(path, profile, settings.camera_height, settings.sway,
                wavelength=float(rng.uniform(70, 100)), view=np.radians(settings.view),
                pan=(start, end, np.radians(settings.pan)), vibration=settings.vibration,
                phase=rng.uniform(0, 2 * np.pi, (3, 3)))
