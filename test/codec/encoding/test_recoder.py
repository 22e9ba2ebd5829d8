import av
from mv_slapse.codec.decoder import CorrespondenceDecoder
from mv_slapse.codec.encoding.recoder import PictureDecoder, Recoder
from mv_slapse.codec.packet import Packet, Picture
from mv_slapse.codec.source import open_source
from mv_slapse.config import DecoderSettings, EncoderSettings
from mv_slapse.errors import UnusableInput, UsageError
from mv_slapse.records import SegmentKind
from mv_slapse.video_messages import is_key
import numpy as np
import other_codecs
from other_codecs import CODECS, PERIOD
import pictures
import pytest

SHIFT = (3, 1)

@pytest.fixture(scope='module')
def rng() -> np.random.Generator:
    return np.random.default_rng(0)


def coded(rng, codec: str, n: int = 12) -> list[Packet]:
    return other_codecs.coded(pictures.sliding(rng, n, SHIFT), codec, PERIOD)


def recoded(items, settings=None) -> list[Packet]:
    recoder = Recoder(settings)
    return [packet for item in items for packet in recoder.feed(item)] + recoder.flush()


@pytest.mark.parametrize('codec', CODECS)
def test_video_without_vectors_gives_the_motion_and_every_stamp(rng, codec):
    packets = recoded(coded(rng, codec))
    assert [packet.stamp for packet in packets] == [PERIOD * k for k in range(12)]
    assert {packet.codec for packet in packets} == {'mpeg2video'}
    decoder = CorrespondenceDecoder(DecoderSettings(max_chain=1))
    pairs = [pair for packet in packets for pair in decoder.feed(packet)] + decoder.flush()
    assert [pair.kind for pair in pairs] == [SegmentKind.IP] + [SegmentKind.PP] * 10
    for pair in pairs:
        flow = np.median(pair.x_prev - pair.x_cur, axis=0)
        np.testing.assert_allclose(flow, SHIFT, atol=0.3)


@pytest.mark.parametrize(('name', 'codec', 'pix_fmt'), [
    ('a.avi', 'rawvideo', 'yuv420p'), ('a.avi', 'rawvideo', 'bgr24'),
    ('a.y4m', 'wrapped_avframe', 'yuv420p'), ('a.mkv', 'ffv1', 'yuv420p'),
    ('a.wmv', 'wmv2', 'yuv420p')])
def test_codecs_that_only_a_container_describes_are_decoded(rng, tmp_path, name, codec, pix_fmt):
    path = str(tmp_path / name)
    with av.open(path, 'w') as file:
        stream = file.add_stream(codec, 25, width=128, height=96, pix_fmt=pix_fmt)
        for image in pictures.sliding(rng, 4, SHIFT):
            frame = av.VideoFrame.from_ndarray(image[:96, :128].copy(), 'gray')
            file.mux(stream.encode(frame.reformat(format=pix_fmt)))
        file.mux(stream.encode())
    with av.open(path) as file:
        expected = [frame.to_ndarray(format='gray') for frame in file.decode(video=0)]
    decoder = PictureDecoder()
    with open_source(path) as source:
        found = [frame for packet in source.packets() for frame, _ in decoder.feed(packet)]
    found += [frame for frame, _ in decoder.flush()]
    np.testing.assert_array_equal([frame.to_ndarray(format='gray') for frame in found], expected)
    assert len(found) == 4


@pytest.mark.parametrize('codec', [codec for codec in CODECS if codec != 'mjpeg'])
def test_a_key_picture_is_known_by_its_bytes(rng, codec):
    packets = coded(rng, codec)
    assert [is_key(packet.data, codec) for packet in packets] == [
        packet.is_key for packet in packets]


def test_packets_with_vectors_pass_as_they_are():
    packets = [Packet(b'x', 0, True, 'h264'), Packet(b'y', 1, False, 'mpeg4')]
    assert recoded(packets) == packets
    never = EncoderSettings(recode='never')
    assert recoded([Packet(b'x', 0, True, 'hevc')], never) == [Packet(b'x', 0, True, 'hevc')]


@pytest.mark.parametrize('settings', [EncoderSettings(), EncoderSettings('h264'),
                                      EncoderSettings(quality=4)])
def test_no_picture_is_held_back_and_the_same_gives_the_same(rng, settings):
    items = [Picture(image, i) for i, image in enumerate(pictures.sliding(rng, 4, SHIFT))]
    recoder = Recoder(settings)
    packets = [recoder.feed(item) for item in items]
    assert [len(some) for some in packets] == [1] * 4
    assert [packet for some in packets for packet in some] == recoded(items, settings)


def test_quality_and_b_frames_are_those_asked_for(rng):
    items = [Picture(image, i) for i, image in enumerate(pictures.sliding(rng, 9, SHIFT))]
    size = [sum(len(packet.data) for packet in recoded(items, EncoderSettings(codec, quality=q)))
            for codec in ('mpeg2video', 'h264') for q in (2, 20)]
    assert size[0] > 1.5 * size[1]
    assert size[2] > 1.5 * size[3]
    stamps = [packet.stamp for packet in recoded(items, EncoderSettings(b_frames=3))]
    assert stamps == [0, 4, 1, 2, 3, 8, 5, 6, 7]


@pytest.mark.parametrize('codec', ['vp9', 'mjpeg'])
def test_of_odd_pictures_the_last_column_and_row_are_cut_off(rng, codec):
    image = pictures.texture(rng)[:191, :257]
    recoder, decoder = Recoder(), PictureDecoder()
    assert recoder.size is None
    packets = [packet for item in other_codecs.coded([image] * 2, codec, PERIOD)
               for packet in recoder.feed(item)]
    assert recoder.size == (256, 190)
    frame, _ = [found for packet in packets for found in decoder.feed(packet)][0]
    error = np.abs(frame.to_ndarray(format='gray') - image[:190, :256].astype(float))
    assert error[-32:, -32:].mean() < 1.5 * error[:32, :32].mean()  # nothing is scaled


def test_after_damage_only_whole_pictures_are_encoded(rng):
    packets = coded(rng, 'hevc', 24)
    lost = next(i for i, packet in enumerate(packets) if i > 2 and not packet.is_key)
    packets[lost] = Packet(b'\0\0\0\1' + bytes(rng.integers(0, 256, 40, np.uint8)),
                           packets[lost].stamp, False, 'hevc')
    stamps = [packet.stamp for packet in recoded(packets)]
    key = next(packet.stamp for packet in packets[lost + 1:] if packet.is_key)
    assert stamps == sorted(stamps)
    assert packets[lost].stamp not in stamps
    assert {k * PERIOD for k in range(24) if k * PERIOD >= key} <= set(stamps)


def test_another_size_begins_anew(rng):
    large, small = pictures.texture(rng)[:160, :192], pictures.texture(rng)[:96, :128]
    packets = recoded([Picture(large, 0), Picture(large, 1), Picture(small, 2), Picture(small, 3)])
    assert [packet.is_key for packet in packets] == [True, False, True, False]


def test_a_codec_that_nobody_knows_is_refused():
    with pytest.raises(UnusableInput, match="no decoder .* H.264"):
        recoded([Packet(b'x', 0, True, 'nonsense')])
    with pytest.raises(UsageError, match="encoder.codec = 'hevc': choose one of mpeg2video, h264"):
        EncoderSettings('hevc')
    with pytest.raises(UsageError, match='encoder.recode'):
        EncoderSettings(recode='sometimes')
