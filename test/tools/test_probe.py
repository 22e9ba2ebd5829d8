from types import SimpleNamespace

from mv_slapse.codec.encoding.encoder import Encoding, LOW_LATENCY, write_video
from mv_slapse.codec.encoding.recoder import Recoder
from mv_slapse.codec.packet import Picture
from mv_slapse.codec.source import open_source
from mv_slapse.tools.probe import probe, UNUSABLE, USABLE, WITH_CARE
import pictures
import pytest
from reliability import clips

NO_SEARCH = Encoding('mpeg2video', 0, 12, {'motion_est': 'zero', 'sc_threshold': '1000000000'})


@pytest.fixture
def probed(tmp_path, rng):
    def run(name, encoding, n=26, step=(2, 1)):
        write_video(tmp_path / name, pictures.sliding(rng, n, step), 25, encoding)
        with open_source(tmp_path / name) as source:
            return probe(source)
    return run


def test_mpeg_with_b_frames_is_usable(probed):
    found = probed('a.mpg', Encoding('mpeg2video', 3, 12))
    assert (found.verdict, found.codec) == (USABLE, 'mpeg2video')
    assert (found.width, found.height, found.n_frames) == (256, 192, 26)
    assert (found.b_frames, found.gop, found.references) == (3, 12, 1)
    assert found.vectors_per_frame > 150
    assert found.share_with_vectors == 1


def test_dead_segments_want_care_and_the_advice_says_so(probed):
    found = probed('a.mp4', Encoding('h264', 0, 10))
    assert (found.verdict, found.b_frames, found.gop) == (WITH_CARE, 0, 10)
    assert 'I frame' in found.reasons[0]
    assert found.advice


def test_low_latency_within_one_group_is_usable(probed):
    assert probed('a.mp4', LOW_LATENCY).verdict == USABLE


def test_several_references_want_care(probed):
    options = {'x264-params': 'ref=3:scenecut=0:weightp=0'}
    found = probed('a.mp4', Encoding('h264', 0, 30, options))
    assert (found.verdict, found.references) == (WITH_CARE, 3)
    assert '-refs 1' in found.advice[0]


def test_i_frames_alone_want_care_as_a_run_searches_in_the_pictures(probed):
    found = probed('a.mp4', Encoding('h264', 0, 1))
    assert found.verdict == WITH_CARE
    assert found.share_with_vectors == 0
    assert 'no picture has motion vectors' in found.reasons[0]


def test_a_single_picture_is_too_short_for_a_run(probed):
    found = probed('a.mp4', Encoding('h264', 0, 30), n=1)
    assert (found.verdict, found.advice) == (UNUSABLE, ('give a longer video',))
    assert '1 pictures can be decoded, and no two key frames' in found.reasons[0]


def test_pictures_that_change_their_size_are_refused_as_by_a_run(rng):
    recoder = Recoder()
    images = [*pictures.sliding(rng, 4, (2, 1)), *pictures.sliding(rng, 4, (2, 1), (320, 240))]
    packets = [packet for i, image in enumerate(images)
               for packet in recoder.feed(Picture(image, i * 40_000_000))] + recoder.flush()
    found = probe(SimpleNamespace(codec='mpeg2video', width=256, height=192, fps=25,
                                  packets=lambda: iter(packets)))
    assert found.verdict == UNUSABLE
    assert 'the pictures change their size from 256x192 to 320x240' in found.reasons
    assert any('its own calibration' in text for text in found.advice)


@pytest.mark.parametrize(('n', 'verdict'), [(8, UNUSABLE), (3, WITH_CARE)])
def test_pictures_that_are_not_stamped_are_told(rng, n, verdict):
    recoder = Recoder()
    packets = [packet for i, image in enumerate(pictures.sliding(rng, 8, (2, 1)))
               for packet in recoder.feed(Picture(image, 40_000_000 * max(i + 1 - n, 0)))]
    found = probe(SimpleNamespace(codec='mpeg2video', width=256, height=192, fps=25,
                                  packets=lambda: iter(packets)))
    assert found.verdict == verdict
    assert f'of {n - 1} pairs of key frames the time stamps' in found.reasons[-1]
    assert 'stamp each with its time' in found.advice[-1]


def test_an_encoder_that_does_not_search_is_told_from_a_camera_that_stands(probed):
    found = probed('a.mpg', NO_SEARCH, n=7)
    assert found.verdict == WITH_CARE
    assert 'the vectors of 6 pictures are all zero though the pictures change' in found.reasons[0]
    assert probed('b.mpg', NO_SEARCH, n=7, step=(0, 0)).verdict == USABLE


def test_b_frames_whose_vectors_ffmpeg_does_not_tell_want_care():
    given = clips.Kind('mpeg4', 'mpeg4', 2, 30)
    source = SimpleNamespace(codec='mpeg4', width=192, height=160, fps=25,
                             packets=lambda: clips.drawn(given, 20))
    found = probe(source)
    assert (found.verdict, found.b_frames) == (WITH_CARE, 2)
    assert 'no vectors of the B frames' in found.reasons[-1]
    assert '-bf 0' in found.advice[-1]
