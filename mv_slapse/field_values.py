"""Values inside messages: stamps, columns, points; the parts of ``mv_slapse.fields``."""

from typing import Any

from mv_slapse import message_checks as check
from mv_slapse.quaternion import from_matrix
from mv_slapse.records import Correspondences, Extraction, Label, SegmentKind
from mv_slapse.strip_matches import StripMatches
import numpy as np

Fields = dict[str, Any]
POINTS = ('x_cur', 'y_cur', 'x_prev', 'y_prev', 'sigma', 'block_width', 'block_height')
STRIPS = ('strip_x_cur', 'strip_y_cur', 'strip_x_earlier', 'strip_y_earlier', 'strip_sigma')
SIGMAS = 1e-4, 1e4  # [px] of a vector


def stamp_to_fields(stamp: int) -> Fields:
    """Return builtin_interfaces/Time of a stamp [ns]."""
    sec, nanosec = divmod(int(stamp), 1_000_000_000)
    return {'sec': sec, 'nanosec': nanosec}


def stamp_from_message(time: Any) -> int:
    """Return the stamp [ns] of a builtin_interfaces/Time."""
    return check.stamp(time)


def header(stamp: int, frame_id: str) -> Fields:
    """Return a std_msgs/Header."""
    return {'stamp': stamp_to_fields(stamp), 'frame_id': frame_id}


def published(msg: Any) -> tuple[tuple[int, int], np.ndarray]:
    """Return size [px] and intrinsics (3, 3) of a sensor_msgs/CameraInfo's pictures as published.

    Binning and region of interest of a driver move and scale the pixels: full-resolution pixel u
    is seen at (u - offset + 0.5) / binning - 0.5, pixels being centred at integers.
    """
    roi, K = msg.roi, check.numbers(msg.k, 'k', (3, 3))
    binning = np.maximum([msg.binning_x, msg.binning_y], 1).astype(np.int64)
    if np.any(binning > 1) or roi.x_offset or roi.y_offset:
        K[:2, 2] = (K[:2, 2] - (roi.x_offset, roi.y_offset) + 0.5) / binning - 0.5
        K[:2, :2] /= binning[:, None]
    width, height = (roi.width or msg.width, roi.height or msg.height) // binning
    return (int(width), int(height)), K


def point_columns(record: Correspondences | Extraction) -> Fields:
    """Return the columns of blocks that both messages of a pair have."""
    columns = {'x_cur': record.x_cur[:, 0], 'y_cur': record.x_cur[:, 1],
               'x_prev': record.x_prev[:, 0], 'y_prev': record.x_prev[:, 1],
               'sigma': record.sigma}
    return {**{name: column(values, np.float32) for name, values in columns.items()},
            'block_width': column(record.block[:, 0], np.uint8),
            'block_height': column(record.block[:, 1], np.uint8)}


def pair_of(msg: Any) -> Fields:
    """Return what both messages of a pair begin with."""
    width, height = check.size(msg.width, msg.height)
    kind = check.member(SegmentKind, msg.kind, 'kind')
    stamp, previous = check.interval(msg.previous_stamp, msg.header.stamp, kind)
    return {'stamp': stamp, 'previous_stamp': previous, 'width': width, 'height': height,
            'kind': kind, 'reason': msg.reason}


def points_of(msg: Any) -> Fields:
    """Return the columns that the message says to have one length."""
    columns = _places(msg, POINTS[:4])
    block = [column(getattr(msg, name), np.uint8) for name in POINTS[5:]]
    return {'x_cur': columns[0], 'x_prev': columns[1], 'sigma': _sigma(msg, POINTS[4]),
            'block': np.stack(block, axis=1)}


def strip_columns(strips: StripMatches) -> Fields:
    """Return what a message of a pair tells of strips."""
    columns = (*strips.x_cur.T, *strips.x_earlier.T, strips.sigma)
    return {'strip_stamp': stamp_to_fields(strips.stamp),
            **{name: column(values, np.float32)
               for name, values in zip(STRIPS, columns, strict=True)}}


def strips_of(msg: Any) -> StripMatches:
    """Return the same of a message."""
    check.same_length(msg, STRIPS, check.most_blocks(msg.width, msg.height))
    return StripMatches(check.stamp(msg.strip_stamp, 'strip_stamp'), *_places(msg, STRIPS[:4]),
                        _sigma(msg, STRIPS[4]))


def _places(msg: Any, names: tuple[str, ...]) -> list[np.ndarray]:
    """Return pixels (N, 2), each of two fields."""
    x, y = max(msg.width, 1) + check.FAR_OUT, max(msg.height, 1) + check.FAR_OUT
    columns = [check.within(column(getattr(msg, name), np.float32), name, -check.FAR_OUT, most)
               for name, most in zip(names, (x, y) * (len(names) // 2), strict=True)]
    return [np.stack(pair, axis=1) for pair in zip(columns[::2], columns[1::2], strict=True)]


def _sigma(msg: Any, name: str) -> np.ndarray:
    return check.within(column(getattr(msg, name), np.float32), name, *SIGMAS)


def labels(msg: Any, name: str) -> np.ndarray:
    """Return a column of labels as int8."""
    return check.within(column(getattr(msg, name), np.int8), name, min(Label), max(Label))


def column(values: Any, dtype: type) -> np.ndarray:
    """Return a contiguous array."""
    return np.ascontiguousarray(values, dtype)


def flat(values: Any) -> np.ndarray:
    """Return numbers as a float64 array of one dimension."""
    return np.array(values, float).ravel()


def named_xyz(v: np.ndarray) -> Fields:
    """Return geometry_msgs/Point or Vector3 of three numbers."""
    return {'x': float(v[0]), 'y': float(v[1]), 'z': float(v[2])}


def read_xyz(msg: Any, field: str, bound: float = check.FARTHEST) -> np.ndarray:
    """Return the three numbers (3,) of a geometry_msgs/Point or Vector3."""
    return check.numbers([msg.x, msg.y, msg.z], field, (3,), bound)


def points(X: np.ndarray) -> list[Fields]:
    """Return a geometry_msgs/Point for each row of (N, 3)."""
    return [named_xyz(point) for point in np.reshape(X, (-1, 3))]


def read_points(messages: Any) -> np.ndarray:
    """Return the corners (N, 3) of an outline of geometry_msgs/Point."""
    rows = [[p.x, p.y, p.z] for p in check.count(messages, 'outline')]
    return check.numbers(rows, 'outline', (len(rows), 3), check.FARTHEST)


def map_plane_values(msg: Any) -> tuple:
    """Return normal, depth, covariance, outline and both stamps of a mv_slapse_msgs/MapPlane."""
    return (read_xyz(msg.normal, 'planes[].normal', 2.0),
            check.number(msg.depth, 'planes[].depth', -check.FARTHEST, check.FARTHEST),
            check.covariance(msg.covariance, 'planes[].covariance', 4), read_points(msg.outline),
            stamp_from_message(msg.first_seen), stamp_from_message(msg.last_seen))


def quaternion(R: np.ndarray) -> Fields:
    """Return geometry_msgs/Quaternion of a rotation matrix."""
    x, y, z, w = from_matrix(R)
    return {'x': float(x), 'y': float(y), 'z': float(z), 'w': float(w)}
