import json

import cv2
from mv_slapse.codec.encoding.encoder import Encoding, write_video
from mv_slapse.storage.camera_info import read_camera
from mv_slapse.tools import inspect as tool
from mv_slapse.tools.bag import make_bag
from mv_slapse.tools.inputs import pictures
from mv_slapse.tools.main import main
import numpy as np
import pytest


def test_a_usable_video_is_called_so(clip):
    report = tool.inspect(str(clip.video))
    assert (report['codec'], report['width'], report['height']) == ('mpeg2video', 480, 352)
    assert (report['n_frames'], report['b_frames'], report['gop']) == (21, 1, 12)
    assert report['vectors_per_frame'] > 400
    assert tool.is_usable(report)
    assert 'verdict: usable' in tool.text(report)


def test_a_bag_says_the_same_as_its_video(clip, tmp_path):
    make_bag(clip.video, read_camera(clip.camera), None, tmp_path / 'bag')
    video, bag = tool.inspect(str(clip.video)), tool.inspect(str(tmp_path / 'bag'))
    assert bag.pop('fps') == pytest.approx(video.pop('fps'))
    assert (video.pop('input'), bag.pop('input')) == (str(clip.video), str(tmp_path / 'bag'))
    assert bag == video


def test_an_unusable_video_is_told_why_and_what_to_do(tmp_path):
    pictures = np.broadcast_to(np.random.default_rng(0).integers(0, 256, (96, 128), np.uint8),
                               (4, 96, 128))
    write_video(tmp_path / 'small.mpg', pictures, 25.0, Encoding(b_frames=0, gop=12))
    report = tool.inspect(str(tmp_path / 'small.mpg'))
    text = tool.text(report)
    assert not tool.is_usable(report)
    assert '48 motion vectors a picture are too few' in text
    assert 'do this: use a larger picture' in text


def test_a_folder_of_pictures_is_inspected_at_the_rate_that_is_given(clip, tmp_path, capsys):
    images = list(pictures(clip.video))[:5]
    for i, image in enumerate(images):
        cv2.imwrite(str(tmp_path / f'{i:06d}.png'), image)
    assert main(['inspect', str(tmp_path), '--set', 'encoder.rate=15', '--json']) == 0
    report = json.loads(capsys.readouterr().out)
    assert (report['width'], report['height'], report['n_frames']) == (480, 352, 5)
    assert report['fps'] == pytest.approx(15)
    assert main(['inspect', str(tmp_path)]) == 3
    assert '--set encoder.rate=30' in capsys.readouterr().err
