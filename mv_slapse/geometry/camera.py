"""Cameras: intrinsics, lens models, and points between distorted and ideal pixels."""

from dataclasses import dataclass, field

import cv2
from mv_slapse.errors import UnusableInput
import numpy as np

UP = np.array([0.0, -1.0, 0.0])  # of a level camera: optical axes have y down
LARGEST = 65535  # px, width or height
LENS_MODELS = ('plumb_bob', 'rational_polynomial', 'equidistant')


@dataclass(frozen=True)
class Camera:
    """A calibrated camera as in ``sensor_msgs/CameraInfo``."""

    width: int  # of the picture [px]
    height: int  # the same [px]
    K: np.ndarray  # (3, 3): intrinsics [px]
    lens: str = 'plumb_bob'  # distortion model, one of LENS_MODELS
    # (D,): its coefficients, as ROS orders them
    distortion: np.ndarray = field(default_factory=lambda: np.zeros(5))

    def __post_init__(self):
        """Refuse an uncalibrated camera and an unknown lens."""
        if not np.all(np.isfinite(self.K)) or self.K[0, 0] <= 0 or self.K[1, 1] <= 0:
            raise UnusableInput(
                f'the camera is not calibrated: fx = {self.K[0, 0]}, fy = {self.K[1, 1]}; '
                'calibrate it (ros2 run camera_calibration cameracalibrator) and give its '
                'camera_info')
        if self.lens not in LENS_MODELS:
            raise UnusableInput(f'lens model {self.lens!r} is not supported; '
                                f'use one of {", ".join(LENS_MODELS)}')


def undistort(camera: Camera, x: np.ndarray) -> np.ndarray:
    """Return ideal pixels (N, 2) of pixels (N, 2) seen through the lens, float64 if it bends."""
    is_fisheye = camera.lens == 'equidistant'  # whose r = f theta is no pinhole's, whatever D is
    if not len(x) or not is_fisheye and not camera.distortion.any():
        return x.copy()
    x = np.asarray(x, float)
    if is_fisheye:
        return cv2.fisheye.undistortPoints(x[:, None], camera.K, camera.distortion[:4],
                                           P=camera.K)[:, 0]
    # OpenCV's own five iterations leave 0.2 px in the corners of a wide lens.
    stop = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 40, 1e-6)
    return cv2.undistortPointsIter(x[:, None], camera.K, camera.distortion, np.eye(3), camera.K,
                                   stop)[:, 0]


def to_rays(K: np.ndarray, x: np.ndarray) -> np.ndarray:
    """Return K^-1 x, homogeneous with last coordinate 1, (N, 3), of pixels (N, 2)."""
    rays = np.ones((len(x), 3))
    xy = rays[:, :2]
    np.divide(x - K[:2, 2], (K[0, 0], K[1, 1]), out=xy)
    if K[0, 1]:
        xy[:, 0] -= K[0, 1] / K[0, 0] * xy[:, 1]
    return rays


def to_pixels(K: np.ndarray, X: np.ndarray) -> np.ndarray:
    """Return pixels (N, 2) of points or rays (N, 3) in the camera frame."""
    x = X @ K.T
    return x[:, :2] / x[:, 2:]
