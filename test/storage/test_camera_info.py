from mv_slapse.errors import UnusableInput
from mv_slapse.geometry.camera import Camera
from mv_slapse.storage.camera_info import read_camera, write_camera
import numpy as np
import pytest

# as camera_calibration writes it
TEXT = """
image_width: 640
image_height: 480
camera_name: left
camera_matrix:
  rows: 3
  cols: 3
  data: [500.0, 0.0, 320.0, 0.0, 510.0, 240.0, 0.0, 0.0, 1.0]
distortion_model: rational_polynomial
distortion_coefficients: {rows: 1, cols: 8, data: [1, 2, 3, 4, 5, 6, 7, 8]}
"""


@pytest.fixture
def path(tmp_path):
    return tmp_path / 'camera.yaml'


def test_a_file_of_camera_calibration_is_read(path):
    path.write_text(TEXT)
    camera = read_camera(path)
    assert (camera.width, camera.height, camera.lens) == (640, 480, 'rational_polynomial')
    np.testing.assert_array_equal(camera.K, [[500, 0, 320], [0, 510, 240], [0, 0, 1]])
    np.testing.assert_array_equal(camera.distortion, np.arange(1, 9))


def test_what_is_written_is_read_again(path):
    camera = Camera(320, 240, np.array([[250.0, 0, 160], [0, 251, 119], [0, 0, 1]]),
                    'equidistant', np.array([0.1, -0.2, 0.3, 0.05]))
    write_camera(path, camera)
    again = read_camera(path)
    assert (again.width, again.height, again.lens) == (320, 240, 'equidistant')
    np.testing.assert_array_equal(again.K, camera.K)
    np.testing.assert_array_equal(again.distortion, camera.distortion)


def test_the_cameras_of_the_real_sequences_are_read(data):
    files = sorted(data.rglob('camera.yaml'))
    assert files
    assert all(read_camera(file).K[0, 0] > 100 for file in files)


@pytest.mark.parametrize(('text', 'message'), [
    ('', 'holds no keys'),
    ('a: [1', 'cannot be read as a camera file'),
    ('image_width: 640', 'no image_height, camera_matrix'),
    (TEXT.replace('640', 'wide'), 'whole numbers'),
    (TEXT.replace('510.0', '0.0'), 'not calibrated')])
def test_a_wrong_file_is_refused_by_name(path, text, message):
    path.write_text(text)
    with pytest.raises(UnusableInput, match=message) as caught:
        read_camera(path)
    assert str(path) in str(caught.value)


def test_a_missing_file_is_refused_by_name(path):
    with pytest.raises(UnusableInput, match=f'no camera file {path}'):
        read_camera(path)
