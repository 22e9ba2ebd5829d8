"""Pictures in order of presentation to segments between key frames, [SLAPSE] V-A and figure 4."""

from dataclasses import dataclass

from mv_slapse.codec.motion_vectors import FrameVectors
from mv_slapse.codec.places import LATE
from mv_slapse.records import FrameType, SegmentKind

SHORTEST = 100_000  # ns between pictures; no camera takes 10,000 a second
NOT_STAMPED = ('time stamps do not increase; what publishes or records the pictures must stamp '
               'each with its own time')
BLANK = 'the picture shows nothing, all of it is alike: a covered lens, darkness or fog'
MOST_BETWEEN = 64  # B frames that are kept: no encoder has more in a row
LONGEST = 1_000_000_000  # ns between key frames; no encoder searches so far


@dataclass(frozen=True)
class Segment:
    """Two consecutive key frames (I or P) and the B frames between them."""

    previous: FrameVectors  # key frame k-1
    current: FrameVectors  # key frame k
    between: tuple[FrameVectors, ...]  # the B frames, in order of presentation
    kind: SegmentKind  # IP, PP, PI, or BROKEN where nothing joins the two
    reason: str = ''  # why it is BROKEN, else empty
    # by damage or a loss, its own or one that its pictures still show: no search can join it then
    is_torn: bool = False

    @property
    def has_pictures(self) -> bool:
        """Whether the pictures of both key frames are there, and of one size."""
        now, before = self.current.luma, self.previous.luma
        return now is not None and before is not None and now.shape == before.shape


class SegmentBuilder:
    """Collects pictures until a segment is complete."""

    def __init__(self):
        """Start before the first key frame."""
        self._previous: FrameVectors | None = None
        self._between: list[FrameVectors] = []
        self._damage = ''
        self._is_displaced = False  # what a lost picture would have moved, up to a whole I frame

    def add(self, frame: FrameVectors) -> Segment | None:
        """Return the segment that ends with this picture, None where it ends none."""
        # The next P frame's vectors skip one that is no reference, as temporal layers have.
        joins = frame.frame_type is FrameType.I or (
            frame.frame_type is FrameType.P and frame.is_reference)
        if self._previous is None:
            self._previous = frame if joins else None
            return None
        last = self._between[-1] if self._between else self._previous
        if frame.stamp - last.stamp < SHORTEST:
            self._damage = NOT_STAMPED
        self._damage = self._damage or frame.damage
        if frame.frame_type is FrameType.B:
            if len(self._between) < MOST_BETWEEN:  # else the stream is none that could be joined
                self._between.append(frame)
            return None
        return self._close(frame) if joins else None

    def _close(self, frame: FrameVectors) -> Segment:
        previous, between = self._previous, tuple(self._between)
        reason = self._damage or _why_broken(previous, between, frame)
        kind = SegmentKind.BROKEN if reason else kind_of(previous, frame)
        self._is_displaced |= self._damage not in ('', LATE)
        segment = Segment(previous, frame, between, kind, reason,
                          bool(self._damage) or self._is_displaced)
        self._is_displaced &= frame.frame_type is not FrameType.I or bool(frame.damage)
        self._previous, self._between, self._damage = frame, [], ''
        return segment


def kind_of(previous: FrameVectors, current: FrameVectors) -> SegmentKind:
    """Return the kind of the segment between two key frames that vectors join."""
    if current.frame_type is FrameType.I:
        return SegmentKind.PI
    return SegmentKind.IP if previous.frame_type is FrameType.I else SegmentKind.PP


def _why_broken(previous: FrameVectors, between: tuple[FrameVectors, ...],
                current: FrameVectors) -> str:
    if (previous.width, previous.height) != (current.width, current.height):
        return (f'the picture size changed from {previous.width}x{previous.height} to '
                f'{current.width}x{current.height}')
    if current.stamp - previous.stamp > LONGEST:
        return 'the key frames lie too far apart for vectors: pictures between them were lost'
    if current.frame_type is FrameType.I and not any(len(frame) for frame in between):
        return 'an I frame without B frames before it: no vector joins it to the past'
    return BLANK if previous.is_blank or current.is_blank else ''
