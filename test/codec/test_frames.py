from dataclasses import replace
from fractions import Fraction
import gc
from io import BytesIO
from itertools import pairwise

import av
from mv_slapse.codec.bitstream import Headers, nal_units
from mv_slapse.codec.encoding.encoder import encode, Encoding, LOW_LATENCY
from mv_slapse.codec.frames import _is_blank, _Stamps, FrameDecoder
from mv_slapse.codec.packet import Packet
from mv_slapse.codec.places import places_of
from mv_slapse.errors import UnusableInput
from mv_slapse.records import FrameType
import numpy as np
import pictures
import pytest

MPEG2 = Encoding('mpeg2video', 3, 12)
ENCODINGS = [MPEG2, LOW_LATENCY, Encoding('h264', 2, 12)]


def decoded(packets, with_luma=False, of_all=False):
    decoder = FrameDecoder(with_luma, of_all)
    return [frame for packet in packets for frame in decoder.feed(packet)] + decoder.flush()


def with_hole(packet):
    """Return a packet without 60 of its bytes, from a third of its length on."""
    at = len(packet.data) // 3
    return replace(packet, data=packet.data[:at] + bytes(60) + packet.data[at + 60:])


def test_parameter_sets_alone_are_no_damage(rng):
    coded = list(encode(pictures.sliding(rng, 12, (2, 1)), 25, Encoding('h264', 0, 6)))
    units = nal_units(coded[0].data)
    sets = b''.join(b'\x00\x00\x00\x01' + unit for unit in units if unit[0] & 31 in (7, 8))
    with_sets = [one for packet in coded for one in (
        [replace(packet, data=sets, is_key=False)] if packet.is_key else []) + [packet]]
    assert len(with_sets) > len(coded)
    frames = decoded(with_sets)
    assert len(frames) == 12
    assert not any(frame.damage for frame in frames)


def test_a_publisher_may_go_on_in_another_codec(rng):
    images = pictures.sliding(rng, 12, (2, 1))
    later = [replace(packet, stamp=packet.stamp + 480_000_000)
             for packet in encode(images, 25, Encoding('mpeg2video', 0, 6))]
    frames = decoded([*encode(images, 25, Encoding('h264', 0, 6)), *later])
    assert len(frames) >= 22
    assert 'codec changed' in ' '.join(frame.damage for frame in frames)
    assert not any(frame.damage for frame in frames[-8:])
    assert sum(len(frame) > 0 for frame in frames[-8:]) > 5


@pytest.mark.parametrize('encoding', ENCODINGS)
def test_pictures_come_in_order_of_presentation_with_their_stamps(rng, encoding):
    frames = decoded(encode(pictures.sliding(rng, 14, (2, 1)), 25, encoding))
    assert [frame.stamp for frame in frames] == [i * 40_000_000 for i in range(14)]


def test_stamps_in_the_order_of_decoding_are_put_in_order_of_presentation(rng):
    packets = encode(pictures.sliding(rng, 14, (2, 1)), 25, Encoding('h264', 2, 12))
    packets = [replace(packet, stamp=10 * i) for i, packet in enumerate(packets)]
    assert [frame.stamp for frame in decoded(packets)] == [10 * i for i in range(14)]


def test_after_lost_packets_pictures_have_their_own_stamps_again(rng):
    """A B picture that lost its reference is thrown away: its stamp must not go to the next."""
    packets = list(encode(pictures.sliding(rng, 60, (2, 1)), 25, Encoding('mpeg2video', 1, 12)))
    for first in range(14, 22):
        frames = decoded([*packets[:first], *packets[first + 15:]])
        stamps = [frame.stamp for frame in frames if frame.stamp >= packets[first + 18].stamp]
        assert stamps == sorted(set(stamps))
        assert stamps[-1] == 59 * 40_000_000


@pytest.mark.parametrize('encoding', ENCODINGS)
def test_pictures_are_freed_without_a_garbage_collection(encoding):
    packets = list(encode(pictures.sliding(np.random.default_rng(0), 14, (3, -2)), 25, encoding))
    gc.collect()
    others = pictures_alive()  # of other tests in this process
    gc.disable()
    try:
        frames = decoded(packets, with_luma=True)
        # Pixels of key frames are kept as long as they are looked at.
        kept = sum(frame.luma is not None for frame in frames)
        assert (len(frames), pictures_alive() - others) == (14, kept)
        del frames
        assert pictures_alive() == others
    finally:
        gc.enable()


def pictures_alive():
    return sum(isinstance(thing, av.VideoFrame) for thing in gc.get_objects())


@pytest.mark.parametrize('encoding', ENCODINGS)
def test_vectors_are_the_motion_of_the_pictures(rng, encoding):
    frames = decoded(encode(pictures.sliding(rng, 14, (3, -2)), 25, encoding))
    for previous, frame in pairwise(frames):
        if frame.frame_type == FrameType.P and previous.frame_type is not FrameType.B:
            right = np.abs(frame.displacement - (3, -2)).max(axis=1) < 0.6
            assert right.mean() > 0.7


def test_the_last_picture_of_mpeg_has_its_vectors(rng):
    last = decoded(encode(pictures.sliding(rng, 9, (2, 1)), 25, MPEG2))[-1]
    assert last.frame_type is FrameType.P
    assert len(last) > 100


def test_what_lies_behind_a_packet_in_memory_does_not_matter():
    """FFmpeg reads beyond the end of a packet; each read was one in thirty to spoil a picture."""
    noise = np.random.default_rng(0)
    context = av.CodecContext.create('mpeg4', 'w')
    context.width, context.height, context.pix_fmt = 160, 128, 'yuv420p'
    context.time_base, context.bit_rate = Fraction(1, 25), 400_000
    packets = []
    for i, image in enumerate(pictures.sliding(noise, 150, (2, 1))):
        picture = av.VideoFrame.from_ndarray(image, 'gray').reformat(format='yuv420p')
        picture.pts = i
        packets += context.encode(picture)
    decoder = FrameDecoder(with_luma=False)
    for i, packet in enumerate(packets):
        # bytes of this length lie in memory with whatever comes next
        for frame in decoder.feed(Packet(bytes(packet), i, i == 0, 'mpeg4', b'')):
            assert not frame.damage


def test_a_picture_with_a_hole_in_its_bytes_is_damaged(rng):
    """FFmpeg conceals it and calls the picture corrupt; counts and times are whole."""
    packets = list(encode(pictures.sliding(rng, 14, (2, 1)), 25, Encoding('mpeg2video', 0, 12)))
    packets[5] = with_hole(packets[5])
    said = {5: 'the decoder calls the picture corrupt'}
    assert [frame.damage for frame in decoded(packets)] == [said.get(i, '') for i in range(14)]


@pytest.mark.parametrize('encoding', [MPEG2, Encoding('h264', 2, 12)])
def test_a_damaged_b_picture_that_no_other_refers_to_loses_its_own_vectors_alone(rng, encoding):
    packets = list(encode(pictures.sliding(rng, 14, (2, 1)), 25, encoding))
    clean = decoded(packets)
    hurt = next(i for i, frame in enumerate(clean) if i > 3 and frame.frame_type is FrameType.B)
    at = next(i for i, p in enumerate(packets) if p.stamp == clean[hurt].stamp)
    packets[at] = with_hole(packets[at])
    frames = decoded(packets)
    assert [len(frame) for frame in frames] == [
        0 if i == hurt else len(frame) for i, frame in enumerate(clean)]
    assert not any(frame.damage for frame in frames)


def test_a_damaged_b_picture_that_others_refer_to_tears(rng):
    """Where a bit of a header was flipped, it may be a P picture that only looks like a B one."""
    pyramid = Encoding('h264', 3, 12, {'x264-params': 'ref=3:b-adapt=0:b-pyramid=normal'})
    packets = list(encode(pictures.sliding(rng, 14, (2, 1)), 25, pyramid))
    reader = places_of('h264', Headers(), b'')
    referred = {p.stamp for p in packets if reader.read(p.data).is_reference}
    hurt = next(frame for frame in decoded(packets)
                if frame.frame_type is FrameType.B and frame.stamp in referred)
    at = next(i for i, p in enumerate(packets) if p.stamp == hurt.stamp)
    packets[at] = with_hole(packets[at])
    assert [frame.stamp for frame in decoded(packets) if frame.damage] == [hurt.stamp]


def test_a_packet_that_cannot_be_decoded_gives_its_stamp_to_no_picture(rng):
    """Stamps of the order of decoding go to the pictures as these are shown, the oldest first."""
    packets = list(encode(pictures.sliding(rng, 30, (2, 1)), 25, Encoding('h264', 2, 30)))
    noise = Packet(b'\x00\x00\x01\x41\xff', 0, False, 'h264')
    packets = [replace(packet, stamp=10 * i) for i, packet in enumerate(
        [*packets[:21], noise, *packets[21:]])]
    frames = decoded(packets)
    assert [frame.stamp for frame in frames] == [10 * i for i in range(31) if i != 21]
    assert sum(bool(frame.damage) for frame in frames) == 1


def test_a_picture_that_comes_after_its_packet_was_given_up_has_its_stamp():
    """FFmpeg was seen to show one whose packet had raised an error."""
    stamps = _Stamps()
    for number in range(1, 4):
        stamps.add(number, 10 * number)
    stamps.drop(2)
    assert [stamps.take(number, FrameType.P) for number in (1, 2, 3)] == [10, 20, 30]
    assert stamps.take(2, FrameType.P) is None  # a second picture of one packet


@pytest.mark.parametrize('stamp', [1 << 62, -(1 << 62)])
def test_a_stamp_that_no_clock_has_is_refused(rng, stamp):
    packet = next(encode(pictures.sliding(rng, 2, (2, 1)), 25, LOW_LATENCY))
    with pytest.raises(UnusableInput, match=str(stamp)):
        FrameDecoder(False).feed(replace(packet, stamp=stamp))


def test_an_empty_packet_is_ignored(rng):
    packets = list(encode(pictures.sliding(rng, 6, (2, 1)), 25, LOW_LATENCY))
    packets.insert(3, replace(packets[0], data=b''))
    assert len(decoded(packets)) == 6


@pytest.mark.parametrize('encoding', ENCODINGS)
def test_packets_that_a_network_delivers_twice_count_once(rng, encoding):
    packets = list(encode(pictures.sliding(rng, 14, (2, 1)), 25, encoding))
    twice = [*packets[:6], packets[5], *packets[6:9], packets[4], *packets[9:]]
    for once, frame in zip(decoded(packets), decoded(twice), strict=True):
        assert (once.stamp, frame.damage) == (frame.stamp, '')
        np.testing.assert_array_equal(once.displacement, frame.displacement)


def test_luma_of_ten_bits_is_that_of_eight(rng):
    images = pictures.sliding(rng, 3, (2, 1))
    context = av.CodecContext.create('libx264', 'w')
    context.width, context.height = images[0].shape[::-1]
    context.pix_fmt, context.time_base = 'yuv420p10le', Fraction(1, 25)
    context.options = {'crf': '1', 'bf': '0'}
    coded = [packet for i, image in enumerate(images) for packet in context.encode(
        ten_bits(image, i))] + context.encode(None)
    frames = decoded([Packet(bytes(packet), packet.pts * 40_000_000, False, 'h264', b'')
                      for packet in coded], with_luma=True)
    for image, frame in zip(images, frames, strict=True):
        assert frame.luma.dtype == np.uint8
        # From a picture's full range to a video's, of 16 to 235.
        assert np.median(np.abs(16 + image * (219 / 255) - frame.luma)) <= 1


def ten_bits(image, number) -> av.VideoFrame:
    picture = av.VideoFrame.from_ndarray(image, 'gray').reformat(format='yuv420p10le')
    picture.pts, picture.time_base = number, Fraction(1, 25)
    return picture


def test_a_packet_of_noise_is_damage_and_no_exception(rng):
    packets = list(encode(pictures.sliding(rng, 8, (2, 1)), 25, LOW_LATENCY))
    packets[4] = replace(packets[4], data=packets[4].data[:5] + rng.bytes(60))
    assert any(frame.damage for frame in decoded(packets))


@pytest.mark.parametrize('encoding', ENCODINGS)
def test_what_could_not_be_decoded_is_told_by_the_next_picture(rng, encoding):
    """Whatever counts and stamps say: here nothing is missing but the decoder's consent."""
    packets = list(encode(pictures.sliding(rng, 12, (2, 1)), 25, encoding))
    decoder = FrameDecoder(False)
    before = [frame for packet in packets[:6] for frame in decoder.feed(packet)]
    context = decoder._context
    decoder._context = Refusing()
    decoder.feed(replace(packets[5], data=b'\x00\x00\x01\xb2' + bytes(8), stamp=1))
    decoder._context = context
    after = [frame for packet in packets[6:] for frame in decoder.feed(packet)]
    assert not any(frame.damage for frame in before)
    assert sum('could not be decoded' in frame.damage for frame in after) == 1


class Refusing:
    """A context of FFmpeg that calls every packet an error."""

    name = ''

    def decode(self, _packet):
        raise av.error.InvalidDataError(1, 'Invalid data')


def test_a_packet_that_ffmpeg_refuses_and_shows_later_is_no_exception(data):
    """After zeros in the stream FFmpeg calls a packet an error and shows its picture later."""
    path = data / 'parking' / 'mpeg2.mpg'
    content = bytearray(path.read_bytes()[:400_000])
    content[65816:65880] = bytes(64)
    with av.open(BytesIO(bytes(content))) as container:
        packets = [Packet(bytes(packet), int(packet.dts), bool(packet.is_keyframe), 'mpeg2video')
                   for packet in container.demux(video=0) if packet.size and packet.dts]
    frames = decoded(packets)
    assert any(frame.damage for frame in frames)
    assert len(frames) >= len(packets) - 3


@pytest.mark.parametrize('encoding', ENCODINGS)
def test_what_is_kept_of_packets_without_pictures_is_bounded(rng, encoding):
    packets = list(encode(pictures.sliding(rng, 3, (2, 1)), 25, encoding))
    decoder = FrameDecoder(False)
    decoder.feed(packets[0])
    for i in range(400):
        decoder.feed(replace(packets[0], data=rng.bytes(40), stamp=i))
    kept = [decoder._stamps._pending, decoder._stamps._dropped, decoder._continuity._places,
            decoder._continuity._events]
    assert max(map(len, kept)) <= 70


def test_a_lost_reference_is_damage_of_the_picture_after_it(rng):
    packets = list(encode(pictures.sliding(rng, 8, (2, 1)), 25, LOW_LATENCY))
    frames = decoded(packets[:4] + packets[5:])
    assert [i for i, frame in enumerate(frames) if 'lost' in frame.damage] == [4]


@pytest.mark.parametrize(('b_frames', 'lost', 'expected'), [
    (0, range(0), []), (3, range(0), []), (0, range(7, 10), [10]), (3, range(6, 9), [8]),
    (3, range(9, 13), [13])])
def test_lost_pictures_of_mpeg_leave_a_gap_in_the_places_of_those_around(
        rng, b_frames, lost, expected):
    packets = list(encode(pictures.sliding(rng, 30, (2, 1)), 30, Encoding('mpeg2video', b_frames,
                                                                          12)))
    decoder = FrameDecoder(with_luma=False)
    frames = [frame for i, packet in enumerate(packets) if i not in lost
              for frame in decoder.feed(packet)] + decoder.flush()
    damaged = [round(frame.stamp * 30e-9) for frame in frames if frame.damage]
    assert damaged[:1] == expected


@pytest.mark.parametrize('codec', ['hevc', 'vp9', 'av1', 'mjpeg', ''])
def test_a_codec_without_vectors_is_refused_with_a_cure(codec):
    with pytest.raises(UnusableInput, match='ffmpeg -i INPUT'):
        FrameDecoder(False).feed(Packet(b'\x12\x00', 0, True, codec))


def test_a_wrong_name_of_the_codec_is_put_right_by_the_payload(rng):
    packets = encode(pictures.sliding(rng, 6, (2, 1)), 25, LOW_LATENCY)
    assert len(decoded(replace(packet, codec='hevc') for packet in packets)) == 6


def test_luma_is_the_picture_and_is_kept_of_key_frames_only(rng):
    images = pictures.sliding(rng, 9, (2, 1))
    frames = decoded(encode(images, 25, MPEG2), with_luma=True)
    assert all((frame.luma is None) == (frame.frame_type is FrameType.B) for frame in frames)
    # Grey is stored in the narrower range of video, 16 to 235.
    error = frames[4].luma.astype(float) - (16 + images[4] * (219 / 255))
    assert np.abs(error).mean() < 4


@pytest.mark.parametrize('encoding', ENCODINGS)
def test_luma_of_all_pictures_is_kept_where_it_is_asked_for(rng, encoding):
    images = pictures.sliding(rng, 9, (2, 1))
    frames = decoded(encode(images, 25, encoding), with_luma=True, of_all=True)
    for frame, image in zip(frames, images, strict=True):
        assert np.abs(frame.luma - (16 + image * (219 / 255))).mean() < 4
    without = decoded(encode(images, 25, encoding), of_all=True)
    assert all(frame.luma is None for frame in without)


@pytest.mark.parametrize('encoding', ENCODINGS)
def test_two_runs_give_the_same_vectors(rng, encoding):
    packets = list(encode(pictures.sliding(rng, 8, (2, 1)), 25, encoding))
    for one, other in zip(decoded(packets), decoded(packets), strict=True):
        np.testing.assert_array_equal(one.displacement, other.displacement)
        np.testing.assert_array_equal(one.x, other.x)


@pytest.mark.parametrize(('rows', 'is_blank'), [
    (slice(0, 0), True), (slice(0, 16), False), (slice(232, 248), False),
    (slice(464, 480), False)], ids=['nowhere', 'at the top', 'in the middle', 'at the bottom'])
def test_a_picture_is_blank_where_nothing_shows_anywhere(rng, rows, is_blank):
    luma = rng.normal(60, 8, (480, 640))
    luma[rows, :320] += 80
    assert _is_blank(luma.clip(0, 255).astype(np.uint8)) == is_blank
