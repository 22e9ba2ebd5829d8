"""Shapes, ranges and finiteness of what messages say, checked once where a record is made of them.

Whoever can publish can write anything into a message: each check names the field and its value.
"""

from collections.abc import Iterable
from enum import IntEnum
import math
from typing import Any

from mv_slapse.errors import UnusableInput
from mv_slapse.geometry.camera import Camera
from mv_slapse.records import SegmentKind
import numpy as np

MAX_PIXELS = 64_000_000  # of a picture, as the decoder has it
MAX_SIDE = 32_768  # [px]
SMALLEST_BLOCK = 16  # [px] area of a block of motion, 4x4
MAX_B_FRAMES = 1000  # between two key frames
MAX_ITEMS = 10_000  # planes or obstacles of a message, corners of an outline
MAX_STAMP = (2**31 - 1) * 10**9  # [ns] the seconds of messages have 32 bits: the year 2038
MIN_INTERVAL, MAX_INTERVAL = 10**5, 3600 * 10**9  # [ns] between the key frames of a pair
FARTHEST = 1e9  # [m or map unit, per second] of places, speeds and lengths
FAR_OUT = 1e6  # [px] from the picture, of where a vector may point
UNIT = 1e-3  # by which a rotation may be none
FOCAL = np.array([0.05, 1000.0])  # bounds of a focal length, in sides of the picture
MOST_SHOWN = 60  # characters of a value in a message


class InvalidMessage(UnusableInput):  # noqa: N818 (the message is at fault, no error is)
    """A message that its type allows and its meaning does not."""


def refuse(field: str, value: Any, wanted: str):
    """Raise InvalidMessage that names a field and its value."""
    shown = repr(value)
    shown = shown if len(shown) <= MOST_SHOWN else shown[:MOST_SHOWN] + '…'
    raise InvalidMessage(f'{field} = {shown}: {wanted}; '
                         'the message is dropped, correct its publisher')


def member(kind: type[IntEnum], value: Any, field: str) -> Any:
    """Return the member of an enumeration."""
    try:
        return kind(value)
    except ValueError:
        names = ', '.join(f'{item.value} ({item.name})' for item in kind)
        return refuse(field, value, f'must be one of {names}')


def stamp(time: Any, field: str = 'stamp') -> int:
    """Return the stamp [ns] of a builtin_interfaces/Time."""
    ns = int(time.sec) * 1_000_000_000 + int(time.nanosec)
    if time.sec < 0 or not 0 <= time.nanosec < 1_000_000_000 or ns > MAX_STAMP:
        refuse(field, f'{time.sec} s {time.nanosec} ns', 'must be a time since 1970 and not after '
               '2038, with less than 10^9 ns')
    return ns


def interval(previous: Any, now: Any, kind: SegmentKind) -> tuple[int, int]:
    """Return the stamps [ns] of a pair's two key frames, the newer first.

    Only what broke may have jumped in time.
    """
    newer, older = stamp(now, 'header.stamp'), stamp(previous, 'previous_stamp')
    if kind is not SegmentKind.BROKEN and not MIN_INTERVAL <= newer - older <= MAX_INTERVAL:
        refuse('previous_stamp', older, f'must be before header.stamp = {newer}, by 0.1 ms to an '
               'hour')
    return newer, older


def size(width: int, height: int) -> tuple[int, int]:
    """Return the size of a picture [px]."""
    for field, value in (('width', width), ('height', height)):
        if not 0 < value <= MAX_SIDE:
            refuse(field, value, f'must be 1 to {MAX_SIDE} px')
    if width * height > MAX_PIXELS:
        refuse('width, height', (width, height), f'must be {MAX_PIXELS} pixels together at most')
    return int(width), int(height)


def number(value: Any, field: str, low: float = -np.inf, high: float = np.inf) -> float:
    """Return a number within bounds; NaN is within none."""
    if not low <= value <= high:
        refuse(field, value, f'must be {low:g} to {high:g}')
    return float(value)


def count(items: Any, field: str, most: int = MAX_ITEMS) -> Any:
    """Return a sequence that is not longer than ``most``."""
    if len(items) > most:
        refuse(f'length of {field}', len(items), f'must be {most} at most')
    return items


def numbers(values: Any, field: str, shape: tuple[int, ...],
            bound: float = np.finfo(float).max) -> np.ndarray:
    """Return finite numbers of a shape, none beyond a bound."""
    found, n = np.array(values, float).ravel(), math.prod(shape)
    if found.size != n:
        refuse(f'length of {field}', found.size, f'must be {n}')
    good = np.abs(found) <= bound
    if not good.all():
        at = int(np.argmin(good))
        refuse(f'{field}[{at}]', found[at].item(), f'must be finite and within ±{bound:.3g}')
    return found.reshape(shape)


def covariance(values: Any, field: str, n: int) -> np.ndarray:
    """Return a covariance (n, n): finite, no variance below zero."""
    found = numbers(values, field, (n, n), 1e300)
    if (found.diagonal() < 0).any():
        least = float(found.diagonal().min())
        refuse(f'diagonal of {field}', least, 'a variance is never negative')
    return found


def rotation(values: Any, field: str) -> np.ndarray:
    """Return a rotation matrix (3, 3)."""
    R = numbers(values, field, (3, 3), 2.0)
    (a, b, c), (d, e, f), (g, h, i) = R.tolist()
    turns = a * (e * i - f * h) - b * (d * i - f * g) + c * (d * h - e * g) > 0
    if not turns or np.abs(R @ R.T - np.eye(3)).max() > UNIT:
        refuse(field, R.ravel().tolist(), 'must be a rotation matrix')
    return R


def quaternion(q: Any, field: str) -> np.ndarray:
    """Return a unit quaternion (4,), x y z w, of geometry_msgs/Quaternion."""
    found = numbers([q.x, q.y, q.z, q.w], field, (4,), 2.0)
    if abs(np.linalg.norm(found) - 1) > 10 * UNIT:
        refuse(field, found.tolist(), 'must be a unit quaternion x y z w')
    return found


def intrinsics(values: Any, field: str = 'k') -> np.ndarray:
    """Return a camera matrix (3, 3) [px]."""
    K = numbers(values, field, (3, 3), FAR_OUT)
    if min(K[0, 0], K[1, 1]) < UNIT or np.any(K[2] != (0, 0, 1)):
        refuse(field, K.ravel().tolist(), 'must be a camera matrix, its last row 0 0 1')
    return K


def camera(made: Camera) -> Camera:
    """Return the camera of a message whose pictures and focal lengths [px] a camera can have."""
    low, high = FOCAL * max(size(made.width, made.height))
    within(made.K[[0, 1], [0, 1]], 'focal length (k[0], k[4])', low, high)
    return made


def same_length(msg: Any, names: Iterable[str], most: int) -> int:
    """Return the length that columns of a message share, ``most`` at most."""
    lengths = {name: len(getattr(msg, name)) for name in names}
    first = next(iter(lengths))
    for name, length in lengths.items():
        if length != lengths[first]:
            refuse(f'length of {name}', length, f'must be {lengths[first]}, as that of {first}')
    if lengths[first] > most:
        refuse(f'length of {first}', lengths[first], f'must be {most} at most')
    return lengths[first]


def within(values: np.ndarray, field: str, low: float, high: float) -> np.ndarray:
    """Return a column whose values lie within bounds; NaN is within none."""
    good = (values >= low) & (values <= high)
    if not good.all():
        at = int(np.argmin(good))
        refuse(f'{field}[{at}]', values[at].item(), f'must be {low:g} to {high:g}')
    return values


def most_blocks(width: int, height: int) -> int:
    """Return how many blocks of motion a picture can have."""
    return width * height // SMALLEST_BLOCK + 1


def most_macroblocks(width: int, height: int) -> int:
    """Return how many macroblocks of 16x16 px cover a picture."""
    return ((width + 15) // 16) * ((height + 15) // 16)
