from dataclasses import replace

import cv2
from mv_slapse.codec import decoder, evidence
from mv_slapse.codec.decoder import CorrespondenceDecoder
from mv_slapse.codec.encoding.encoder import encode, Encoding, LOW_LATENCY
from mv_slapse.codec.segments import NOT_STAMPED
from mv_slapse.config import DecoderSettings
from mv_slapse.geometry.camera import Camera
from mv_slapse.records import SegmentKind
import numpy as np
import pictures
import pytest
from reliability import clips

MPEG2 = Encoding('mpeg2video', 3, 12)
EACH = DecoderSettings(max_chain=1)
ENCODINGS = [MPEG2, LOW_LATENCY, Encoding('h264', 2, 12)]
STEP = (5, -3)


def decoded(packets, settings=EACH):
    live = CorrespondenceDecoder(settings)
    return [pair for packet in packets for pair in live.feed(packet)] + live.flush()


def packets(rng, encoding, n=15):
    return list(encode(pictures.sliding(rng, n, STEP), 25, encoding))


@pytest.mark.parametrize('encoding', ENCODINGS)
@pytest.mark.parametrize('settings', [EACH, DecoderSettings(), DecoderSettings(split_flow=0.0)])
def test_correspondences_are_the_motion_of_the_pictures(rng, encoding, settings):
    pairs = decoded(packets(rng, encoding), settings)
    for pair in pairs:
        frames = (pair.stamp - pair.previous_stamp) / 40_000_000
        error = np.abs(pair.x_prev - pair.x_cur - np.multiply(STEP, frames)).max(axis=1)
        assert len(pair) > 20
        assert (error < 1).mean() > 0.9
    assert pairs[0].previous_stamp == 0
    assert pairs[-1].stamp == 14 * 40_000_000
    assert all(a.stamp == b.previous_stamp for a, b in zip(pairs, pairs[1:], strict=False))


def test_a_slow_motion_is_not_too_long_with_several_reference_pictures(rng):
    # x264 takes vectors from older pictures here: 0.4 times too long in the mean.
    way = np.array([0.4, 0.1])
    shown = cv2.GaussianBlur(pictures.texture(rng)[:240, :320], (0, 0), 2)
    noisy = (pictures.moved(shown, k * way) + rng.normal(0, 2, shown.shape) for k in range(15))
    images = (np.repeat(np.clip(one, 0, 255).astype(np.uint8)[..., None], 3, 2) for one in noisy)
    coded = encode(images, 25, Encoding('h264', 0, 250, {'x264-params': 'ref=3:threads=1'}))
    pairs = decoded(coded)[3:]
    vectors = np.concatenate([pair.x_cur - pair.x_prev for pair in pairs])
    assert len(vectors) > 200 * len(pairs)
    np.testing.assert_allclose(vectors.mean(axis=0), way, atol=0.1)


def test_columns_are_float32_and_of_one_length(rng):
    pair = decoded(packets(rng, MPEG2))[1]
    for name in ('x_cur', 'x_prev', 'sigma', 'probability'):
        column = getattr(pair, name)
        assert column.dtype == np.float32
        assert len(column) == len(pair)
    assert pair.block.dtype == np.uint8
    assert pair.block.shape == (len(pair), 2)


def test_kinds_follow_the_key_frames(rng):
    kinds = [pair.kind.name for pair in decoded(packets(rng, MPEG2, 17),
                                                replace(EACH, split_flow=1e6))]
    assert kinds == ['IP', 'PP', 'PI', 'IP']


@pytest.mark.parametrize(('parallax', 'frames'), [(0.0, 2), (4.0, 4)])
def test_a_segment_is_halved_only_where_each_half_has_parallax_of_its_own(rng, parallax, frames):
    settings = replace(EACH, min_parallax=parallax, split_share=0.0)
    pair = decoded(packets(rng, MPEG2), settings)[0]
    assert pair.stamp == frames * 40_000_000


@pytest.mark.parametrize(('focal', 'frames'), [(300.0, 2), (500.0, 2), (800.0, 4)])
def test_a_longer_lens_may_see_more_pixels_of_motion_before_a_segment_is_halved(
        rng, focal, frames):
    camera = Camera(320, 240, np.diag([focal, focal, 1.0]))
    live = CorrespondenceDecoder(replace(EACH, min_parallax=0.0, split_share=0.0), camera)
    pairs = [pair for packet in packets(rng, MPEG2) for pair in live.feed(packet)]
    assert pairs[0].stamp == frames * 40_000_000  # of 5.8 px each


@pytest.mark.parametrize(('longest', 'frames'), [(0.15, 2), (0.17, 4)])
def test_a_segment_longer_than_any_chain_is_halved_however_short_its_vectors(rng, longest, frames):
    settings = replace(EACH, max_chain_time=longest, split_flow=1e6, min_parallax=1e6)
    pair = decoded(packets(rng, MPEG2), settings)[0]
    assert pair.stamp == frames * 40_000_000


def test_a_long_segment_stays_whole_where_its_b_frames_have_vectors_to_one_side_only(
        rng, monkeypatch):
    def one_sided(segment, settings):
        first, second = evidence.halves(segment, settings)
        blind = {name: getattr(second.current, name)[:0]
                 for name in ('x', 'displacement', 'direction', 'block')}
        return first, replace(second, current=replace(second.current, **blind))

    monkeypatch.setattr(decoder, 'halves', one_sided)
    pair = decoded(packets(rng, MPEG2), replace(EACH, max_chain_time=0.15))[0]
    assert (pair.stamp, len(pair) > 20) == (4 * 40_000_000, True)


def test_an_i_frame_without_b_frames_is_bridged_or_broken(rng):
    coded = packets(rng, Encoding('h264', 0, 6), 14)
    bridged = decoded(coded)
    assert all(pair.kind is not SegmentKind.BROKEN for pair in bridged)
    assert np.median(np.abs(bridged[5].x_prev - bridged[5].x_cur - STEP)) < 0.1
    broken = decoded(coded, replace(EACH, bridge_intra=False))[5]
    assert (broken.kind, len(broken)) == (SegmentKind.BROKEN, 0)
    assert 'I frame' in broken.reason


def test_a_lost_packet_breaks_one_pair_with_a_reason(rng):
    coded = packets(rng, LOW_LATENCY)
    broken = [pair for pair in decoded(coded[:6] + coded[7:])
              if pair.kind is SegmentKind.BROKEN]
    assert [(pair.previous_stamp, pair.stamp) for pair in broken] == [(200_000_000, 280_000_000)]
    assert 'lost' in broken[0].reason


@pytest.mark.parametrize('lost', [range(4, 6), range(1, 6)])
def test_an_i_frame_after_a_loss_is_not_bridged(rng, lost):
    coded = packets(rng, Encoding('h264', 0, 6), 24)
    lost = [i + 12 for i in lost]
    broken = [pair for pair in decoded([p for i, p in enumerate(coded) if i not in lost])
              if pair.kind is SegmentKind.BROKEN]
    assert [(pair.previous_stamp, pair.stamp) for pair in broken] == [
        (40_000_000 * (lost[0] - 1), 40_000_000 * (lost[-1] + 1))]


def test_an_i_frame_behind_a_lost_b_frame_is_not_bridged(rng):
    """Both key pictures are whole, but who can say what else was lost with the B frame?"""
    coded = packets(rng, Encoding('mpeg2video', 2, 6), 24)
    keys = sorted(packet.stamp for packet in coded if packet.is_key)
    lost, step = keys[1] - 2 * 40_000_000, 40_000_000
    broken = [pair for pair in decoded([p for p in coded if p.stamp != lost])
              if pair.kind is SegmentKind.BROKEN]
    assert [(pair.previous_stamp, pair.stamp) for pair in broken] == [(lost - step, keys[1])]


@pytest.mark.parametrize('back', [10_000_000_000, 0])
def test_a_clock_that_is_set_back_breaks_one_pair_also_at_an_i_frame(rng, back):
    coded = packets(rng, Encoding('h264', 0, 6), 12)
    coded = [replace(packet, stamp=packet.stamp + 10_000_000_000 - (
        back or 40_000_000) * (i > 5)) for i, packet in enumerate(coded)]
    pairs = decoded(coded)
    assert [pair.reason for pair in pairs] == [
        *[''] * 5, NOT_STAMPED, *[''] * 5]
    assert 'stamp each with its own time' in NOT_STAMPED


@pytest.mark.parametrize('apart', [1, 99_999])
def test_pictures_that_are_no_time_apart_break_a_pair(rng, apart):
    coded = packets(rng, LOW_LATENCY, 12)
    at = coded[5].stamp + apart
    coded[6] = replace(coded[6], stamp=at)
    broken = [pair for pair in decoded(coded) if pair.kind is SegmentKind.BROKEN]
    assert [pair.stamp for pair in broken][:1] == [at]


def test_a_change_of_size_breaks_one_pair(rng):
    wide = encode(pictures.sliding(rng, 5, STEP, (320, 192)), 25, LOW_LATENCY)
    coded = packets(rng, LOW_LATENCY, 5) + [
        replace(packet, stamp=packet.stamp + 200_000_000) for packet in wide]
    pairs = decoded(coded)
    assert [pair.kind is SegmentKind.BROKEN for pair in pairs] == [False] * 4 + [True] + [
        False] * 4
    assert [pair.width for pair in pairs] == [256] * 4 + [320] * 5


@pytest.mark.parametrize('encoding', ENCODINGS)
def test_damaged_packets_never_raise(rng, encoding):
    coded = packets(rng, encoding)
    for i in rng.choice(np.arange(1, 15), 5, replace=False):
        payload = bytearray(coded[i].data)
        for at in rng.integers(0, len(payload), 20):
            payload[at] ^= 1 << rng.integers(0, 8)
        coded[i] = replace(coded[i], data=bytes(payload[:rng.integers(1, len(payload))]))
    assert len(decoded(coded)) >= 1


def test_noise_from_the_start_gives_nothing_and_no_exception(rng):
    noise = [replace(packet, data=rng.bytes(400)) for packet in packets(rng, LOW_LATENCY, 4)]
    assert decoded(noise) == []


@pytest.mark.parametrize('encoding', ENCODINGS)
def test_two_runs_give_the_same_correspondences(rng, encoding):
    coded = packets(rng, encoding)
    for one, other in zip(decoded(coded), decoded(coded), strict=True):
        for name in ('x_cur', 'x_prev', 'sigma'):
            np.testing.assert_array_equal(getattr(one, name), getattr(other, name))


def test_still_pictures_give_zero_vectors_at_a_bounded_interval(rng):
    still = [pictures.sliding(rng, 1, (0, 0))[0]] * 31
    pairs = decoded(encode(still, 30, LOW_LATENCY), DecoderSettings())
    assert max(pair.stamp - pair.previous_stamp for pair in pairs) <= 250_000_000
    assert all(np.median(np.abs(pair.x_prev - pair.x_cur)) < 0.01 for pair in pairs)


@pytest.mark.parametrize('b_frames', [0, 2])
def test_zero_vectors_between_changing_pictures_are_no_standstill(rng, b_frames):
    no_search = Encoding('mpeg2video', b_frames, 12, {'motion_est': 'zero',
                                                      'sc_threshold': '1000000000'})
    for pair in decoded(packets(rng, no_search, 13)):
        frames = (pair.stamp - pair.previous_stamp) / 40_000_000
        assert len(pair) > 100
        off = pair.x_prev - pair.x_cur - np.multiply(STEP, frames)
        assert np.median(np.abs(off)) < 0.1
    blind = decoded(packets(rng, no_search, 13), replace(EACH, bridge_intra=False))
    assert not any((pair.x_cur - pair.x_prev).any() for pair in blind)


@pytest.mark.parametrize('b_frames', [1, 2, 3])
def test_b_frames_without_vectors_of_their_own_do_not_say_that_nothing_moves(b_frames):
    pairs = decoded(clips.drawn(clips.Kind('mpeg4', 'mpeg4', b_frames, 12), 30))
    assert sum(map(len, pairs)) > 50 * len(pairs)
    for pair in pairs:
        frames = (pair.stamp - pair.previous_stamp) / 40_000_000
        off = pair.x_prev - pair.x_cur - np.multiply((2, 1), frames)
        assert np.median(np.abs(off)) < 0.5


@pytest.mark.parametrize(('poor', 'bridge', 'kinds'), [
    (0.5, True, ['IP', 'PP', 'PI', 'IP']), (10.0, True, ['IP', 'PP', 'PP', 'IP']),
    (10.0, False, ['IP', 'PP', 'PI', 'IP'])])
def test_an_i_frame_whose_b_frames_tell_too_little_is_searched(rng, monkeypatch, poor, bridge,
                                                               kinds):
    monkeypatch.setattr(decoder, 'POOR', poor)
    pairs = decoded(packets(rng, MPEG2, 17), replace(EACH, split_flow=1e6, bridge_intra=bridge))
    assert [pair.kind.name for pair in pairs] == kinds
    frames = (pairs[2].stamp - pairs[2].previous_stamp) / 40_000_000
    off = pairs[2].x_prev - pairs[2].x_cur - np.multiply(STEP, frames)
    assert np.median(np.abs(off)) < 0.5


def test_halves_of_a_segment_stay_where_its_i_frame_is_not_found(rng, monkeypatch):
    monkeypatch.setattr(decoder, 'POOR', 10.0)
    merged = CorrespondenceDecoder._merged

    def in_halves(self, segment):
        pair, = merged(self, segment)
        middle = (pair.stamp + pair.previous_stamp) // 2
        return [replace(pair, stamp=middle), replace(pair, previous_stamp=middle)]

    monkeypatch.setattr(CorrespondenceDecoder, '_merged', in_halves)
    pairs = decoded(packets(rng, MPEG2, 17), replace(EACH, split_flow=1e6, bridge_intra=False))
    assert [pair.previous_stamp for pair in pairs[1:]] == [pair.stamp for pair in pairs[:-1]]
    assert len(pairs) == 8


@pytest.mark.parametrize('encoding', ENCODINGS)
def test_the_probability_of_a_vector_follows_the_stream(rng, encoding):
    pairs = decoded(packets(rng, encoding, 40), replace(EACH, lone_probability=0.0,
                                                        match_probability=0.1))
    first, last = pairs[0].probability.mean(), pairs[-1].probability.mean()
    assert last > first
    assert last > 0.7


@pytest.mark.parametrize('noise', [0.0, 2.0])
@pytest.mark.parametrize('encoding', ENCODINGS)
def test_a_picture_that_shows_nothing_tells_no_motion(rng, encoding, noise):
    seen = pictures.sliding(rng, 12, STEP)
    blank = [np.clip(16 + rng.normal(0, noise, seen[0].shape), 0, 255).astype(np.uint8)
             for _ in range(12)]
    pairs = decoded(list(encode([*seen, *blank], 25, encoding)), EACH)
    dark = [pair for pair in pairs if pair.stamp > 480_000_000]
    assert len(dark) >= 3
    for pair in dark:
        assert pair.kind is SegmentKind.BROKEN
        assert 'a covered lens, darkness or fog' in pair.reason
    assert all(pair.kind is not SegmentKind.BROKEN for pair in pairs if pair.stamp < 400_000_000)
