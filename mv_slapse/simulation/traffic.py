"""Cars: which move, where, how fast; which are parked.

Cars do not see each other: of slower, starting, stopping and bus_beside (right lane) and of
faster, same_speed and bus_ahead (own lane), take one each where they should not drive through one
another.
"""

from mv_slapse.simulation import textures
from mv_slapse.simulation.paths import Path, SpeedProfile, steady
from mv_slapse.simulation.surfaces import FIRST_MOVER
from mv_slapse.simulation.vehicles import Car
import numpy as np

KINDS = ('slower', 'faster', 'same_speed', 'oncoming', 'crossing', 'starting', 'stopping',
         'bus_ahead', 'bus_beside')
BUS = (2.6, 3.4, 9.0)  # width, height, length [m]
SIZES = {'bus_ahead': BUS, 'bus_beside': BUS}
OWN_LANE, RIGHT_LANE, LEFT_LANE, PARKING = 0.0, 3.4, -3.6, 6.4   # lateral [m]
CROSSING_AT = 50.0   # arc length of the street that crosses [m]


def crossings(kinds: tuple[str, ...]) -> tuple[float, ...]:
    """Return the arc lengths [m] at which streets cross."""
    return (CROSSING_AT,) if 'crossing' in kinds else ()


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
    lateral, start, profile = plans[kind]
    if kind == 'crossing':
        place = path.at(CROSSING_AT)
        x, z = place.position
        path = Path(origin=(float(x), float(z)), heading=place.heading + np.pi / 2)
    return Car(id_, kind, path, lateral, start, profile, _paint(), SIZES.get(kind, Car.size),
               shade=rng.uniform(0.6, 1.2))


def park(n: int, path: Path, rng: np.random.Generator) -> tuple[Car, ...]:
    """Return n cars that stand at the right kerb."""
    starts = 22 + 17 * np.arange(n) + rng.uniform(0, 6, n)
    return tuple(Car(-1, f'parked car {k}', path, PARKING, float(s), steady(0.0), _paint(),
                     shade=rng.uniform(0.6, 1.2)) for k, s in enumerate(starts))


def _paint() -> tuple[int, int, int]:
    return (textures.index('car_end'), textures.index('car_side'), textures.index('car_top'))
