"""A flight through a furnished room or hall, seen through a lens: six degrees of freedom, no road.

Built in {S} (the room: floor at y = 0, y down) and given in {W}, the camera of the first frame.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import cv2
from mv_slapse.config import Checked, setting
from mv_slapse.geometry.camera import Camera, to_pixels, to_rays, undistort
from mv_slapse.simulation.buildings import Look, Scene
from mv_slapse.simulation.paths import SpeedProfile
from mv_slapse.simulation.render import Renderer
from mv_slapse.simulation.surfaces import Quads
import numpy as np
from scipy.spatial.transform import Rotation

ROOM = (9.0, 4.0, 11.0)  # across, high, long [m]
REACH = np.array([2.2, 0.7, 2.8])  # of the flight about its middle [m]
MIDDLE = np.array([0.0, -1.9, 0.0])
RATIOS = np.array([1.0, 1.3, 0.8])  # of the frequencies along the axes
WAY = 2.3  # mean speed over the frequency of the flight [m]
CLEARANCE = 0.1  # m, by which the flight keeps off the furniture
TURNS = np.array([0.9, 0.12, 0.12])  # amplitude of yaw, pitch and roll [rad]
TURN_RATES = np.array([0.6, 1.1, 0.9])  # their frequencies [rad/s]
STOP, HOVER, RAMP, RISE = 2.0, 3.0, 0.8, 3.0  # lengths of a stop, a hover, of what is before and
# after either, and of a take-off [s]
SWAY, SWAY_RATES = 0.02, np.array([1.9, 2.6, 2.2])  # of a hover: amplitude [m], [rad/s]
ON_THE_GROUND = -0.3  # y of a camera before it takes off [m]
EXPOSURES = 5  # that make a blurred picture

#: lenses as their calibrations are published for flights: 94 and 160 deg wide
WIDE = Camera(752, 480, np.array([[458.7, 0, 367.2], [0, 457.3, 248.4], [0, 0, 1]]),
              'plumb_bob', np.array([-0.2834, 0.07396, 0.00019, 1.76e-05, 0]))
FISHEYE = Camera(640, 480, np.array([[278.7, 0, 319.8], [0, 278.5, 242.0], [0, 0, 1]]),
                 'equidistant', np.array([-0.0137, 0.02064, -0.0128, 0.0025]))
CUT_FISHEYE = Camera(512, 384, FISHEYE.K - [[0, 0, 64], [0, 0, 48], [0, 0, 0]], 'equidistant',
                     FISHEYE.distortion)


@dataclass(frozen=True)
class FlightSettings(Checked):
    """How the camera flies; the seed settles the rest."""

    seed: int = setting(0, '-', 'another seed is another room and another flight', 0)
    n_frames: int = setting(150, '-', 'length of the clip', 1)
    fps: float = setting(25.0, 'Hz', 'frame rate', 1.0, 240.0)
    speed: float = setting(2.0, 'm/s', 'mean speed', 0.0, 20.0)
    spin: float = setting(1.0, '-', 'factor on all turning', 0.0, 5.0)
    furniture: int = setting(5, '-', 'boxes on the floor', 0, 50)
    noise: float = setting(1.8, 'grey', 'standard deviation of the sensor noise', 0.0, 50.0)
    contrast: float = setting(1.0, '-', 'factor on the contrast of the textures', 0.0, 3.0)
    size: float = setting(1.0, '-', 'factor on the size of the room; 2 makes a hall', 0.5, 5.0)
    take_off: float = setting(
        0.0, 's', 'for which it stands on the ground before it takes off; 0: begins in the air',
        0.0)
    stops: tuple[float, ...] = setting((), 's', 'when it stops for 2 s, without any motion')
    hovers: tuple[float, ...] = setting((), 's', 'when it hovers for 3 s, and goes on turning')
    light: float = setting(1.0, '-', 'factor on the brightness', 0.0, 1.0)
    shutter: float = setting(0.0, 's', 'time of exposure, in which turning blurs', 0.0, 0.1)


class Flight:
    """A room and a camera that flies through it; the same settings give the same flight."""

    def __init__(self, lens: Camera = WIDE, settings: FlightSettings = FlightSettings()):
        """Build the room of the seed; ``lens`` is the camera of the pictures."""
        rng = np.random.default_rng(settings.seed)
        self.settings, self.lens = settings, lens
        self._phase, self._turn_phase = rng.uniform(0, 2 * np.pi, (2, 3))
        stops = [*((0.0, settings.take_off),) * (settings.take_off > 0),
                 *((start, start + STOP) for start in settings.stops)]
        hovers = [(start, start + HOVER) for start in settings.hovers]
        self._turning, self._going = progress(stops), progress([*stops, *hovers])
        way = np.array([self._pose_in_room(i / settings.fps)[1]
                        for i in range(settings.n_frames)])
        self._room = room(settings.furniture, rng, way, settings.size)
        self._map, self.camera = _ideal(lens)
        self._start = self._pose_in_room(0.0)

    def pose(self, i: int) -> tuple[np.ndarray, np.ndarray]:
        """Return (R_world_from_cam, t_world_from_cam) of frame i."""
        (A, a), (R, t) = self._start, self._pose_in_room(i / self.settings.fps)
        return A.T @ R, A.T @ (t - a)

    def quads_in_camera(self, i: int) -> Quads:
        """Return all surfaces in the camera of frame i."""
        R, t = self._pose_in_room(i / self.settings.fps)
        return self._room.moved(R.T, -R.T @ t)

    def pictures(self) -> Iterator[np.ndarray]:
        """Render all frames (H, W) uint8 as the lens shows them."""
        for i, frame in enumerate(Renderer(self).frames()):
            yield cv2.remap(self._exposed(i, frame.image), self._map, None, cv2.INTER_LINEAR)

    def _exposed(self, i: int, image: np.ndarray) -> np.ndarray:
        """Return picture i as it is taken in little light, with the blur that its turning makes.

        What its way makes is left out; at 50 deg/s it is a third of it, for walls 4 m off.
        """
        settings = self.settings
        if settings.light == 1 and not settings.shutter:
            return image
        K, size = self.camera.K, image.shape[::-1]
        R, taken = self.pose(i)[0], np.zeros(image.shape, np.float32)
        for share in np.linspace(-0.5, 0.5, EXPOSURES):
            H = K @ self.pose(i + share * settings.shutter * settings.fps)[0].T @ R
            taken += cv2.warpPerspective(image, H @ np.linalg.inv(K), size,
                                         borderMode=cv2.BORDER_REPLICATE)
        taken *= settings.light / EXPOSURES
        noise = np.random.default_rng((settings.seed, 3, i))
        taken += settings.noise * noise.standard_normal(image.shape, np.float32)
        return np.clip(taken + 0.5, 0, 255).astype(np.uint8)

    def _pose_in_room(self, time: float) -> tuple[np.ndarray, np.ndarray]:
        settings, size = self.settings, self.settings.size
        going, turning = self._going.distance(time), self._turning.distance(time)
        swing = settings.speed / (WAY * size) * going * RATIOS + self._phase
        turn = TURN_RATES * turning + self._turn_phase
        R = Rotation.from_euler('YXZ', settings.spin * TURNS * np.sin(turn))
        place = size * (MIDDLE + REACH * np.sin(swing))
        if settings.hovers:
            place += SWAY * np.sin(SWAY_RATES * turning)
        if settings.take_off:
            risen = np.clip((time - settings.take_off) / RISE, 0, 1)
            place[1] += (1 - risen**2 * (3 - 2 * risen)) * (ON_THE_GROUND - place[1])
        return R.as_matrix(), place


def progress(pauses: list[tuple[float, float]]) -> SpeedProfile:
    """Return how fast time goes on board, 0 in pauses (from, to) [s] and 1 elsewhere."""
    knots = {0.0: 1.0}
    for start, end in sorted(pauses):
        knots |= {max(start - RAMP, 0.0): 1.0} if start > 0 else {}
        knots |= {start: 0.0, end: 0.0, end + RAMP: 1.0}
    times = sorted(knots)
    return SpeedProfile(tuple(times), tuple(knots[time] for time in times))


def room(n_boxes: int, rng: np.random.Generator, way: np.ndarray, factor: float = 1.0) -> Quads:
    """Return floor, ceiling, four walls and boxes on the floor, in {S}.

    Of ``n_boxes`` drawn those that the way (N, 3) would lead through are left out. ``factor``: on
    all sizes.
    """
    scene, (wide, high, long) = Scene(), factor * np.array(ROOM)
    _box(scene, 'room', np.array([-wide / 2, -high, -long / 2]), factor * np.array(ROOM),
         ('shops', 'brick', 'panels', 'windows', 'paving', 'plaster'), rng)
    for i in range(n_boxes):
        size = factor * (rng.uniform(0.5, 1.2, 3) * (1, 1.5, 1))
        corner = np.array([factor * rng.uniform(-3.5, 3.5), -size[1],
                           factor * rng.uniform(-4.5, 4.5)])
        gap = np.maximum(corner - way, way - corner - size).max(axis=1)
        if gap.min() > CLEARANCE:
            _box(scene, f'box {i}', corner, size, rng.choice(['panels', 'brick', 'shops'], 6), rng)
    return scene.quads()


def _box(scene: Scene, name: str, corner, size, textures, rng):
    """Add the six faces of a box; seen from within and without alike."""
    x, y, z = np.diag(size)
    faces = ((corner + z, x, y), (corner, x, y), (corner, z, y), (corner + x, z, y),
             (corner + y, x, z), (corner, x, z))
    for (place, u, v), texture in zip(faces, textures, strict=True):
        scene.add(name, place, u, v, Look(
            str(texture), tuple(rng.uniform(size=2)), rng.uniform(0.8, 1.1)))


def _ideal(lens: Camera) -> tuple[np.ndarray, Camera]:
    """Return a pinhole camera that sees what the lens does, and where each pixel looks there."""
    x = np.stack(np.meshgrid(np.arange(lens.width), np.arange(lens.height)), -1).reshape(-1, 2)
    rays = to_rays(lens.K, undistort(lens, x))
    # As sharp as the lens in the middle, or as wide pictures can be rendered.
    focal = min(lens.K[0, 0], 1300 / np.abs(rays[:, 0]).max())
    width, height = (int(2 * focal * reach) + 4 for reach in np.abs(rays[:, :2]).max(axis=0))
    K = np.array([[focal, 0, (width - 1) / 2], [0, focal, (height - 1) / 2], [0, 0, 1]])
    at = to_pixels(K, rays).reshape(lens.height, lens.width, 2)
    return at.astype(np.float32), Camera(width, height, K)
