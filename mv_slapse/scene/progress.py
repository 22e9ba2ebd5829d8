"""Where the scene filter stands, beside its state."""

from collections import Counter
from dataclasses import dataclass, field

SHORTEST = 1e-4  # s between key frames, as the decoder has it; less shows a clock that stands
FREE = 'first translation'  # what the unit of length is where nothing makes it metric


@dataclass
class Progress:
    """Where the filter stands: time, last accepted observation, scale, highest speed.

    ``source`` of the scale: what has made it metric, or ``FREE``; ``started``: it has moved, so
    that there is a scale; ``carried``: the last pair's depths have one; ``rested``: no baseline
    since a rest; ``anew``: nor since the scene began anew, ``resets``: how often it did;
    ``repairs``: how often its covariance was put right; ``blind`` [s]: predicted since the last
    observation, which says nothing beyond ``horizon``; ``misses``: how often in a row each
    plane has contradicted the map; ``interval`` [s]: between the last two key frames.
    """

    stamp: int
    horizon: float
    interval: float = 0.0
    supported: int | None = None
    source: str = FREE
    fastest: float = 0.0
    started: bool = False
    carried: bool = False
    rested: bool = False
    anew: bool = False
    resets: int = 0
    repairs: int = 0
    blind: float = 0.0
    misses: Counter[int] = field(default_factory=Counter)

    @property
    def metric(self) -> bool:
        """Return whether lengths are metres."""
        return self.source != FREE

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
        return self.interval

    def see(self, stamp: int):
        """Note an observation that the filter has accepted."""
        self.supported, self.blind = stamp, 0.0
