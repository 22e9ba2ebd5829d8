"""Where strips on the way ahead were a while ago: a column of a pair of key frames."""

from dataclasses import dataclass, field

import numpy as np

SIZE = 16, 4  # px, of a strip
SPAN = 500_000_000  # [ns] over which strips are matched: what is seen grows by a third meanwhile


@dataclass(frozen=True)
class StripMatches:
    """Strips of key frame k, matched by their pixels in an earlier key frame.

    Over several pairs a depth shows several times as much parallax, and a match errs as before.

    Attributes
    ----------
    stamp : int
        Time of the earlier key frame, the previous one or one before it [ns].
    x_cur, x_earlier : (M, 2) float32
        Centres in key frame k and in the earlier one [px], with the lens' distortion still in.
    sigma : (M,) float32
        Standard deviation of ``x_earlier`` along the way out of the expansion point [px].
    """

    stamp: int = 0
    x_cur: np.ndarray = field(default_factory=lambda: np.zeros((0, 2), np.float32))
    x_earlier: np.ndarray = field(default_factory=lambda: np.zeros((0, 2), np.float32))
    sigma: np.ndarray = field(default_factory=lambda: np.zeros(0, np.float32))

    def __len__(self) -> int:
        """Return the number of strips."""
        return len(self.sigma)


NONE = StripMatches()
