"""Camera files as ``camera_calibration`` and ``camera_info_manager`` write them (YAML)."""

from pathlib import Path

from mv_slapse.calibration import camera_from_calibration
from mv_slapse.errors import UnusableInput
from mv_slapse.geometry.camera import Camera
from mv_slapse.storage import whole_files, yaml_files
import numpy as np
import yaml


def read_camera(path: str | Path) -> Camera:
    """Return the camera of a camera_info file.

    Raises
    ------
    UnusableInput
        Naming the file, what is wrong in it and what to do.
    """
    content = _load(Path(path))
    missing = [key for key in ('image_width', 'image_height', 'camera_matrix')
               if key not in content]
    if missing:
        raise UnusableInput(f'{path}: no {", ".join(missing)}; give a camera_info file as '
                            'camera_calibration writes it')
    try:
        size = int(content['image_width']), int(content['image_height'])
    except (TypeError, ValueError, OverflowError):
        raise UnusableInput(f'{path}: image_width and image_height must be whole numbers, got '
                            f'{content["image_width"]!r} and {content["image_height"]!r}'
                            ) from None
    return camera_from_calibration(
        size, _data(content['camera_matrix']), content.get('distortion_model') or '',
        _data(content.get('distortion_coefficients')), str(path))


def write_camera(path: str | Path, camera: Camera, name: str = 'camera'):
    """Write a camera as a camera_info file."""
    content = {'image_width': int(camera.width), 'image_height': int(camera.height),
               'camera_name': name, 'camera_matrix': _matrix(camera.K),
               'distortion_model': camera.lens,
               'distortion_coefficients': _matrix(np.atleast_2d(camera.distortion)),
               'rectification_matrix': _matrix(np.eye(3)),
               'projection_matrix': _matrix(np.c_[camera.K, np.zeros(3)])}
    whole_files.write_text(
        path, yaml.safe_dump(content, sort_keys=False, default_flow_style=None))


def _load(path: Path) -> dict:
    try:
        content = yaml_files.load(path)
    except FileNotFoundError:
        raise UnusableInput(f'there is no camera file {path}') from None
    except (OSError, ValueError) as error:
        reason = ' '.join(str(error).split())
        raise UnusableInput(f'{path} cannot be read as a camera file: {reason}') from None
    if not isinstance(content, dict):
        raise UnusableInput(f'{path} is not a camera_info file: it holds no keys')
    return content


def _data(entry: object) -> object:
    return entry.get('data') if isinstance(entry, dict) else entry


def _matrix(values: np.ndarray) -> dict:
    rows, cols = values.shape
    return {'rows': rows, 'cols': cols, 'data': [float(v) for v in values.ravel()]}
