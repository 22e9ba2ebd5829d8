"""Settings of every part, with unit, meaning, bounds and source beside each default.

The one list: ROS parameters, the YAML in ``config/`` and the table of the documentation come
from these dataclasses.
"""

from dataclasses import dataclass, field, fields
from typing import Any

from mv_slapse.errors import UsageError


def setting(default: Any, unit: str, meaning: str, low: Any = None, high: Any = None) -> Any:
    """Return a dataclass field that carries its unit, its meaning and its bounds."""
    metadata = {'doc': f'[{unit}] {meaning}', 'low': low, 'high': high}
    return field(default=default, metadata=metadata)


@dataclass(frozen=True)
class Checked:
    """Settings that refuse a value outside its bounds."""

    def __post_init__(self):
        """Reject what no run can use, naming the setting, the value and the bound."""
        for item in fields(self):
            value, low, high = (getattr(self, item.name), item.metadata['low'],
                                item.metadata['high'])
            if low is not None and not value >= low or high is not None and not value <= high:
                raise UsageError(f'{type(self).__name__}.{item.name} = {value!r} is out of '
                                 f'bounds [{low}, {high}]: {item.metadata["doc"]}')


@dataclass(frozen=True)
class DecoderSettings(Checked):
    """From packets to correspondences, [SLAPSE] III and V-A."""

    match_probability: float = setting(
        0.6, '-', 'probability p that one motion vector is right, [SLAPSE] III-B', 0.01, 0.999)
    vector_sigma: float = setting(
        0.25, 'px', 'standard deviation of a right vector, (2) of [SLAPSE]', 0.01, 10.0)
    paper_weights: bool = setting(
        False, '-', 'weigh direct to indirect evidence sqrt(2) to 1, (5) of [SLAPSE], instead of '
        'by inverse variance, 2 to 1')
    bend_slack: float = setting(
        2.0, 'px', 'how far the two vectors of a B block may depart from constant velocity', 0.0)
    bend_tolerance: float = setting(
        0.15, '-', 'the same, as a share of the motion over the segment', 0.0)
    agreement_slack: float = setting(
        1.0, 'px', 'how far vectors of neighbouring macroblocks may differ', 0.01)
    agreement_tolerance: float = setting(
        0.1, '-', 'the same, as a share of the length of the vector', 0.0)
    min_support: float = setting(
        2.0, '-', 'least support of a vector by its own and the 8 macroblocks around', 0.0, 9.0)


@dataclass(frozen=True)
class ExtractionSettings(Checked):
    """From correspondences to labelled planes and camera motion, [MVO] 4."""

    epsilon_f: float = setting(
        3.0, 'sigma', 'largest epipolar error of an inlier, (3) of [MVO]; 99.7 % of a Gaussian',
        0.5, 20.0)
    epsilon_m: float = setting(
        1.0, 'px', 'smallest parallax of a block not at infinity, (7) of [MVO]', 0.0, 20.0)
    epsilon_h: float = setting(
        3.0, 'sigma', 'largest error of a block on a plane, along its epipolar line', 0.5, 20.0)
    min_macroblocks: int = setting(20, '-', 'smallest plane, section VII-A of [SLAPSE]', 4)
    max_planes: int = setting(8, '-', 'most stationary planes of a key frame', 1, 64)
    max_uncertainty: float = setting(
        0.2, '-', 'standard deviation of a plane n / d, as a share of it, beyond which it is '
        'dropped', 0.001, 1.0)
    relief: float = setting(
        0.03, '-', 'depth of a surface about its plane, as a share of depth: a facade 10 m off '
        'has windows and hedges of 0.3 m', 0.0, 1.0)
    trials: int = setting(256, '-', 'planes sampled for each consensus', 8, 100000)
    radius: float = setting(96.0, 'px', 'blocks sampled for one plane lie this close', 16.0)
    ground_tilt: float = setting(
        0.07, 'rad', 'standard deviation of the ground normal before it is found: 4 deg of '
        'mounting', 0.001, 1.0)
    ground_wobble: float = setting(
        0.01, 'rad', 'its change from one key frame to the next: suspension and road', 1e-4, 1.0)
    standstill_share: float = setting(
        0.5, '-', 'share of blocks with a zero vector at which the camera stands', 0.1, 1.0)
    min_inliers: float = setting(
        0.2, '-', 'smallest share of blocks that agree with a camera motion; below, the motion '
        'is unknown', 0.0, 1.0)
    seed: int = setting(0, '-', 'of the sampling; the same seed gives the same planes', 0)


@dataclass(frozen=True)
class SceneSettings(Checked):
    """Filter of camera and stationary planes, [SLAPSE] VI and [MVO] 5."""

    camera_height: float = setting(
        0.0, 'm', 'height of the camera above the ground plane; 0: unknown, scale stays free',
        0.0)


@dataclass(frozen=True)
class ObstacleSettings(Checked):
    """Filters of moving obstacles, (14)-(16) of [MVO]."""

    lifetime: float = setting(0.5, 's', 'an obstacle expires this long after its last evidence',
                              0.0)


@dataclass(frozen=True)
class Settings:
    """Settings of the whole pipeline."""

    decoder: DecoderSettings = field(default_factory=DecoderSettings)
    extraction: ExtractionSettings = field(default_factory=ExtractionSettings)
    scene: SceneSettings = field(default_factory=SceneSettings)
    obstacles: ObstacleSettings = field(default_factory=ObstacleSettings)
