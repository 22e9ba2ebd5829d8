from fractions import Fraction
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
import os
from threading import Thread

import av
from mv_slapse.codec.encoding.encoder import Encoding, LOW_LATENCY, write_video
from mv_slapse.codec.source import open_source
from mv_slapse.errors import UnusableInput
import numpy as np
import pictures
import pytest


@pytest.fixture
def video(tmp_path, rng):
    path = tmp_path / 'video.mpg'
    write_video(path, pictures.sliding(rng, 14, (2, 1)), 25, Encoding('mpeg2video', 2, 12))
    return path


def test_the_first_picture_has_stamp_zero_and_b_frames_their_own(video):
    with open_source(video) as source:
        stamps = [packet.stamp for packet in source.packets()]
    assert stamps[:4] == [0, 120_000_000, 40_000_000, 80_000_000]


def test_codec_size_and_rate_are_told(video):
    with open_source(video) as source:
        assert (source.codec, source.width, source.height) == ('mpeg2video', 256, 192)
        assert source.fps == pytest.approx(25)


@pytest.mark.parametrize(('encoder', 'codec'), [('libsvtav1', 'av1'), ('libx265', 'hevc')])
def test_a_codec_has_its_own_name_not_that_of_its_decoder(tmp_path, rng, encoder, codec):
    with av.open(str(tmp_path / 'a.mkv'), 'w') as container:
        stream = container.add_stream(encoder, rate=25)
        stream.width, stream.height, stream.pix_fmt = 256, 192, 'yuv420p'
        stream.options = {'preset': '12'} if encoder == 'libsvtav1' else {
            'x265-params': 'log-level=none'}
        for image in pictures.sliding(rng, 3, (2, 1)):
            container.mux(stream.encode(av.VideoFrame.from_ndarray(image, 'gray').reformat(
                format='yuv420p')))
        container.mux(stream.encode(None))
    with open_source(tmp_path / 'a.mkv') as source:
        assert source.codec == codec


def test_a_file_without_times_gets_them_from_the_rate(tmp_path, rng):
    path = tmp_path / 'raw.h264'
    write_video(path, pictures.sliding(rng, 5, (2, 1)), 25, LOW_LATENCY)
    with open_source(path) as source:
        assert [packet.stamp for packet in source.packets()] == [
            i * 40_000_000 for i in range(5)]


def test_a_file_that_is_cut_off_is_played_as_far_as_it_goes(video, tmp_path):
    part = tmp_path / 'part.mpg'
    part.write_bytes(video.read_bytes()[:video.stat().st_size // 2])
    with open_source(part) as source:
        assert 3 < len(list(source.packets())) < 14


@pytest.mark.parametrize(('content', 'message'), [
    (None, 'no such file'), (b'', 'is empty'), (b'not a video at all' * 50, 'cannot be opened')])
def test_what_is_no_video_is_refused(tmp_path, content, message):
    path = tmp_path / 'input.mp4'
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(UnusableInput, match=message):
        open_source(path)


def test_a_directory_is_refused(tmp_path):
    with pytest.raises(UnusableInput, match='directory'):
        open_source(tmp_path)


@pytest.mark.parametrize('url', ['ftp://host/a.mp4', 'concat://a|b', 'data://x'])
def test_other_protocols_are_refused(url):
    with pytest.raises(UnusableInput, match='protocol'):
        open_source(url)


def encoded_as(path, codec, rng, options):
    with av.open(str(path), 'w') as container:
        stream = container.add_stream(codec, rate=Fraction(25))
        stream.width, stream.height, stream.pix_fmt = 256, 192, 'yuv420p'
        stream.codec_context.options = options
        for image in pictures.sliding(rng, 3, (2, 1)):
            container.mux(stream.encode(av.VideoFrame.from_ndarray(image, 'gray').reformat(
                format='yuv420p')))
        container.mux(stream.encode(None))
    return path


@pytest.mark.parametrize(('codec', 'name'), [('libx265', 'hevc'), ('libvpx-vp9', 'vp9')])
def test_a_codec_without_vectors_is_read(tmp_path, rng, codec, name):
    with open_source(encoded_as(tmp_path / 'video.mkv', codec, rng, {})) as source:
        assert source.codec == name
        assert len(list(source.packets())) == 3


def test_interlaced_video_is_refused(tmp_path, rng):
    path = encoded_as(tmp_path / 'video.mp4', 'libx264', rng, {'x264-params': 'tff=1'})
    with pytest.raises(UnusableInput, match='interlaced'):
        open_source(path)


def test_sound_alone_is_refused(tmp_path):
    path = tmp_path / 'sound.wav'
    path.write_bytes(b'RIFF\x2c\x00\x00\x00WAVEfmt \x10\x00\x00\x00\x01\x00\x01\x00'
                     b'\x40\x1f\x00\x00\x80\x3e\x00\x00\x02\x00\x10\x00data\x08\x00\x00\x00'
                     + bytes(8))
    with pytest.raises(UnusableInput, match='no video stream'):
        open_source(path)


def test_a_name_with_a_colon_is_no_protocol(tmp_path, monkeypatch, rng):
    monkeypatch.chdir(tmp_path)
    write_video(tmp_path / 'http:a.mp4', pictures.sliding(rng, 4, (2, 1)), 25, LOW_LATENCY)
    with open_source('http:a.mp4') as source:
        assert len(list(source.packets())) == 4


def test_a_fifo_without_a_writer_is_refused(tmp_path, monkeypatch):
    monkeypatch.setattr('mv_slapse.codec.source.PATIENCE', 0.1)
    os.mkfifo(tmp_path / 'fifo')
    with pytest.raises(UnusableInput, match='nobody has written'):
        open_source(tmp_path / 'fifo')


def test_a_fifo_is_read(tmp_path, rng):
    write_video(tmp_path / 'a.mpg', pictures.sliding(rng, 12, (2, 1)), 25)
    os.mkfifo(tmp_path / 'fifo')
    writer = Thread(daemon=True, target=lambda: (tmp_path / 'fifo').write_bytes(
        (tmp_path / 'a.mpg').read_bytes()))
    writer.start()
    with open_source(tmp_path / 'fifo') as source:
        assert len(list(source.packets())) == 12
    writer.join()


@pytest.mark.parametrize('name', ['x' * 5000, 'a\0b'])
def test_a_name_that_no_file_has_is_refused(name):
    with pytest.raises(UnusableInput, match='cannot be opened|no such file'):
        open_source(name)


def playlist(tmp_path, rng):
    write_video(tmp_path / 'a.ts', pictures.sliding(rng, 25, (2, 1)), 25)
    return ('#EXTM3U\n#EXT-X-VERSION:3\n#EXT-X-TARGETDURATION:1\n#EXTINF:1,\n'
            f'{(tmp_path / "a.ts").as_uri()}\n#EXT-X-ENDLIST\n')


def test_a_playlist_from_the_network_reads_no_file(tmp_path, rng):
    (tmp_path / 'a.m3u8').write_text(playlist(tmp_path, rng))
    handler = partial(SimpleHTTPRequestHandler, directory=str(tmp_path))
    with ThreadingHTTPServer(('127.0.0.1', 0), handler) as server:
        Thread(target=server.serve_forever, daemon=True).start()
        with pytest.raises(UnusableInput):
            open_source(f'http://127.0.0.1:{server.server_port}/a.m3u8')
        server.shutdown()
    with open_source(tmp_path / 'a.m3u8') as source:  # a file may read files
        assert len(list(source.packets())) > 10


def test_a_server_that_cannot_begin_at_the_pictures_is_told_of(tmp_path):
    # The pictures of an MP4 come before its index, and this server sends files from their start;
    # random ones, as FFmpeg keeps the newest 64 kB.
    images = np.random.default_rng(0).integers(0, 255, (12, 192, 256), np.uint8)
    write_video(tmp_path / 'a.mp4', images, 25, LOW_LATENCY)
    assert (tmp_path / 'a.mp4').stat().st_size > 200_000
    handler = partial(SimpleHTTPRequestHandler, directory=str(tmp_path))
    with ThreadingHTTPServer(('127.0.0.1', 0), handler) as server:
        Thread(target=server.serve_forever, daemon=True).start()
        with (open_source(f'http://127.0.0.1:{server.server_port}/a.mp4') as source,
              pytest.raises(UnusableInput, match='can its server begin anywhere')):
            list(source.packets())
        server.shutdown()


def test_a_camera_without_an_encoder_gives_its_jpeg(tmp_path, monkeypatch):
    with av.open(str(tmp_path / 'a.avi'), 'w') as container:
        stream = container.add_stream('mjpeg', rate=25)
        stream.width, stream.height, stream.pix_fmt = 64, 48, 'yuvj420p'
        container.mux(stream.encode(av.VideoFrame(64, 48, 'yuvj420p')))
        container.mux(stream.encode(None))
    asked, open_file = [], av.open

    def driver(name, format, options):
        asked.append((name, format, options['input_format']))
        if options['input_format'] == 'h264':
            raise av.error.FFmpegError(22, 'Invalid argument')
        return open_file(str(tmp_path / 'a.avi'))

    monkeypatch.setattr(av, 'open', driver)
    with open_source('/dev/null') as source:  # no machine for tests has a camera
        assert source.codec == 'mjpeg'
    assert asked == [('/dev/null', 'v4l2', 'h264'), ('/dev/null', 'v4l2', 'mjpeg')]
