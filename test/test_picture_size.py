import cv2
from mv_slapse.picture_size import size_of_still
import numpy as np
import pytest


@pytest.mark.parametrize('form', ['.jpg', '.png'])
@pytest.mark.parametrize('options', [(), (cv2.IMWRITE_JPEG_PROGRESSIVE, 1)])
def test_a_size_is_read_from_the_header(form, options):
    coded = cv2.imencode(form, np.zeros((48, 80, 3), np.uint8),
                         options if form == '.jpg' else ())[1].tobytes()
    assert size_of_still(coded) == (80, 48)
    # a comment and a thumbnail's place before the frame header, as cameras write them
    if form == '.jpg':
        assert size_of_still(coded[:2] + b'\xff\xfe\0\x06abcd\xff' + coded[2:]) == (80, 48)


@pytest.mark.parametrize('data', [b'', b'\xff\xd8', b'\xff\xd8\xff', b'GIF89a', b'\xff\xd8' * 20,
                                  b'\xff\xd8\xff\xe0\0\0' * 9])
def test_what_is_no_picture_has_no_size(data):
    assert size_of_still(data) is None
