from fractions import Fraction

import av
from mv_slapse.codec import bitstream, places
from mv_slapse.codec.encoding.encoder import configure, encode, Encoding, LOW_LATENCY
import pictures
import pytest


def test_exp_golomb_numbers_are_those_of_table_9_2():
    codes = '1' '010' '011' '00100' '00101' '00111'
    codes += '0' * (-len(codes) % 8)
    bits = bitstream.BitReader(int(codes, 2).to_bytes(len(codes) // 8, 'big'))
    assert [bits.ue() for _ in range(6)] == [0, 1, 2, 3, 4, 6]


def test_signed_exp_golomb_numbers_alternate():
    bits = bitstream.BitReader(bytes([0b01001100, 0b10000101]))
    assert [bits.se() for _ in range(4)] == [1, -1, 2, -2]


def test_reading_past_the_end_is_an_error_of_its_own():
    with pytest.raises(EOFError):
        bitstream.BitReader(b'\x00').ue()


def test_a_number_longer_than_any_that_the_standard_has_is_none():
    assert bitstream.BitReader(bytes(3) + b'\x80' + bytes(4)).ue() == (1 << 24) - 1
    with pytest.raises(EOFError, match='Exp-Golomb'):
        bitstream.BitReader(bytes(6) + b'\xff' * 20).ue()


def test_emulation_prevention_is_removed():
    assert bitstream.BitReader(b'\x00\x00\x03\x01').bits(24) == 1


@pytest.mark.parametrize(('size', 'references', 'b_frames'), [
    ((256, 192), 1, 0), ((320, 176), 3, 0), ((256, 192), 2, 2)])
def test_sequence_parameters_are_those_that_were_encoded(rng, size, references, b_frames):
    options = {'x264-params': f'ref={references}:scenecut=0:b-adapt=0:b-pyramid=none'}
    images = pictures.sliding(rng, 4, (2, 0), size)
    packet = next(encode(images, 30, Encoding('h264', b_frames, 30, options)))
    headers = bitstream.Headers()
    headers.read_parameters(bitstream.nal_units(packet.data))
    assert (headers.sps.width, headers.sps.height) == size
    assert headers.sps.max_num_ref_frames == references
    assert not headers.sps.interlaced


def test_interlaced_coding_is_seen(rng):
    options = {'x264-params': 'tff=1:ref=1'}
    images = pictures.sliding(rng, 2, (2, 0))
    packet = next(encode(images, 30, Encoding('h264', 0, 30, options)))
    headers = bitstream.Headers()
    headers.read_parameters(bitstream.nal_units(packet.data))
    assert headers.sps.interlaced


def test_slices_tell_how_many_references_they_use(rng):
    options = {'x264-params': 'ref=3:scenecut=0:weightp=0:keyint=30:b-adapt=0'}
    packets = list(encode(pictures.sliding(rng, 6, (2, 1)), 30,
                          Encoding('h264', 0, 30, options)))
    headers = bitstream.Headers()
    slices = [headers.read_slice(packet.data) for packet in packets]
    assert [item.references for item in slices] == [0, 1, 2, 3, 3, 3]
    assert [item.is_idr for item in slices] == [True] + [False] * 5


def test_a_lost_packet_leaves_a_gap_in_frame_num(rng):
    packets = list(encode(pictures.sliding(rng, 24, (2, 1)), 30, LOW_LATENCY))
    for lost, expected in ((None, []), (9, [10]), (17, [18])):
        headers = bitstream.Headers()
        gaps = [i for i, packet in enumerate(packets)
                if i != lost and headers.missing(headers.read_slice(packet.data))]
        assert gaps == expected


def numbered(*pictures, first=0):
    """Return how many references are missing before each of (is a reference, frame_num)."""
    headers = bitstream.Headers()
    headers.sps = bitstream.SequenceParameters(64, 48, 1, False, 4, False, False, 0, 4)
    return [headers.missing(bitstream.SliceHeader(i == 0, is_reference, number, 1))
            for i, (is_reference, number) in enumerate(pictures)]


def test_a_gap_is_told_once_also_at_a_picture_that_is_no_reference():
    r, b = True, False
    assert numbered((r, 0), (r, 1), (b, 2), (b, 2), (r, 2)) == [0] * 5
    assert numbered((r, 0), (r, 1), (b, 3), (b, 3), (r, 3), (r, 4)) == [0, 0, 1, 0, 0, 0]
    assert numbered((r, 0), (r, 15), (b, 0), (r, 0), (r, 3)) == [0, 14, 0, 0, 2]


def test_parameter_sets_that_no_encoder_writes_are_not_believed():
    """A counter of 2^30 bits would fill the memory, a number of a million zeros take for ever."""
    def ue(value):
        text = bin(value + 1)[2:]
        return '0' * (len(text) - 1) + text

    def sps(log2):
        bits = f'{77:08b}' + '0' * 16 + ue(0) + ue(log2) + ue(2) + ue(1)
        bits += '0' + ue(3) + ue(2) + '1'
        bits += '1' + '0' * (-(len(bits) + 1) % 8)
        return b'\x67' + int(bits, 2).to_bytes(len(bits) // 8, 'big')

    assert bitstream.parse_sps(sps(4)).log2_max_frame_num == 8
    assert bitstream.parse_sps(sps(1 << 30)) is None
    assert bitstream.parse_sps(b'\x67\x4d' + bytes(1_000_000)) is None
    assert bitstream.parse_pps(b'\x68' + bytes(1_000_000)) is None


def test_extradata_that_is_cut_gives_the_units_before_the_cut():
    units = [b'\x67' + bytes(range(1, 10)), b'\x68\xaa']
    extradata = (b'\x01\x64\x00\x1f\xff\xe1' + len(units[0]).to_bytes(2, 'big') + units[0]
                 + b'\x01' + len(units[1]).to_bytes(2, 'big') + units[1])
    for size in range(1, len(extradata) + 1):
        found = list(bitstream.parameter_sets(extradata[:size]))
        assert found == units[:(size >= 18) + (size >= len(extradata))]


def test_b_frames_leave_no_gap(rng):
    headers = bitstream.Headers()
    packets = encode(pictures.sliding(rng, 30, (2, 1)), 30, Encoding('h264', 2, 12))
    assert not any(headers.missing(headers.read_slice(packet.data)) for packet in packets)


def test_length_prefixed_units_and_their_parameter_sets_are_read(rng):
    units = [b'\x67' + bytes(9), b'\x68\xaa', b'\x65' + bytes([7]) * 300]
    avcc = b''.join(len(unit).to_bytes(4, 'big') + unit for unit in units)
    assert bitstream.nal_units(avcc) == units
    assert bitstream.nal_units(avcc[-305:]) == units[2:]
    assert bitstream.sniff(avcc[-305:]) == bitstream.sniff(avcc) == ''
    extradata = (b'\x01\x64\x00\x1f\xff\xe1' + len(units[0]).to_bytes(2, 'big') + units[0]
                 + b'\x01' + len(units[1]).to_bytes(2, 'big') + units[1])
    assert list(bitstream.parameter_sets(extradata)) == units[:2]


@pytest.mark.parametrize('codec', ['mpeg2video', 'h264'])
def test_the_payload_tells_its_codec(rng, codec):
    packets = list(encode(pictures.sliding(rng, 5, (2, 1)), 30, Encoding(codec, 2, 12)))
    assert {bitstream.sniff(packet.data) for packet in packets} == {codec}


def test_other_payloads_are_not_taken_for_h264():
    assert bitstream.sniff(b'\x00\x00\x00\x01\x40\x01\x0c') == 'hevc'
    assert bitstream.sniff(b'\x82\x49\x83\x42') == ''
    assert bitstream.sniff(b'') == ''


@pytest.mark.parametrize('codec', ['mpeg2video', 'mpeg4'])
def test_b_pictures_of_mpeg_are_told_from_the_others(rng, codec):
    context = av.CodecContext.create(codec, 'w')
    configure(context, Encoding('mpeg2video', 2, 12), 256, 192, Fraction(25))
    packets = []
    for i, image in enumerate([*pictures.sliding(rng, 9, (2, 1)), None]):
        frame = None
        if image is not None:
            frame = av.VideoFrame.from_ndarray(image, 'gray').reformat(format='yuv420p')
            frame.pts = i
        packets += [(packet.pts, bytes(packet)) for packet in context.encode(frame)]
    reader = places.places_of(codec, bitstream.Headers(), bytes(context.extradata or b''))
    b_pictures = sorted(pts for pts, data in packets if not reader.read(data).is_reference)
    assert b_pictures == [1, 2, 4, 5, 7] or b_pictures == [1, 2, 4, 5, 7, 8][:len(b_pictures)]
