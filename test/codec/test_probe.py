from mv_slapse.codec.encoder import Encoding, LOW_LATENCY, write_video
from mv_slapse.codec.probe import probe, UNUSABLE, USABLE, WITH_CARE
from mv_slapse.codec.source import open_source
import pictures
import pytest


@pytest.fixture
def probed(tmp_path, rng):
    def run(name, encoding, n=26):
        write_video(tmp_path / name, pictures.sliding(rng, n, (2, 1)), 25, encoding)
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


def test_i_frames_alone_are_unusable(probed):
    found = probed('a.mp4', Encoding('h264', 0, 1))
    assert found.verdict == UNUSABLE
    assert found.share_with_vectors == 0
