"""Clips with known movers, mirrored and cut: pictures, camera and truth must change alike."""

from dataclasses import replace

import av
from mv_slapse.codec.encoding.encoder import LOW_LATENCY, write_video
from mv_slapse.evaluation.truth import read_arrays
from mv_slapse.geometry.camera import Camera
from mv_slapse.storage.camera_info import write_camera
from mv_slapse.storage.tables import read_table
from mv_slapse.tools.altered import altered, KINDS
from mv_slapse.tools.inputs import pictures
import numpy as np
import pytest

CAMERA = Camera(241, 131, np.array([[200.0, 0, 130.5], [0, 210.0, 60.5], [0, 0, 1]]))
SPOT = np.array([150, 70])


@pytest.fixture
def data(tmp_path):
    """Return a folder of two clips with a bright spot, its point or its box, and one without."""
    image = np.full((130, 240), 30, np.uint8)
    image[SPOT[1] - 2:SPOT[1] + 3, SPOT[0] - 4:SPOT[0] + 5] = 220
    for name in ('points', 'boxes', 'none'):
        folder = tmp_path / 'data' / name
        folder.mkdir(parents=True)
        write_camera(folder / 'camera.yaml', CAMERA)
        for file in ('h264_lowlatency.mp4', 'h264_bframes.mp4'):
            write_video(folder / file, [image] * 3, 10.0, LOW_LATENCY)
    tracks = np.array([SPOT, (3, 60)], float)[:, None]
    np.savez(tmp_path / 'data/points/motion_labels.npz', tracks=tracks, label=np.array([2, 1]),
             visible=np.ones((2, 1), bool))
    (tmp_path / 'data/boxes/boxes.csv').write_text('frame,x,y,width,height\n1,146,68,9,5\n')
    return tmp_path / 'data'


def made(data, folder, only=''):
    for number, scene in enumerate(altered(data)):
        (folder / str(number)).mkdir(exist_ok=True)
        yield from scene.make(folder / str(number), only)


def middle(image):
    return np.argwhere(image > 125).mean(axis=0)[::-1]


def test_each_clip_with_a_truth_comes_once_for_each_kind_and_encoding(data, tmp_path):
    names = [case.name for case in made(data, tmp_path)]
    assert names == [f'{clip}, {kind}/{file}' for clip in ('boxes', 'points') for kind in KINDS
                     for file in ('mpeg2.mp4', 'h264_lowlatency.mp4')]
    assert [case.name for case in made(data, tmp_path, 'points, cut/mpeg2')] == [names[6]]


def test_points_and_boxes_stay_on_what_they_mark(data, tmp_path):
    for case in made(data, tmp_path):
        with av.open(str(case.video)) as video:
            assert video.streams.video[0].average_rate == (10 if case.labels else 30)
        image = list(pictures(case.video))[1]
        assert image.shape == (case.camera.height, case.camera.width)
        if case.labels:
            known = read_arrays(case.labels, ('tracks', 'visible', 'label'))
            np.testing.assert_allclose(known['tracks'][0, 0], middle(image), atol=0.1)
            assert known['visible'][0, 0]
        else:
            box = read_table(case.boxes, 'frame,x,y,width,height')
            at = np.array([box['x'][0] + 4, box['y'][0] + 2])
            np.testing.assert_allclose(at, middle(image), atol=0.1)
            assert (box['frame'][0], box['width'][0], box['height'][0]) == (1, 9, 5)


def test_a_clip_through_a_lens_with_distortion_is_only_cut(data, tmp_path):
    write_camera(data / 'points' / 'camera.yaml',
                 replace(CAMERA, distortion=np.array([-0.3, 0.1, 0, 0, 0])))
    assert [case.name for case in made(data, tmp_path, 'points')] == [
        'points, cut/mpeg2.mp4', 'points, cut/h264_lowlatency.mp4']


def test_what_else_is_known_of_a_clip_is_left_out(data, tmp_path):
    (data / 'boxes' / 'ground_truth.tum').write_text('')
    assert all(case.ground_truth is None for case in made(data, tmp_path, 'boxes'))


def test_the_ray_of_a_pixel_stays_but_for_its_side(data, tmp_path):
    ray = (SPOT - CAMERA.K[:2, 2]) / np.diag(CAMERA.K)[:2]
    for case in made(data, tmp_path, 'points'):
        x = read_arrays(case.labels, ('tracks',))['tracks'][0, 0]
        side = -1 if 'mirrored' in case.name else 1
        np.testing.assert_allclose((x - case.camera.K[:2, 2]) / np.diag(CAMERA.K)[:2],
                                   ray * (side, 1), atol=1e-9)


def test_what_is_cut_off_is_not_visible(data, tmp_path):
    for case in made(data, tmp_path, 'points'):
        visible = read_arrays(case.labels, ('visible',))['visible'][1, 0]
        assert visible == ('mirrored' in case.name)
