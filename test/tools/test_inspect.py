from mv_slapse.codec.encoding.encoder import Encoding, write_video
from mv_slapse.storage.camera_info import read_camera
from mv_slapse.tools import inspect as tool
from mv_slapse.tools.bag import make_bag
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
