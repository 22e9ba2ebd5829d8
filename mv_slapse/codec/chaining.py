"""Pairs of key frames that are too close together, joined into longer ones.

At 30 frames a second two P frames see too little parallax to tell depth. A block of key frame k
lies somewhere in k-1; what moved that place from k-1 to the frame before moves the block on, and
so on to the anchor, the last key frame that was published.
"""

from collections import deque
from operator import attrgetter

from mv_slapse.changed import replace
from mv_slapse.config import DecoderSettings
from mv_slapse.geometry.camera import Camera, undistort
from mv_slapse.kernels.binding import compiled
from mv_slapse.records import Correspondences, SegmentKind

SAMPLE = 400  # correspondences that are enough to measure the parallax
FEWEST = 8  # correspondences that tell a parallax: three unknowns of a rotation, robustly
_columns = attrgetter('x_cur', 'x_prev', 'sigma', 'probability', 'block')  # of a pair


class Chainer:
    """Holds pairs back until their parallax is large enough or their time is up."""

    def __init__(self, settings: DecoderSettings, camera: Camera | None = None):
        """Start without an anchor; without a camera the parallax is measured in the picture."""
        self._settings = settings
        self._camera = camera
        self._chain: Correspondences | None = None
        self._links = 0
        # Halves of a segment are asked about before they come in: the pairs asked about last.
        self._asked: deque[tuple[Correspondences, bool]] = deque(maxlen=2)

    def add(self, pair: Correspondences) -> list[Correspondences]:
        """Return what can be published after this pair: contiguous pairs in order of time."""
        if pair.kind is SegmentKind.BROKEN:
            return [*self.flush(), pair]
        if self._chain is None:
            self._chain, self._links = pair, 1
        else:
            self._chain = chain(pair, self._chain, self._settings)
            self._links += 1
        step = pair.stamp - pair.previous_stamp
        age_after_next = (self._chain.stamp - self._chain.previous_stamp + step) / 1e9
        is_due = (age_after_next > self._settings.max_chain_time
                  or self._links >= self._settings.max_chain or self.is_long(self._chain))
        return self.flush() if is_due else []

    def flush(self) -> list[Correspondences]:
        """Return the pair held back, whatever its parallax."""
        held, self._chain = self._chain, None
        return [] if held is None else [held]

    def is_long(self, pair: Correspondences) -> bool:
        """Tell whether a pair has moved so far that it need not, or must not, be chained."""
        for asked, answer in self._asked:
            if asked.x_cur is pair.x_cur:
                return answer
        settings = self._settings
        is_long = median_flow(pair) >= settings.max_chain_flow or (
            pair.stamp - pair.previous_stamp >= settings.min_chain_time * 1e9
            and parallax(pair, self._camera) >= settings.min_parallax)
        self._asked.append((pair, is_long))
        return is_long


def chain(newer: Correspondences, older: Correspondences,
          settings: DecoderSettings) -> Correspondences:
    """Return the pair from the newer's key frame to the older's previous one.

    Each match of the newer pair is moved on by the mean motion of the (up to four) macroblocks of
    the older pair that surround it; a match whose surroundings disagree, or that has none, is
    dropped. A lone one is moved on by lone ones too, if it goes on as before. Variances add up.
    """
    *columns, block = compiled.chain(
        _columns(newer), _columns(older), newer.width, newer.height, settings.agreement_slack,
        settings.agreement_tolerance)
    return replace(newer, previous_stamp=older.previous_stamp, kind=SegmentKind.CHAINED,
                   n_b=newer.n_b + older.n_b, block=block,
                   **dict(zip(('x_cur', 'x_prev', 'sigma', 'probability'), columns, strict=True)))


def median_flow(pair: Correspondences) -> float:
    """Return the median length [px] of the supported vectors of a pair; 0 where there is none."""
    return compiled.median_flow(pair.x_cur, pair.x_prev, pair.probability)


def parallax(pair: Correspondences, camera: Camera | None) -> float:
    """Return the length [px] of what a rotation of the camera leaves of the motion.

    Three tenths of the blocks show more. The rotation is fitted to the motion itself, robustly,
    so part of a translation may pass for one: never too much parallax is told. Lone vectors are
    left out. Without a camera, shift and turn of the picture stand for the rotation.
    """
    rows, = (~pair.lone).nonzero()
    if len(rows) < FEWEST:
        return 0.0
    rows = rows[::max(len(rows) // SAMPLE, 1)]
    x_cur, x_prev = pair.x_cur[rows].astype(float), pair.x_prev[rows].astype(float)
    if camera is None:
        return compiled.parallax(x_cur, x_prev, None)
    return compiled.parallax(undistort(camera, x_cur), undistort(camera, x_prev), camera.K)
