"""Cars: which move, where, how fast; which are parked.

Cars do not see each other: of slower, starting, stopping and bus_beside (right lane) and of
faster, same_speed and bus_ahead (own lane), take one each where they should not drive through one
another. AHEAD are hazards, one of them at a time: at an unchanged speed the camera would run into
each.
"""

from mv_slapse.simulation import textures
from mv_slapse.simulation.paths import Path, SpeedProfile, steady
from mv_slapse.simulation.surfaces import FIRST_MOVER
from mv_slapse.simulation.vehicles import Car
import numpy as np

BUS = (2.6, 3.4, 9.0)  # width, height, length [m]
LEADERS = {'leader_2': 2.0, 'leader_3': 3.0, 'leader_5': 5.0, 'leader_8': 8.0, 'bus_leader': 4.0,
           'cyclist': 4.0}  # [m/s]
AHEAD = (*LEADERS, 'braking_leader', 'starting_leader', 'cut_in', 'oncoming_ahead',
         'crossing_ahead', 'pedestrian')
SIZES = {'bus_ahead': BUS, 'bus_beside': BUS, 'bus_leader': BUS, 'cyclist': (0.6, 1.7, 1.8),
         'pedestrian': (0.6, 1.7, 0.6)}
KINDS = ('slower', 'faster', 'same_speed', 'oncoming', 'crossing', 'starting', 'stopping',
         'bus_ahead', 'bus_beside', *AHEAD)
OWN_LANE, RIGHT_LANE, LEFT_LANE, PARKING = 0.0, 3.4, -3.6, 6.4   # lateral [m]
CROSSING_AT = 50.0   # arc length of the street that crosses [m]
CONTACT = 4.5  # [s] until the camera meets what is ahead at a steady speed, and up to 0.4 more
MERGING = 17.0  # [m] of way on which a car that cuts in changes lanes


def crossings(kinds: tuple[str, ...]) -> tuple[float, ...]:
    """Return the arc lengths [m] at which streets cross."""
    return (CROSSING_AT,) if {'crossing', 'crossing_ahead'} & set(kinds) else ()


def drive(kinds: tuple[str, ...], path: Path, speed: float,
          rng: np.random.Generator) -> tuple[Car, ...]:
    """Return a moving car for each kind; ``speed`` [m/s] is the camera's."""
    # Oncoming cars start farther off where a crossing one must get through first.
    far = 15.0 if 'crossing' in kinds else 0.0
    return tuple(_mover(FIRST_MOVER + n, kind, path, speed, far, rng)
                 for n, kind in enumerate(kinds))


def _mover(id_: int, kind: str, path: Path, speed: float, far: float,
           rng: np.random.Generator) -> Car:
    gap, change, late = rng.uniform(0, 4), rng.uniform(-0.5, 0.5), rng.uniform(0, 0.3)
    pace = abs(speed)
    plans = {  # lateral [m], arc length at time 0 [m], speed
        'slower': (RIGHT_LANE, 16 + gap, steady(0.6 * pace + change)),
        'faster': (OWN_LANE, 9 + gap, steady(pace + 2 + change)),
        'same_speed': (OWN_LANE, 12 + gap, steady(speed)),
        'oncoming': (LEFT_LANE, 60 + far + 4 * gap, steady(-9 - change)),
        'crossing': (0.0, -18 - gap, steady(8 + change)),
        'starting': (RIGHT_LANE, 30 + gap,
                     SpeedProfile((1.5 + late, 4.0 + late), (0.0, 8 + change))),
        'stopping': (RIGHT_LANE, 26 + gap,
                     SpeedProfile((0.5 + late, 2.0 + late), (8 + change, 0.0))),
        'bus_ahead': (OWN_LANE, 13.5, steady(pace + 0.3)),
        'bus_beside': (RIGHT_LANE, 9.0, steady(pace - 0.5)),
    }
    size = SIZES.get(kind, Car.size)
    if kind in AHEAD:
        way, lateral, start, profile = _ahead(kind, path, pace, CONTACT + 0.1 * gap, size[2] / 2)
    else:
        way, (lateral, start, profile) = path, plans[kind]
    if kind == 'crossing':
        way = _across(path, CROSSING_AT, np.pi / 2)
    return Car(id_, kind, way, lateral, start, profile, _paint(), size,
               shade=rng.uniform(0.6, 1.2))


def _ahead(kind: str, path: Path, pace: float, contact: float,
           half: float) -> tuple[Path, float, float, SpeedProfile]:
    """Return way, lateral, start and speed of what the camera meets after ``contact`` [s].

    Half its length lies before its middle. The road is straight where it merges.
    """
    if kind in LEADERS:
        lateral = 0.7 if kind == 'cyclist' else OWN_LANE
        return path, lateral, half + contact * (pace - LEADERS[kind]), steady(LEADERS[kind])
    if kind == 'crossing_ahead':
        return _across(path, CROSSING_AT, np.pi / 2), 0.0, -5.0 * CROSSING_AT / pace, steady(5.0)
    if kind == 'pedestrian':
        return _across(path, contact * pace, -np.pi / 2), 0.0, -1.4 * contact, steady(1.4)
    if kind == 'oncoming_ahead':
        return path, OWN_LANE, half + contact * (pace + 6.0), steady(-6.0)
    if kind == 'braking_leader':  # brakes hard from the camera's speed, two seconds ahead
        return path, OWN_LANE, half + 2.1 * pace, SpeedProfile((1.2, 3.2), (pace, 0.0))
    if kind == 'starting_leader':
        return path, OWN_LANE, half + 3.1 * pace, SpeedProfile((0.8, 2.8), (0.0, 0.5 * pace))
    speed, bend = 0.65 * pace, 4 * RIGHT_LANE / MERGING**2
    start = half + contact * (pace - speed)
    pieces = ((start, 0.0), (MERGING / 2, -bend), (MERGING / 2, bend))
    x, z = path.at(0).beside(RIGHT_LANE)
    return Path(pieces, (float(x), float(z))), 0.0, start, steady(speed)


def _across(path: Path, s: float, turned: float) -> Path:
    """Return the way that crosses a path at an arc length [m], its heading turned [rad]."""
    place = path.at(s)
    x, z = place.position
    return Path(origin=(float(x), float(z)), heading=place.heading + turned)


def park(n: int, path: Path, rng: np.random.Generator,
         lateral: float = PARKING) -> tuple[Car, ...]:
    """Return n cars that stand on the right, ``lateral`` [m] beside the camera's lane."""
    starts = 22 + 17 * np.arange(n) + rng.uniform(0, 6, n)
    return tuple(Car(-1, f'parked car {k}', path, lateral, float(s), steady(0.0), _paint(),
                     shade=rng.uniform(0.6, 1.2)) for k, s in enumerate(starts))


def _paint() -> tuple[int, int, int]:
    return (textures.index('car_end'), textures.index('car_side'), textures.index('car_top'))
