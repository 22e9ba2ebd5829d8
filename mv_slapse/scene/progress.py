"""Where the scene filter stands, beside its state."""

from collections import Counter
from dataclasses import dataclass, field

FREE = 'first translation'  # what the unit of length is where nothing makes it metric


@dataclass
class Progress:
    """Where the filter stands: time, last accepted observation, scale, highest speed.

    ``source`` of the scale: what has made it metric, or ``FREE``;
    ``started``: it has moved, so that there is a scale; ``carried``: the last pair's depths have
    one; ``rested``: no baseline since a rest; ``anew``: nor since the heading
    was lost; ``misses``: how often in a row each plane has contradicted the map; ``interval`` [s]:
    between the last two key frames.
    """

    stamp: int
    interval: float = 0.0
    supported: int | None = None
    source: str = FREE
    fastest: float = 0.0
    started: bool = False
    carried: bool = False
    rested: bool = False
    anew: bool = False
    misses: Counter[int] = field(default_factory=Counter)

    @property
    def metric(self) -> bool:
        """Return whether lengths are metres."""
        return self.source != FREE
