from types import SimpleNamespace

import cv2
from mv_slapse import video_messages
from mv_slapse.codec import bitstream
from mv_slapse.codec.decoder import CorrespondenceDecoder
from mv_slapse.codec.encoding.encoder import encode, Encoding
from mv_slapse.codec.packet import Packet
from mv_slapse.codec.source import open_source
from mv_slapse.config import DecoderSettings
from mv_slapse.errors import UnusableInput
from mv_slapse.message_checks import InvalidMessage
from mv_slapse.video_messages import (
    COMPRESSED_IMAGE,
    COMPRESSED_VIDEO,
    FFMPEG_PACKET,
    from_message,
    IMAGE,
    is_key,
)
import numpy as np
import pictures
import pytest

TIME = SimpleNamespace(sec=1, nanosec=5)
HEADER = SimpleNamespace(stamp=TIME, frame_id='eye')
STAMP = 1_000_000_005
IDR = b'\0\0\0\1\x67abc\0\0\0\1\x68d\0\0\0\1\x65picture'
P = b'\0\0\0\1\x41picture'


def as_message(value):
    if isinstance(value, dict):
        return SimpleNamespace(**{name: as_message(item) for name, item in value.items()})
    return value


def message(**values):
    return SimpleNamespace(header=HEADER, **values)


@pytest.mark.parametrize(('name', 'decoder'), [
    ('libx264', 'h264'), ('h264_nvenc', 'h264'), ('h264;yuv420p;bgr8;bgr8', 'h264'),
    ('H.264', 'h264'), ('hevc_vaapi', 'hevc'), ('libx265', 'hevc'), ('mpeg2video', 'mpeg2video'),
    ('libxvid', 'mpeg4'), ('libvpx-vp9', 'vp9'), ('libsvtav1', 'av1')])
def test_an_encoder_names_its_decoder(name, decoder):
    assert video_messages.decoder_of(name) == decoder


def test_a_packet_is_read_from_each_message_that_carries_it():
    expected = Packet(IDR, STAMP, True, 'h264')
    assert expected == from_message(
        FFMPEG_PACKET, message(encoding='libx264', flags=0, pts=2**63, data=IDR))
    assert expected == from_message(
        COMPRESSED_VIDEO, SimpleNamespace(timestamp=TIME, frame_id='eye', format='h264', data=IDR))
    assert expected == from_message(COMPRESSED_IMAGE, message(format='h264', data=IDR))


def test_a_wrong_format_field_is_not_believed():
    packet = from_message(COMPRESSED_IMAGE, message(format='h265', data=P))
    assert (packet.codec, packet.is_key) == ('h264', False)


def test_key_pictures_of_mpeg_are_known_by_their_headers():
    def picture(kind):
        return b'\0\0\1\0' + bytes([0, kind << 3, 0])

    assert [video_messages.is_key(picture(kind), 'mpeg2video') for kind in (1, 2, 3)] == [
        True, False, False]
    assert video_messages.is_key(b'\0\0\1\xb6\x10', 'mpeg4')
    assert not video_messages.is_key(b'\0\0\1\xb6\x50', 'mpeg4')


def test_a_still_picture_is_decoded(rng):
    image = rng.integers(0, 256, (12, 16, 3), np.uint8)
    data = cv2.imencode('.png', image)[1].tobytes()
    picture = from_message(COMPRESSED_IMAGE, message(format='bgr8; png compressed bgr8',
                                                     data=data))
    assert picture.stamp == STAMP
    np.testing.assert_array_equal(picture.image, image)


@pytest.mark.parametrize('suffix', ['.png', '.jpg'])
@pytest.mark.parametrize('name', ['h264', '', 'rgb8'])
def test_a_still_picture_is_one_whatever_its_format_field_says(rng, suffix, name):
    data = cv2.imencode(suffix, np.full((12, 16, 3), 90, np.uint8))[1].tobytes()
    picture = from_message(COMPRESSED_IMAGE, message(format=name, data=data))
    assert np.abs(picture.image.astype(int) - 90).max() < 3


@pytest.mark.parametrize('name', ['jpeg', 'bgr8; jpeg compressed bgr8'])
def test_video_that_calls_itself_a_still_picture_is_video(name):
    packet = from_message(COMPRESSED_IMAGE, message(format=name, data=IDR))
    assert (packet.codec, packet.is_key) == ('h264', True)


def test_a_broken_still_picture_is_refused():
    with pytest.raises(UnusableInput, match='jpeg'):
        from_message(COMPRESSED_IMAGE, message(format='jpeg', data=b'abc'))


@pytest.mark.parametrize(('encoding', 'order'), [('bgr8', [0, 1, 2]), ('rgb8', [2, 1, 0]),
                                                 ('rgba8', [2, 1, 0]), ('bgra8', [0, 1, 2])])
def test_a_raw_picture_is_read_row_by_row(rng, encoding, order):
    n = 4 if 'a' in encoding else 3
    rows = rng.integers(0, 256, (4, 6 * n + 5), np.uint8)  # with padding
    picture = from_message(IMAGE, message(encoding=encoding, height=4, width=6,
                                          step=rows.shape[1], data=rows.tobytes()))
    np.testing.assert_array_equal(picture.image,
                                  rows[:, :6 * n].reshape(4, 6, n)[:, :, order])


def test_a_grey_picture_stays_grey():
    data = bytes(range(24))
    picture = from_message(IMAGE, message(encoding='mono8', height=4, width=6, step=6, data=data))
    np.testing.assert_array_equal(picture.image, np.arange(24).reshape(4, 6))


@pytest.mark.parametrize(('encoding', 'size', 'match'), [('32FC1', 96, "'32FC1' are not"),
                                                         ('mono8', 23, '23 bytes, too few')])
def test_an_unknown_or_short_raw_picture_is_refused(encoding, size, match):
    with pytest.raises(UnusableInput, match=match):
        from_message(IMAGE, message(encoding=encoding, height=4, width=6, step=6,
                                    data=bytes(size)))


@pytest.mark.parametrize('name', ['h264_lowlatency.mp4', 'mpeg2.mpg'])
def test_messages_decode_to_the_same_correspondences_as_the_file(data, name):
    def decode(packets):
        decoder = CorrespondenceDecoder(DecoderSettings())
        return [pair for packet in packets for pair in decoder.feed(packet)] + decoder.flush()

    with open_source(data / 'moving' / 'seq028_clip01' / name) as source:
        packets = list(source.packets())
    fields = [video_messages.packet_to_fields(packet, (8, 8), k, 'eye')
              for k, packet in enumerate(packets)]
    carried = [from_message(FFMPEG_PACKET, as_message(entry)) for entry in fields]
    assert [packet.is_key for packet in carried] == [packet.is_key for packet in packets]
    expected, actual = decode(packets), decode(carried)
    assert len(actual) == len(expected) > 5
    for a, b in zip(actual, expected, strict=True):
        np.testing.assert_array_equal(a.x_prev, b.x_prev)


def test_parameter_sets_travel_with_each_key_picture_and_once():
    avcc = bytes([1, 66, 0, 30, 0xff, 0xe1, 0, 4]) + b'\x67abc' + b'\1\0\2\x68d'
    key = Packet(b'\0\0\0\3\x65ab', 0, True, 'h264', avcc)
    expected = b'\0\0\0\1\x67abc\0\0\0\1\x68d\0\0\0\1\x65ab'
    assert video_messages.in_band(key) == expected
    assert video_messages.in_band(Packet(b'\0\0\0\2\x41x', 0, False, 'h264', avcc)) == (
        b'\0\0\0\1\x41x')
    head = b'\0\0\1\xb3size'
    whole = Packet(head + b'\0\0\1\0abc', 0, True, 'mpeg2video', head)
    assert video_messages.in_band(whole) == whole.data


def test_an_avcc_unit_whose_length_looks_like_a_start_code_is_read_by_its_length():
    unit = b'\x65' + bytes(range(256)) + b'x' * 40
    avcc = bytes([1, 66, 0, 30, 0xff, 0xe1, 0, 4]) + b'\x67abc' + b'\1\0\2\x68d'
    packet = Packet(len(unit).to_bytes(4, 'big') + unit, 0, False, 'h264', avcc)
    assert packet.data[:3] == b'\0\0\1'
    assert video_messages.in_band(packet) == b'\0\0\0\1' + unit


@pytest.mark.parametrize('width', [2**31 - 1, 32768, 0])
def test_a_still_picture_that_would_fill_the_memory_is_refused_by_its_header(width):
    coded = bytearray(cv2.imencode('.png', np.zeros((8, 8), np.uint8))[1].tobytes())
    coded[16:20] = width.to_bytes(4, 'big')
    coded[20:24] = width.to_bytes(4, 'big')
    with pytest.raises(InvalidMessage, match='width'):
        from_message(COMPRESSED_IMAGE, message(format='png', data=bytes(coded)))


@pytest.mark.parametrize(('kind', 'values'), [
    (FFMPEG_PACKET, {'encoding': 'libx264', 'flags': 0}), (COMPRESSED_IMAGE, {'format': 'jpeg'})])
def test_a_message_without_a_picture_is_refused(kind, values):
    with pytest.raises(InvalidMessage, match='data is empty'):
        from_message(kind, message(data=b'', **values))


@pytest.mark.parametrize(('width', 'height', 'step'), [(2**32 - 1, 1, 0), (32768, 32768, 2**15),
                                                      (0, 4, 4)])
def test_a_raw_picture_of_absurd_size_is_refused(width, height, step):
    with pytest.raises(InvalidMessage, match='width'):
        from_message(IMAGE, message(encoding='mono8', width=width, height=height, step=step,
                                    data=b'abcd'))


def test_intra_refresh_can_be_joined_where_the_encoder_says_so(rng):
    refresh = Encoding('h264', 0, 10, {
        'x264-params': 'ref=1:scenecut=0:bframes=0:intra-refresh=1:keyint=10:threads=1'
                       ':repeat-headers=1'})
    packets = list(encode(pictures.sliding(rng, 40, (2, 1)), 30, refresh))
    joins = [i for i, packet in enumerate(packets) if is_key(packet.data, 'h264')]
    assert joins == [i for i, packet in enumerate(packets) if packet.is_key]
    assert len(joins) >= 3
    decoder = CorrespondenceDecoder(DecoderSettings(max_chain=1))
    pairs = [pair for packet in packets[joins[1]:] for pair in decoder.feed(packet)]
    assert len(pairs) >= 8
    for pair in pairs:
        np.testing.assert_allclose(np.median(pair.x_prev - pair.x_cur, axis=0), (2, 1), atol=0.3)


def test_a_recovery_point_is_found_behind_other_messages():
    assert bitstream.is_recovery_point(b'\x06\x05\x02ab\x06\x01\x80')
    assert bitstream.is_recovery_point(b'\x06\x05\xff\x01' + bytes(256) + b'\x06\x01\x80')
    assert not bitstream.is_recovery_point(b'\x06\x05\x04ab\x06\x01\x80')
    assert not bitstream.is_recovery_point(b'\x41\x06\x01\x80')
    assert not bitstream.is_recovery_point(b'\x06\xff\xff')


def test_a_packet_of_h264_as_compressed_video_is_read_back():
    given = Packet(IDR, STAMP, True, 'h264')
    fields = video_messages.compressed_to_fields(given, 'eye')
    msg = SimpleNamespace(**{**fields, 'timestamp': TIME})
    assert fields['timestamp'] == vars(TIME)
    assert video_messages.from_message(video_messages.COMPRESSED_VIDEO, msg) == given
    assert video_messages.frame_of(video_messages.COMPRESSED_VIDEO, msg) == 'eye'
