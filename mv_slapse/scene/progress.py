"""Where the scene filter stands, beside its state."""

from collections import Counter
from dataclasses import dataclass, field

from mv_slapse.records import TrackingStatus, WITH_POSE
from mv_slapse.scene.scale.rest import Stop
import numpy as np

SHORTEST = 1e-4  # s between key frames, as the decoder has it; less shows a clock that stands
ASTRAY = 5.0  # times lost_after: a car at rest may meanwhile be anywhere on the next crossing
PATIENCE = 5  # key frames in which a plane, or depths, may contradict the map
FREE = 'first translation'  # what the unit of length is where nothing makes it metric


@dataclass
class Progress:
    """Where the filter stands: time, last accepted observation, scale, highest speed.

    ``source`` of the scale: what has made it metric, or ``FREE``; ``started``: it has moved, so
    that there is a scale; ``carried``: the last pair's depths have one; ``rested``: no baseline
    since a rest; ``anew``: nor since the scene began anew, ``resets``: how often it did;
    ``repairs``: how often its covariance was put right; ``blind`` [s]: predicted since the last
    observation; ``misses``: how often in a row each plane has contradicted the map, ``refused``
    the depths; ``interval`` [s]: between the last two key frames; ``age`` [s]: since the camera
    first moved, ``told`` [s]: what that was when a ground told metres last; ``going`` [s]: since
    the camera started to move; ``place``: position (3,) that was published last; ``unit``: what
    was one unit of length at the beginning [map unit]; ``stop``: the last one, which may be
    doubted.
    """

    stamp: int
    lost_after: float
    interval: float = 0.0
    age: float = 0.0
    told: float = 0.0
    going: float = 0.0
    place: np.ndarray = field(default_factory=lambda: np.zeros(3))
    supported: int | None = None
    source: str = FREE
    unit: float = 1.0
    fastest: float = 0.0
    started: bool = False
    carried: bool = False
    rested: bool = False
    stop: Stop | None = None
    anew: bool = False
    resets: int = 0
    repairs: int = 0
    blind: float = 0.0
    misses: Counter[int] = field(default_factory=Counter)
    refused: int = 0

    @property
    def metric(self) -> bool:
        """Return whether lengths are metres."""
        return self.source != FREE

    @property
    def horizon(self) -> float:
        """Return for how long without a view [s] a prediction says something."""
        return ASTRAY * self.lost_after

    @property
    def waits_for_metres(self) -> bool:
        """Return whether lengths should soon become metres, which they are not yet.

        Not soon where no ground is seen, or where grounds keep contradicting each other.
        """
        return (self.started and not self.metric and self.age < self.horizon
                and self.age - self.told < self.lost_after)

    def free_acceleration(self, speed: float, share: float) -> float:
        """Return the random walk of a velocity [unit/s^1.5] whose unit nobody knows.

        A share of the greatest speed so far; and as much as has brought the camera to its speed
        since it started, when it has not been fast yet.
        """
        return max(share * self.fastest, speed / np.sqrt(max(self.going, SHORTEST)))

    def gives_depths_up(self, compared: bool, told: bool) -> bool:
        """Note whether a pair's depths were compared with those before, and told a length.

        Returns whether they have no scale any more: one pair may be wrong, the map outlasts it.
        """
        self.refused = self.refused + 1 if compared and not told else 0
        return not told and not 0 < self.refused <= PATIENCE

    def publish(self, status: TrackingStatus, place: np.ndarray):
        """Note where the camera is said to be."""
        if status in WITH_POSE:
            self.place = place.copy()

    @property
    def is_astray(self) -> bool:
        """Return whether nobody knows any more where the camera is."""
        return self.blind > self.horizon

    def elapse(self, stamp: int) -> float:
        """Return the time [s] since the last key frame; as usual where the clock stands."""
        dt = (stamp - self.stamp) * 1e-9
        if dt > SHORTEST:
            self.interval = dt
        elif self.supported is not None:
            self.supported = min(self.supported, stamp)
        self.stamp = stamp
        self.age += self.interval * self.started
        self.going += self.interval
        return self.interval

    def unsupported(self, stamp: int, reason: str) -> tuple[TrackingStatus, str]:
        """Judge a pose that is predicted only."""
        age = (stamp - self.supported) * 1e-9
        if age > self.lost_after:
            return TrackingStatus.LOST, f'{reason}; nothing observed for {age:.1f} s'
        return TrackingStatus.PREDICTED, reason

    def see(self, stamp: int):
        """Note an observation that the filter has accepted."""
        self.supported, self.blind = stamp, 0.0
