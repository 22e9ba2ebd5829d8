from fractions import Fraction

import av
from mv_slapse.codec import places
from mv_slapse.codec.bitstream import Headers, SliceHeader
from mv_slapse.codec.encoding.encoder import encode, Encoding, LOW_LATENCY
import numpy as np
import pictures
import pytest


def read(codec, packets):
    reader = places.places_of(codec, Headers(), b'')
    return [reader.read(packet.data) for packet in packets]


def mpeg4(rng, b_frames, n=60, fps=25):
    context = av.CodecContext.create('mpeg4', 'w')
    context.width, context.height, context.pix_fmt = 128, 96, 'yuv420p'
    context.time_base, context.gop_size = Fraction(1, fps), 12
    context.max_b_frames = b_frames
    coded = []
    for i, image in enumerate(pictures.sliding(rng, n, (2, 1), (128, 96))):
        picture = av.VideoFrame.from_ndarray(image, 'gray').reformat(format='yuv420p')
        picture.pts = i
        coded += context.encode(picture)
    return coded + context.encode(None)


def test_mpeg_pictures_are_counted_as_they_are_shown(rng):
    packets = encode(pictures.sliding(rng, 16, (2, 1)), 30, Encoding('mpeg2video', 2, 6))
    found = [(place.sequence, place.count) for place in read('mpeg2video', packets)]
    assert found[:7] == [(1, 0), (1, 3), (1, 1), (1, 2), (2, 2), (2, 0), (2, 1)]
    assert places.GroupPlaces().read(b'\x00\x00\x01\xb3 without a picture').count is None


@pytest.mark.parametrize('codec', ['mpeg2video', 'h264', 'mpeg4'])
def test_pictures_that_no_other_refers_to_are_told_by_their_headers(rng, codec):
    packets = mpeg4(rng, 2) if codec == 'mpeg4' else [
        packet.data for packet in encode(pictures.sliding(rng, 30, (2, 1)), 30,
                                         Encoding(codec, 2, 12))]
    reader = places.places_of(codec, Headers(), b'')
    told = [reader.read(bytes(data)).is_reference for data in packets]
    assert 0.3 < np.mean(told) < 0.6
    assert places.Place().is_reference  # a damaged header tells nothing


def test_time_codes_of_groups_number_the_pictures_once_they_have_been_right(rng):
    packets = list(encode(pictures.sliding(rng, 40, (2, 1)), 25, Encoding('mpeg2video', 2, 6)))
    found = read('mpeg2video', packets)
    assert [place.index for place in found[:4]] == [None] * 4
    for packet, place in zip(packets[6:], found[6:], strict=True):
        assert place.index == round(packet.stamp / 40e6)


def test_time_codes_that_stand_still_are_not_trusted(rng):
    packets = list(encode(pictures.sliding(rng, 40, (2, 1)), 25, Encoding('mpeg2video', 0, 6)))
    reader = places.GroupPlaces()
    for packet in packets:
        at = packet.data.find(places.GROUP)
        data = packet.data if at < 0 else packet.data[:at + 4] + bytes(3) + packet.data[at + 7:]
        assert reader.read(data).index is None


@pytest.mark.parametrize('encoding', [LOW_LATENCY, Encoding('h264', 2, 12)])
def test_the_order_of_h264_is_that_of_showing(rng, encoding):
    packets = list(encode(pictures.sliding(rng, 70, (2, 1)), 25, encoding))
    found = read('h264', packets)
    first, step = {}, 2 if encoding.b_frames else 1
    for packet, place in zip(packets, found, strict=True):
        frame = round(packet.stamp / 40e6)
        begin = first.setdefault(place.sequence, frame)
        assert place.count == step * (frame - begin)


def test_counts_go_on_behind_a_loss_as_if_nothing_were_missing(rng):
    packets = list(encode(pictures.sliding(rng, 30, (2, 1)), 25, Encoding('h264', 0, 30)))
    found = read('h264', [*packets[:9], *packets[12:20], *packets[21:]])
    assert [place.count for place in found] == [i for i in range(30) if i not in (9, 10, 11, 20)]
    assert [bool(place.reason) for place in found] == [i in (9, 17) for i in range(26)]


def test_the_order_turns_over_with_pictures_that_others_refer_to():
    """H.264 8.2.1.1: what is ahead is told from the last reference, not from a B picture."""
    counter = places.OrderCount(Headers())
    coded = [(0, True), (7, True), (2, False), (14, True), (8, False), (21, True), (28, True)]
    found = [counter._order(SliceHeader(i == 0, is_reference, 0, 1, order % 16), 16)
             for i, (order, is_reference) in enumerate(coded)]
    assert found == [order for order, _ in coded]


@pytest.mark.parametrize('b_frames', [0, 2])
def test_the_time_of_mpeg4_is_that_of_showing(rng, b_frames):
    """Over two seconds: the base of the time moves on with pictures of either kind."""
    reader = places.VopTime(b'')
    for packet in mpeg4(rng, b_frames):
        assert reader.read(bytes(packet)).time == packet.pts


def test_headers_that_are_cut_tell_nothing_and_raise_nothing(rng):
    for codec in ('h264', 'mpeg2video', 'mpeg4'):
        reader = places.places_of(codec, Headers(), b'')
        packet = bytes(mpeg4(rng, 0, 3)[0]) if codec == 'mpeg4' else next(
            encode(pictures.sliding(rng, 2, (2, 1)), 25, Encoding(codec, 0, 12))).data
        for size in range(0, 80):
            reader.read(packet[:size])
