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


@dataclass(frozen=True)
class ExtractionSettings(Checked):
    """From correspondences to labelled planes and camera motion, [MVO] 4."""

    min_macroblocks: int = setting(
        20, '-', 'smallest support of a plane, [SLAPSE] VII-A', 4)


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
