"""Packets in, correspondences out: the decoder as one object with one verb."""

from collections.abc import Callable
from math import isfinite

from mv_slapse.changed import replace
from mv_slapse.codec.bridging import can_bridge, is_untrue, search
from mv_slapse.codec.chaining import Chainer, median_flow
from mv_slapse.codec.evidence import collect, Evidence, halves
from mv_slapse.codec.frames import FrameDecoder
from mv_slapse.codec.merging import average, match_probability, merge, refined, seen
from mv_slapse.codec.motion_vectors import FrameVectors
from mv_slapse.codec.packet import Packet
from mv_slapse.codec.prior import MotionPrior
from mv_slapse.codec.segments import Segment, SegmentBuilder
from mv_slapse.codec.strips import StripCutter
from mv_slapse.config import DecoderSettings
from mv_slapse.geometry.camera import Camera
from mv_slapse.records import Correspondences, FrameType, SegmentKind
import numpy as np

LEARNING = 0.1  # share of the newest segment in p: what ten segments tell is not of one picture
POOR = 0.5  # share of the usual matches at which an I frame's B frames have told too little
UNTRUE = 'all motion vectors are zero, but the pictures change: the encoder did not search'
SPLIT_FOCAL = 500.0  # px, focal length that split_flow is meant for; a longer one needs more
RIGHT = 0.05, 0.99  # bounds of p, where Lemma 2 still has a value


class CorrespondenceDecoder:
    """Turns coded video into merged motion vectors between key frames."""

    def __init__(self, settings: DecoderSettings, camera: Camera | None = None,
                 on_picture: Callable[[int, np.ndarray], None] = lambda *_: None):
        """Hold the settings; the first packet opens the codec.

        ``on_picture`` is given stamp [ns] and luma (H, W) uint8 of each I and P picture, unless
        ``bridge_intra`` leaves the pictures out.
        """
        self._settings, self._on_picture = settings, on_picture
        longer = max(camera.K[0, 0] / SPLIT_FOCAL, 1) if camera else 1
        self._long = settings.split_flow * longer
        self._chainer = Chainer(settings, camera)
        self._strips = StripCutter(settings, camera)
        self._frames = FrameDecoder(settings.bridge_intra, self._strips.reach > 0)
        self._segments = SegmentBuilder()
        self._expect = MotionPrior()
        self._usual = 0
        self._right = settings.match_probability

    def feed(self, packet: Packet) -> list[Correspondences]:
        """Return the correspondences that this packet completes, often none, in order of time.

        A damaged or lost packet is no error: the pair that it tears is returned BROKEN.
        """
        return self._join(self._frames.feed(packet))

    def flush(self) -> list[Correspondences]:
        """Return what is still held back at the end of the stream."""
        return self._join(self._frames.flush()) + [
            self._strips.cut(pair) for pair in self._chainer.flush()]

    def _join(self, frames: list[FrameVectors]) -> list[Correspondences]:
        for frame in frames:
            if frame.luma is not None:
                self._strips.keep(frame.stamp, frame.luma)
                if frame.frame_type is not FrameType.B:
                    self._on_picture(frame.stamp, frame.luma)
        segments = [self._segments.add(frame) for frame in frames]
        return [self._strips.cut(ready) for segment in segments if segment
                for pair in self._pairs(segment) for ready in self._chainer.add(pair)]

    def _pairs(self, segment: Segment) -> list[Correspondences]:
        """Merge a segment and learn from it what to expect of the next."""
        if segment.kind is SegmentKind.BROKEN:
            pairs = [self._bridged(segment) or self._broken(segment)]
        else:
            pairs = self._merged(segment)
        if segment.kind is SegmentKind.PI and _supported(pairs[0]) < POOR * self._usual:
            bridged = self._bridged(segment)
            pairs = pairs if bridged is None else [bridged]
        elif segment.kind is not SegmentKind.BROKEN and is_untrue(segment):
            pairs = [self._searched(segment) or self._broken(replace(
                segment, kind=SegmentKind.BROKEN, reason=UNTRUE))]
        for pair in pairs:
            self._expect.add(pair)
        self._usual = _supported(pairs[-1]) or self._usual
        return [seen(pair, segment) for pair in pairs]

    def _merged(self, segment: Segment) -> list[Correspondences]:
        """Merge a segment, in two parts where its motion is too long for direct vectors.

        Also where it takes longer than any chain: an encoder that has not found the motion over
        .4 s has short vectors that agree, of other matter, and does not look as if it moved far.
        """
        evidence, settings = collect(segment, self._settings), self._settings
        whole = self._merge(segment, evidence)
        if isfinite(p := match_probability(evidence, whole, settings)):
            right = self._right + LEARNING * (p - self._right)
            self._right = min(max(right, RIGHT[0]), RIGHT[1])
        late = segment.current.stamp - segment.previous.stamp > settings.max_chain_time * 1e9
        short = not late and len(whole) and median_flow(whole) < self._long
        if short or not segment.between:
            return [whole]
        parts = []
        for half in reversed(halves(segment, settings)):  # of the later one fewer agree, as a rule
            part = self._merge(half, collect(half, settings))
            # Fewer matches over half the distance: the B frame's vectors mean other pictures.
            good = _supported(part) >= settings.split_share * len(whole)
            # Halves that would be chained again lose matches where they are joined.
            if not (len(part) if late else good and self._chainer.is_long(part)):
                return [whole]
            parts.insert(0, part)
        return parts

    def _merge(self, segment: Segment, evidence: Evidence) -> Correspondences:
        pair = merge(segment, evidence, self._settings, self._expect, self._right)
        return refined(pair, segment, self._settings)

    def _bridged(self, segment: Segment) -> Correspondences | None:
        """Search an I frame's macroblocks in the key frame before it; None where that fails."""
        return self._searched(segment) if can_bridge(segment) and not segment.is_torn else None

    def _searched(self, segment: Segment) -> Correspondences | None:
        """Search macroblocks in the key frame before; None where too few are found."""
        found = search(segment, self._expect, self._settings)
        pair = average(replace(segment, kind=SegmentKind.PP), found, self._settings, p=self._right)
        return pair if _supported(pair) >= self._settings.bridge_minimum else None

    def _broken(self, segment: Segment) -> Correspondences:
        """Return a pair that tells nothing but why; what comes after it is another matter."""
        self._expect.reset()
        frame = segment.current
        return Correspondences(frame.stamp, segment.previous.stamp, frame.width, frame.height,
                               segment.kind, len(segment.between), segment.reason)


def _supported(pair: Correspondences) -> int:
    return np.count_nonzero(~pair.lone)
