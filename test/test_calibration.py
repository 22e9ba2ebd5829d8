from mv_slapse.calibration import camera_from_calibration, check_size, fitted
from mv_slapse.errors import UnusableInput
import numpy as np
import pytest

K = [500.0, 0, 320, 0, 510.0, 240, 0, 0, 1]


def camera(size=(640, 480), K=K, model='plumb_bob', distortion=(0.1, 0, 0, 0, 0)):
    return camera_from_calibration(size, K, model, distortion, 'left.yaml')


def test_the_entries_become_a_camera():
    made = camera()
    assert (made.width, made.height, made.lens) == (640, 480, 'plumb_bob')
    np.testing.assert_array_equal(made.K, np.reshape(K, (3, 3)))
    np.testing.assert_array_equal(made.distortion, [0.1, 0, 0, 0, 0])


@pytest.mark.parametrize(('model', 'lens'), [('fisheye', 'equidistant'), ('', 'plumb_bob'),
                                             ('equidistant', 'equidistant')])
def test_no_coefficients_mean_no_distortion(model, lens):
    made = camera(model=model, distortion=None)
    assert made.lens == lens
    assert not np.any(made.distortion)


@pytest.mark.parametrize(('wrong', 'message'), [
    ({'K': [0.0] * 9}, 'not calibrated.*cameracalibrator'),
    ({'K': K[:8]}, '8 numbers, not 9'),
    ({'K': [*K[:8], 'one']}, 'not a number'),
    ({'K': [float('nan'), *K[1:]]}, 'not finite'),
    ({'K': np.reshape(K, (3, 3)).T.ravel()}, 'transposed, as MATLAB has it: give it row by row'),
    ({'K': [*K[:8], 2.0]}, 'no camera matrix is .*give fx 0 cx, 0 fy cy, 0 0 1'),
    ({'K': [*K[:8], 0.0]}, 'no camera matrix is'),
    ({'K': [*K[:3], 1e-3, *K[4:]]}, 'no camera matrix is'),
    ({'K': [500.0, 0, 1281, *K[3:]]}, 'principal point .*far outside the pictures of 640x480'),
    ({'K': [*K[:5], -641, *K[6:]]}, 'principal point'),
    ({'size': (0, 480)}, '0x480'),
    ({'model': 'mirror_ball'}, "'mirror_ball' is not supported; use one of plumb_bob"),
    ({'model': 'equidistant'}, '4 coefficients, not 5'),
    ({'distortion': [0.1] * 8}, '4 or 5 coefficients, not 8')])
def test_a_wrong_entry_is_refused_with_its_origin(wrong, message):
    with pytest.raises(UnusableInput, match=f'left.yaml: .*{message}'):
        camera(**wrong)


@pytest.mark.parametrize('centre', [(-600, 240), (1279, 1119)])
def test_the_principal_point_of_cut_pictures_may_be_outside_them(centre):
    cut = [500.0, 0.5, centre[0], 0, 510.0, centre[1], 0, 0, 1]
    np.testing.assert_array_equal(camera(K=cut).K[:2, 2], centre)


def test_pictures_of_another_size_are_refused_naming_both_sizes():
    check_size(camera(), 640, 480, 'a.mp4')
    with pytest.raises(UnusableInput, match='a.mp4.*1280x720.*640x480'):
        check_size(camera(), 1280, 720, 'a.mp4')


def test_an_odd_last_column_or_row_may_be_missing():
    odd = camera(size=(1241, 375))
    found = fitted(odd, 1240, 374, 'a.mp4')
    assert (found.width, found.height) == (1240, 374)
    np.testing.assert_array_equal(found.K, odd.K)
    for size in ((1239, 375), (1241, 373), (1242, 376)):
        with pytest.raises(UnusableInput, match='1241x375'):
            fitted(odd, *size, 'a.mp4')
