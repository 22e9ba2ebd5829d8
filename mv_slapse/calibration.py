"""Calibrations as ROS writes them, checked once at the border."""

from dataclasses import replace
from typing import Any

from mv_slapse.errors import UnusableInput
from mv_slapse.geometry.camera import Camera, LARGEST, LENS_MODELS
import numpy as np

ALIASES = {'fisheye': 'equidistant', 'radtan': 'plumb_bob', '': 'plumb_bob', 'none': 'plumb_bob'}
MOST_NUMBERS, GREATEST = 14, 1e9  # coefficients of a lens, and what none of them reaches
WIDEST, LONGEST = 100, 1000  # size by focal length of the widest lens, and the converse
N_COEFFICIENTS = {'plumb_bob': (4, 5), 'rational_polynomial': (8, 12, 14), 'equidistant': (4,)}


def camera_from_calibration(size: tuple[int, int], K: Any, model: str, distortion: Any,
                            origin: str, whole: tuple[int, int] = (0, 0)) -> Camera:
    """Return the camera of the entries of a camera_info, or say what is wrong with them.

    Of width and height [px], K (9 numbers, row-major) [px], lens model and coefficients as ROS
    names and orders them; none means no distortion. ``origin``, a file or topic, is for messages;
    ``whole`` is the size [px] of what the pictures are a part of, if they are of something larger.
    Raises UnusableInput, which names origin, entry and cure.
    """
    K = _numbers(K, 'camera matrix', origin)
    if K.size != 9:
        raise UnusableInput(f'{origin}: the camera matrix has {K.size} numbers, not 9')
    if min(size) <= 0 or max(size) > LARGEST:
        raise UnusableInput(f'{origin}: the picture size is {size[0]}x{size[1]}; '
                            'give image_width and image_height in pixels')
    K = K.reshape(3, 3)
    _check_focal_lengths(K, size, origin)
    if np.all(np.diag(K)[:2] > 0):  # one that is not calibrated has a message of its own
        _check_form(K, origin)
        _check_centre(K, size, max(*size, *whole), origin)
    lens = ALIASES.get(str(model).lower(), str(model))
    try:
        return Camera(*size, K, lens, _coefficients(lens, distortion, origin))
    except UnusableInput as error:
        raise UnusableInput(f'{origin}: {error}') from None


def _check_focal_lengths(K: np.ndarray, size: tuple[int, int], origin: str):
    """Refuse what no lens has: with it the numbers would leave their range further on."""
    low, high = max(size) / WIDEST, max(size) * LONGEST
    focal, centre = np.diag(K)[:2], K[:2, 2]
    # zero is an uncalibrated camera, which has a message of its own
    if np.any((focal > 0) & ((focal < low) | (focal > high))) or np.any(np.abs(centre) > high):
        raise UnusableInput(
            f'{origin}: no lens has the camera matrix {K.tolist()} with pictures of '
            f'{size[0]}x{size[1]}; focal lengths and centre are in pixels')


def _check_form(K: np.ndarray, origin: str):
    """Refuse a matrix that is not (fx s cx; 0 fy cy; 0 0 1)."""
    if K[1, 0] or not np.array_equal(K[2], (0, 0, 1)):
        is_transposed = not np.any(K[:2, 2]) and np.any(K[2, :2])
        cure = ('it is transposed, as MATLAB has it: give it row by row' if is_transposed else
                'give fx 0 cx, 0 fy cy, 0 0 1, row by row and in pixels')
        raise UnusableInput(f'{origin}: no camera matrix is {K.tolist()}; {cure}')


def _check_centre(K: np.ndarray, size: tuple[int, int], margin: float, origin: str):
    """Refuse a principal point that is farther outside the pictures than a margin [px]."""
    centre = K[:2, 2]
    if np.any(centre < -margin) or np.any(centre > np.add(size, margin)):
        raise UnusableInput(
            f'{origin}: the principal point {centre.tolist()} is far outside the pictures of '
            f'{size[0]}x{size[1]}; give cx and cy in pixels, of pictures of this size')


def check_size(camera: Camera, width: int, height: int, origin: str):
    """Raise UnusableInput unless the pictures of ``origin`` have the camera's size.

    They may lack its odd last column or row: encoders cut these off, and K stays.
    """
    if width not in _sides(camera.width) or height not in _sides(camera.height):
        raise UnusableInput(
            f'{origin}: the pictures are {width}x{height} but the camera was calibrated at '
            f'{camera.width}x{camera.height}; give the calibration of this stream')


def fitted(camera: Camera, width: int, height: int, origin: str) -> Camera:
    """Return the camera of pictures of this size, which ``check_size`` allows."""
    check_size(camera, width, height, origin)
    return replace(camera, width=width, height=height)


def _sides(calibrated: int) -> tuple[int, int]:
    """Return the widths, or heights, of pictures [px] that a calibration is of."""
    return calibrated, calibrated // 2 * 2


def _coefficients(lens: str, distortion: Any, origin: str) -> np.ndarray:
    values = _numbers(distortion, 'distortion', origin)
    allowed = N_COEFFICIENTS.get(lens)
    if allowed is None:
        raise UnusableInput(f'lens model {lens!r} is not supported; '
                            f'use one of {", ".join(LENS_MODELS)}')
    if not values.size:
        return np.zeros(allowed[-1])
    if values.size not in allowed:
        raise UnusableInput(f'lens model {lens} takes {" or ".join(map(str, allowed))} '
                            f'coefficients, not {values.size}')
    return values


def _numbers(values: Any, name: str, origin: str) -> np.ndarray:
    try:
        numbers = np.array([] if values is None else values, float).ravel()
    except (TypeError, ValueError, OverflowError):
        raise UnusableInput(f'{origin}: the {name} holds something that is not a number: '
                            f'{repr(values)[:200]}') from None
    if numbers.size > MOST_NUMBERS:
        raise UnusableInput(f'{origin}: the {name} has {numbers.size} numbers; the longest there '
                            f'is has {MOST_NUMBERS}')
    if not np.all(np.isfinite(numbers)) or np.any(np.abs(numbers) > GREATEST):
        raise UnusableInput(f'{origin}: the {name} is not finite, or out of range: '
                            f'{numbers.tolist()}')
    return numbers
