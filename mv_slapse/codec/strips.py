"""Macroblocks on the way ahead, cut into strips whose vectors the two pictures tell.

What drives ahead covers a dozen macroblocks when it is two seconds away, and those at its edges,
its foot above all, hold two motions. There alone pixels are looked at. Where strips were half a
second ago is looked for, too: what is still and what drives ahead differ by a few rows then.
"""

from collections import deque
from typing import NamedTuple

from mv_slapse.changed import replace
from mv_slapse.config import DecoderSettings
from mv_slapse.geometry.camera import Camera
from mv_slapse.kernels.binding import compiled
from mv_slapse.records import Correspondences
from mv_slapse.strip_matches import NONE, SPAN, StripMatches
import numpy as np

REACH = 0.13  # of the focal length, beside and below the expansion point: 2.6 m in 20 m,
FARTHEST = 72.0  # px, and at most so far
LONGEST = 1100.0  # px, focal length from which on a car in 20 m has six macroblocks side by side
NEWEST = 0.2  # share of the newest pair in the expansion point, which a camera that nods moves
KEPT = 16  # pictures that a pair may still need
BESIDE = 48.0  # px about that region, from where strips come
COLUMNS = 'x_cur', 'x_prev', 'sigma', 'probability', 'block'


class _Link(NamedTuple):
    """A pair's stamps [ns], its earlier picture, and vectors near the expansion point."""

    stamp: int
    previous_stamp: int
    before: np.ndarray
    vectors: tuple[np.ndarray, np.ndarray]  # x_cur, x_prev (N, 2)


class StripCutter:
    """Holds the pictures that a pair to come may need, and the point that the camera goes to.

    Without a camera, or with a long lens, ``reach`` [px] is zero and nothing is cut.
    """

    def __init__(self, settings: DecoderSettings, camera: Camera | None):
        """Know no picture yet."""
        focal = camera.K[0, 0] if camera else np.inf
        self.reach = min(REACH * focal, FARTHEST) if focal <= LONGEST else 0.0
        self._sigma = settings.vector_sigma
        self._pictures: deque[tuple[int, np.ndarray]] = deque(maxlen=KEPT if self.reach else 0)
        self._point: np.ndarray | None = None
        self._links: list[_Link] = []  # the newest first

    def keep(self, stamp: int, luma: np.ndarray):
        """Keep a picture (H, W) uint8 by its stamp [ns]."""
        self._pictures.append((stamp, luma))

    def cut(self, pair: Correspondences) -> Correspondences:
        """Return a pair with strips in place of macroblocks, where both its pictures are kept.

        Its ``strips`` are matched as far back as pairs follow each other, up to SPAN.
        """
        kept = dict(self._pictures)
        while self._pictures and self._pictures[0][0] < pair.stamp:
            self._pictures.popleft()
        now, before = kept.get(pair.stamp), kept.get(pair.previous_stamp)
        if now is None or before is None or now.shape != before.shape:
            return pair
        point = compiled.expansion(pair.x_cur, pair.x_prev, pair.probability, *now.shape[::-1])
        if point is not None:
            old = point if self._point is None else self._point
            self._point = old + NEWEST * (point - old)
        if self._point is None:
            return pair
        columns = compiled.strips(now, before, tuple(getattr(pair, name) for name in COLUMNS),
                                  self._point, self.reach, self._sigma)
        pair = replace(pair, **dict(zip(COLUMNS, columns, strict=True)))
        return replace(pair, strips=self._matched(pair, now, before))

    def _matched(self, pair: Correspondences, now: np.ndarray,
                 before: np.ndarray) -> StripMatches:
        """Return the strips of a pair's picture ``now`` that an earlier one shows."""
        near = ~pair.lone & (np.abs(pair.x_cur - self._point) < self.reach + BESIDE).all(1)
        if not near.any():
            self._links = []
            return NONE
        links = [_Link(pair.stamp, pair.previous_stamp, before,
                       (pair.x_cur[near], pair.x_prev[near]))]
        for link in self._links:
            if (link.stamp != links[-1].previous_stamp or link.before.shape != now.shape
                    or pair.stamp - link.previous_stamp > SPAN):
                break
            links.append(link)
        self._links = links
        return StripMatches(links[-1].previous_stamp, *compiled.earlier(
            now, links[-1].before, tuple(link.vectors for link in links), self._point, self.reach))
