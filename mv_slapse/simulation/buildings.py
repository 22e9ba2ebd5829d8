"""What stands: ground, markings, rows of facades with set-backs, a far building, sky."""

from dataclasses import dataclass, field
from typing import NamedTuple

from mv_slapse.simulation import textures
from mv_slapse.simulation.paths import Path
from mv_slapse.simulation.surfaces import Quads, SKY, stack
from mv_slapse.simulation.vehicles import Car
import numpy as np

BEHIND, BEYOND = 25.0, 60.0   # how far the rows reach behind the start and past the end [m]
SET_BACKS = (0.0, 2.5, 5.0)   # of a facade behind the front line [m]
FRONT_LINE = {-1: 7.0, 1: 9.0}   # nearest facade, left and right of the camera's lane [m]
KERB = {-1: -5.4, 1: 7.6}   # edge of the road [m]
LANES = (-1.75, 1.75, 5.2)   # markings [m]
CROSS_STREET = 12.0   # width of a street that crosses [m]
SKY_DISTANCE = 20000.0
SKY_NAME = 'sky'
SAME_PLANE = 1e-6


class Look(NamedTuple):
    """How a quad looks: its texture's name, shift (u, v) in tiles and shade; what lies above."""

    texture: str
    shift: tuple[float, float] = (0.0, 0.0)
    shade: float = 1.0
    layer: int = 0  # of quads in one plane the highest is seen


@dataclass
class Scene:
    """Quads in {S} while they are collected; coplanar ones share a plane."""

    names: list[str] = field(default_factory=list)
    _planes: list[np.ndarray] = field(default_factory=list)
    _parts: list[Quads] = field(default_factory=list)

    def quads(self) -> Quads:
        """Return everything that was added."""
        return stack(self._parts)

    def add(self, name: str, corner, edge_u, edge_v, look: Look):
        """Add a quad; the name is used if its plane is new, and SKY_NAME is no plane."""
        corner, edge_u, edge_v = (np.asarray(a, float) for a in (corner, edge_u, edge_v))
        surface = SKY if name == SKY_NAME else self._surface(name, corner, edge_u, edge_v)
        size = textures.TILE_SIZE[look.texture]
        tile = [np.linalg.norm(edge_u) / size, np.linalg.norm(edge_v) / size, *look.shift]
        self._parts.append(Quads(
            corner[None], edge_u[None], edge_v[None], np.array([surface]),
            np.array([textures.index(look.texture)]), np.array([tile]), np.array([look.shade]),
            np.array([look.layer])))

    def wall(self, name: str, start: np.ndarray, end: np.ndarray, height: float, texture: str,
             rng: np.random.Generator):
        """Add an upright wall over the ground line from start to end, each (x, z)."""
        run = end - start
        self.add(name, [start[0], -height, start[1]], [run[0], 0, run[1]], [0, height, 0],
                 Look(texture, (rng.uniform(), 1 - height / textures.TILE_SIZE[texture]),
                      rng.uniform(0.75, 1.15)))

    def add_cars(self, cars: tuple[Car, ...]):
        """Add cars that never move."""
        for car in cars:
            quads = car.quads(0.0)
            faces = zip(quads.corner, quads.edge_u, quads.edge_v, strict=True)
            surface = np.array([self._surface(car.name, *face) for face in faces])
            self._parts.append(Quads(quads.corner, quads.edge_u, quads.edge_v, surface,
                                     quads.texture, quads.tile, quads.shade, quads.layer))

    def _surface(self, name: str, corner, edge_u, edge_v) -> int:
        """Return the id of the quad's plane."""
        normal = np.cross(edge_u, edge_v)
        plane = np.r_[normal, -normal @ corner] / np.linalg.norm(normal)
        for id_, known in enumerate(self._planes):
            gap = min(np.abs(known - plane).max(), np.abs(known + plane).max())
            if gap < SAME_PLANE:
                return id_
        self._planes.append(plane)
        self.names.append(name)
        return len(self.names) - 1


def build(path: Path, reach: float, crossings: tuple[float, ...], rng: np.random.Generator,
          houses: bool = True) -> Scene:
    """Return the street along a path whose camera goes ``reach`` [m]; ground is plane 0."""
    scene = Scene()
    s0, s1 = min(0.0, reach) - BEHIND, max(0.0, reach) + BEYOND
    _ground(scene, path, s0, s1, rng)
    if houses:
        for side in (-1, 1):
            _row(scene, path, side, (s0, s1), crossings, rng)
        end = path.at(s1 + rng.uniform(5, 25))
        scene.wall('far building', end.beside(-40), end.beside(40), rng.uniform(14, 22), 'tower',
                   rng)
    _sky(scene)
    return scene


def _ground(scene: Scene, path: Path, s0: float, s1: float, rng: np.random.Generator):
    x, z = path.at((s0 + s1) / 2).position
    scene.add('ground', [x - 400, 0, z + 400], [800, 0, 0], [0, 0, -800], Look('asphalt'))
    for side, kerb in KERB.items():
        outer = side * (FRONT_LINE[side] + max(SET_BACKS) + 1)
        _strip(scene, path, (s0, s1), (kerb, outer), Look('paving', layer=1))
        _strip(scene, path, (s0, s1), (kerb - 0.3 * side, kerb - 0.15 * side),
               Look('paint', layer=2))
    for lane in LANES:
        for s in np.arange(s0, s1, 9.0):
            _strip(scene, path, (s, s + 3.0), (lane - 0.07, lane + 0.07),
                   Look('paint', layer=2))
    for s in np.arange(s0, s1, 7.0) + rng.uniform(0, 4, len(np.arange(s0, s1, 7.0))):
        middle, size = rng.uniform(-4, 6), rng.uniform(0.4, 1.6)
        length = rng.uniform(0.5, 3)
        _strip(scene, path, (s, s + length), (middle, middle + size),
               Look('patch', tuple(rng.uniform(size=2)), rng.uniform(0.75, 1.1), 1))


def _strip(scene: Scene, path: Path, along, across, look: Look):
    """Add a strip of ground between two arc lengths and two lateral offsets [m]."""
    stations = path.stations(*along)
    for s, s_end in zip(stations[:-1], stations[1:], strict=True):
        a, b = path.at(s), path.at(s_end)
        left, far = a.beside(min(across)), b.beside(min(across))
        width = abs(across[1] - across[0]) * a.right
        run = left - far
        scene.add('ground', [far[0], 0, far[1]], [width[0], 0, width[1]], [run[0], 0, run[1]],
                  look)


def add_shadows(scene: Scene, path: Path, count: int, reach: float, rng: np.random.Generator):
    """Add shadows, as of trees, across the road along which the camera goes ``reach`` [m]."""
    for s in rng.uniform(0, reach + BEYOND, count):
        left = rng.uniform(KERB[-1], 0)
        _strip(scene, path, (s, s + rng.uniform(0.5, 4)), (left, left + rng.uniform(2, 7)),
               Look('patch', tuple(rng.uniform(size=2)), rng.uniform(0.4, 0.65), 3))


def _row(scene: Scene, path: Path, side: int, span: tuple[float, float],
         crossings: tuple[float, ...], rng: np.random.Generator):
    """Add a row of houses on one side: -1 left, 1 right."""
    s, before = span[0], None
    while s < span[1]:
        length, height = rng.uniform(9, 18), rng.uniform(7, 14)
        choices = [offset for offset in SET_BACKS if offset != before]
        offset, texture = choices[rng.integers(len(choices))], textures.FACADES[rng.integers(5)]
        crossing = next((c for c in crossings if s < c + CROSS_STREET / 2 <= span[1]
                         and s + length > c - CROSS_STREET / 2), None)
        end = s + length if crossing is None else max(s + 1.0, crossing - CROSS_STREET / 2)
        _house(scene, path, side, _House((s, end), offset, height, texture), rng)
        s = end if crossing is None else crossing + CROSS_STREET / 2
        before = offset


class _House(NamedTuple):
    along: tuple[float, float]  # [m] of the path
    set_back: float  # [m]
    height: float  # [m]
    texture: str


def _house(scene: Scene, path: Path, side: int, house: _House, rng: np.random.Generator):
    """Add facade and both end walls of one house."""
    name = {-1: 'left', 1: 'right'}[side]
    lateral = side * (FRONT_LINE[side] + house.set_back)
    stations = path.stations(*house.along)
    for s, s_end in zip(stations[:-1], stations[1:], strict=True):
        scene.wall(f'{name} facade', path.at(s).beside(lateral), path.at(s_end).beside(lateral),
                   house.height, house.texture, rng)
    deep = side * (FRONT_LINE[side] + max(SET_BACKS) + 6)
    for s in house.along:
        place = path.at(s)
        scene.wall(f'{name} end wall', place.beside(lateral), place.beside(deep), house.height,
                   'plaster' if s == house.along[0] else 'brick', rng)


def _sky(scene: Scene):
    """Add a box of sky around the street, so far that it has no parallax."""
    d = SKY_DISTANCE
    for angle in np.radians([0, 90, 180, 270]):
        ahead = np.array([np.sin(angle), 0, np.cos(angle)])
        right = np.array([np.cos(angle), 0, -np.sin(angle)])
        scene.add(SKY_NAME, d * ahead - d * right - [0, d, 0], 2 * d * right, [0, 1.5 * d, 0],
                  Look('sky'))
