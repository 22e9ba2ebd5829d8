"""What stands for a segment that is dropped because its node is too slow; free of ROS."""

from mv_slapse.records import (
    CameraMotion,
    Correspondences,
    Extraction,
    MotionStatus,
    SegmentKind,
)

OVERLOAD = 'overload'  # the reason that dropped segments carry


def dropped(record: Correspondences) -> Correspondences:
    """Return a BROKEN pair in the place of one."""
    return Correspondences(record.stamp, record.previous_stamp, record.width, record.height,
                           SegmentKind.BROKEN, record.n_b, record.reason or OVERLOAD)


def unseen(extraction: Extraction) -> Extraction:
    """Return what would be extracted of a BROKEN pair in the place of an extraction."""
    return Extraction(extraction.stamp, extraction.previous_stamp, extraction.width,
                      extraction.height, SegmentKind.BROKEN, extraction.K,
                      CameraMotion(MotionStatus.UNKNOWN), reason=extraction.reason or OVERLOAD)
