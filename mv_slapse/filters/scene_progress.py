"""Where the scene filter stands, beside its state."""

from dataclasses import dataclass


@dataclass
class Progress:
    """Where the filter stands: time, last accepted observation, scale, highest speed.

    ``started``: it has moved, so that there is a scale; ``carried``: the last pair's depths have
    one; ``rested``: no baseline since a rest; ``anew``: nor since the heading
    was lost.
    """

    stamp: int
    supported: int | None = None
    metric: bool = False
    fastest: float = 0.0
    ground_misses: int = 0
    started: bool = False
    carried: bool = False
    rested: bool = False
    anew: bool = False
