"""What the scene filter observes beside correspondences: lengths, mounting, course.

Each is told by a record; the kernel ``scene_update`` linearises it where the state is, again at
each step.
"""

from dataclasses import dataclass, field
from enum import IntEnum

from mv_slapse.config import SceneSettings
from mv_slapse.kernels.binding import compiled
from mv_slapse.scene.state import N_LASTING, SceneState, SPEED
import numpy as np

PAIR_HEIGHT = 1e-3  # share of the height by which a pair errs besides: crown and ruts
WIDTH = 4 + N_LASTING + 18  # of an observation as a row of numbers


class Kind(IntEnum):
    """What is observed, as in kernels/scene.hpp."""

    CAMERA_HEIGHT = 0
    MOUNTING = 1
    LEVEL_COURSE = 2
    BASELINE = 3
    DEPTH_RATIO = 4


@dataclass(frozen=True)
class Observation:
    """One direct observation of a scene's state."""

    kind: Kind
    sigma: float  # standard deviation of each of its elements
    value: float = 0.0  # height or length that is observed, where there is one [map unit]
    plane: int | None = None  # id of the plane that it is about
    # (N_LASTING,): what one standard deviation of each lasting error does to it
    lasting: np.ndarray = field(default_factory=lambda: np.zeros(N_LASTING))
    # (18,): of a DEPTH_RATIO: R and t of the pair's own motion, and the slope of its depths, see
    # scale.ratio.Depths
    depths: np.ndarray = field(default_factory=lambda: np.zeros(18))

    def row(self, state: SceneState) -> np.ndarray:
        """Return it (WIDTH,) as the kernels take it; the plane by its position in the state."""
        place = -1 if self.plane is None else list(state.planes).index(self.plane)
        return np.concatenate([(self.kind, place, self.value, self.sigma), self.lasting,
                               self.depths])


def rows(observations: list[Observation], state: SceneState) -> np.ndarray:
    """Return observations (K, WIDTH) as the kernels take them."""
    return np.array([one.row(state) for one in observations]).reshape(-1, WIDTH)


def linearised(observation: Observation, state: SceneState) -> tuple[np.ndarray, np.ndarray]:
    """Return innovation z - h (m,) at a state and derivative H of h (m, n) by its error."""
    return compiled.scene_observe(*state.arrays, rows([observation], state))


def mounted(ground: int, settings: SceneSettings, lasting: np.ndarray) -> list[Observation]:
    """Return what is known of a camera that is mounted on a ground vehicle.

    ``ground`` is the plane it drives on, ``lasting`` (N_LASTING,) what errors that last do to its
    height, as shares of it. The height swings about the mean that is observed, see
    SceneState.heave.
    """
    height = settings.camera_height
    return [Observation(Kind.CAMERA_HEIGHT, PAIR_HEIGHT * height, height, ground,
                        lasting * height),
            Observation(Kind.MOUNTING, settings.mounting_sigma, plane=ground),
            Observation(Kind.LEVEL_COURSE, settings.course_sigma)]


def height_above(state: SceneState, ground: int) -> tuple[float, np.ndarray]:
    """Return the camera's height above a plane of the map, and the derivative (n,) of its log."""
    [off], [H] = linearised(Observation(Kind.CAMERA_HEIGHT, 1.0, 0.0, ground), state)
    return float(-off), H / -off


def baseline(length: float, sigma: float, lasting: float = 0.0) -> Observation:
    """Observe the distance between the two poses [map unit] but for sigma, a share of it.

    Where the scale is free the first one is the gauge: 1. ``lasting`` is the share by which a
    speed that tells it is wrong for good.
    """
    error = np.zeros(N_LASTING)
    error[SPEED] = lasting
    return Observation(Kind.BASELINE, sigma, length, lasting=error)
