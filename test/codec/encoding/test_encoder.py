from mv_slapse.codec.encoding.encoder import (
    encode,
    Encoding,
    ImageEncoder,
    LOW_LATENCY,
    write_video,
)
from mv_slapse.codec.source import open_source
from mv_slapse.errors import UnusableOutput, UsageError
import numpy as np
import pictures
import pytest


@pytest.mark.parametrize('encoding', [Encoding(), LOW_LATENCY])
def test_the_same_pictures_give_the_same_bytes(rng, encoding):
    images = pictures.sliding(rng, 9, (2, 1))
    one, other = ([packet.data for packet in encode(images, 30, encoding)] for _ in range(2))
    assert one == other


def test_every_picture_becomes_a_packet_with_its_own_stamp(rng):
    encoder = ImageEncoder()
    stamps = [7, 100, 250, 260, 900, 1000, 1300, 1301, 5000]
    packets = [packet for image, stamp in zip(pictures.sliding(rng, 9, (2, 1)), stamps,
                                              strict=True)
               for packet in encoder.feed(image, stamp)] + encoder.flush()
    assert sorted(packet.stamp for packet in packets) == stamps
    assert [packet.is_key for packet in packets] == [True] + [False] * 8


def test_low_latency_holds_no_picture_back(rng):
    encoder = ImageEncoder(LOW_LATENCY)
    assert all(len(encoder.feed(image, i)) == 1
               for i, image in enumerate(pictures.sliding(rng, 5, (2, 1))))


def test_colour_and_odd_sizes_are_taken(rng):
    image = np.repeat(pictures.texture(rng)[:121, :161, None], 3, axis=2)
    packets = list(encode([image] * 2, 30))
    assert len(packets) == 2


@pytest.mark.parametrize(('name', 'encoding'), [
    ('a.mpg', Encoding()), ('a.mp4', LOW_LATENCY), ('a.mkv', Encoding('h264', 2, 12))])
def test_a_written_file_holds_all_pictures_at_their_times(rng, tmp_path, name, encoding):
    write_video(tmp_path / name, pictures.sliding(rng, 14, (2, 1)), 20, encoding)
    with open_source(tmp_path / name) as source:
        assert source.fps == pytest.approx(20, rel=1e-3)
        stamps = sorted(packet.stamp for packet in source.packets())
    np.testing.assert_allclose(stamps, np.arange(14) * 50_000_000, atol=1_000_000)


@pytest.mark.parametrize('name', ['no/a.mp4', 'a.txt', 'a', 'a.webm', 'full.mp4'])
def test_a_video_that_cannot_be_written_is_one_kind_of_error(tmp_path, name):
    (tmp_path / 'full.mp4').symlink_to('/dev/full')
    with pytest.raises(UnusableOutput, match=f'{name} cannot be written: '):
        write_video(tmp_path / name, np.zeros((3, 64, 64), np.uint8), 20, LOW_LATENCY)


def test_what_the_pictures_raise_is_no_fault_of_the_file(tmp_path):
    def broken():
        yield np.zeros((16, 16), np.uint8)
        raise ValueError('no picture')

    with pytest.raises(ValueError, match='no picture'):
        write_video(tmp_path / 'a.mp4', broken(), 20)


def test_an_unknown_codec_is_refused():
    with pytest.raises(UsageError, match="'hevc'"):
        Encoding('hevc')
