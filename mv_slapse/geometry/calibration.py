"""Calibrations as ROS writes them, checked once at the border."""

from typing import Any

from mv_slapse.errors import UnusableInput
from mv_slapse.geometry.camera import Camera, LENS_MODELS
import numpy as np

ALIASES = {'fisheye': 'equidistant', 'radtan': 'plumb_bob', '': 'plumb_bob', 'none': 'plumb_bob'}
N_COEFFICIENTS = {'plumb_bob': (4, 5), 'rational_polynomial': (8, 12, 14), 'equidistant': (4,)}


def camera_from_calibration(size: tuple[int, int], K: Any, model: str, distortion: Any,
                            origin: str) -> Camera:
    """Return the camera of the entries of a camera_info, or say what is wrong with them.

    Parameters
    ----------
    size : (int, int)
        Width and height [px].
    K : 9 numbers, row-major [px]
    model, distortion : str, numbers
        Lens model and coefficients as ROS names and orders them; none means no distortion.
    origin : str
        File or topic, for messages.

    Raises
    ------
    UnusableInput
        Naming origin, entry and cure.
    """
    K = _numbers(K, 'camera matrix', origin)
    if K.size != 9:
        raise UnusableInput(f'{origin}: the camera matrix has {K.size} numbers, not 9')
    if min(size) <= 0:
        raise UnusableInput(f'{origin}: the picture size is {size[0]}x{size[1]}; '
                            'give image_width and image_height in pixels')
    lens = ALIASES.get(str(model).lower(), str(model))
    try:
        return Camera(*size, K.reshape(3, 3), lens, _coefficients(lens, distortion, origin))
    except UnusableInput as error:
        raise UnusableInput(f'{origin}: {error}') from None


def check_size(camera: Camera, width: int, height: int, origin: str):
    """Raise UnusableInput unless the pictures of ``origin`` have the camera's size."""
    if (width, height) != (camera.width, camera.height):
        raise UnusableInput(
            f'{origin}: the pictures are {width}x{height} but the camera was calibrated at '
            f'{camera.width}x{camera.height}; give the calibration of this stream')


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
    except (TypeError, ValueError):
        raise UnusableInput(f'{origin}: the {name} holds something that is not a number: '
                            f'{values!r}') from None
    if not np.all(np.isfinite(numbers)):
        raise UnusableInput(f'{origin}: the {name} is not finite: {numbers.tolist()}')
    return numbers
