"""A camera of the network that is not there yet, breaks off, and comes back."""

from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
import os
from pathlib import Path
from threading import Thread
import time

import pytest

pytest.importorskip('rclpy')

import av  # noqa: E402
from mv_slapse import fields  # noqa: E402
from mv_slapse.codec import source  # noqa: E402
from mv_slapse.codec.encoding.encoder import LOW_LATENCY, write_video  # noqa: E402
from mv_slapse.nodes.decoder import DecoderNode  # noqa: E402
from mv_slapse.records import SegmentKind  # noqa: E402
from mv_slapse.storage.camera_info import write_camera  # noqa: E402
from mv_slapse_msgs.msg import Correspondences  # noqa: E402
from nodes import clips, network  # noqa: E402
from nodes.bench import messages_of, value_of  # noqa: E402
from nodes.conditions import state  # noqa: E402
from nodes.network import free_port  # noqa: E402

CAMERAS = {'tcp': network.camera, 'rtsp': network.rtsp_camera}


@pytest.fixture
def stream(tmp_path) -> bytes:
    write_video(tmp_path / 'clip.ts', clips.pictures(), clips.FPS, LOW_LATENCY)
    write_camera(tmp_path / 'camera.yaml', fields.camera_from_message(clips.camera_info()))
    return (tmp_path / 'clip.ts').read_bytes()


@pytest.mark.parametrize(('protocol', 'origin'), [
    ('tcp', 'clock'), ('tcp', 'stream'), ('rtsp', 'clock')])
def test_a_camera_that_comes_late_and_breaks_off_is_opened_again(bench, tmp_path, stream, protocol,
                                                                 origin):
    port, camera = free_port(), CAMERAS[protocol]
    received = bench.listen(Correspondences, 'correspondences')
    node = bench.start(DecoderNode, source=f'{protocol}://127.0.0.1:{port}', stamp_origin=origin,
                       camera_info_url=str(tmp_path / 'camera.yaml'))
    assert bench.spin(lambda: 'it is opened again in' in messages_of(node), 10)
    with camera(port, stream, 2) as thread:
        assert bench.spin(lambda: not thread.is_alive(), 40)
    assert bench.spin(lambda: [msg for msg in received if msg.kind == SegmentKind.BROKEN], 20)
    bench.spin(lambda: False, 0.5)
    stamps = [fields.stamp_from_message(msg.header.stamp) for msg in received]
    assert stamps == sorted(stamps)
    broken = [i for i, msg in enumerate(received) if msg.kind == SegmentKind.BROKEN]
    assert len(broken) == 1
    assert received[broken[0]].reason == 'the source broke off'
    # As many before as after, each joined to the one before.
    assert broken[0] == len(received) - 1 - broken[0] >= 3
    before = [fields.stamp_from_message(msg.previous_stamp) for msg in received]
    assert before[1:] == stamps[:-1]
    assert bench.spin(lambda: 'it is opened again in' in messages_of(node), 10)


def test_a_camera_of_this_machine_that_is_not_there_is_waited_for(bench, stream, tmp_path):
    node = bench.start(DecoderNode, source='/dev/video99',
                       camera_info_url=str(tmp_path / 'camera.yaml'))
    for wait in ('0.5', '1', '2'):
        assert bench.spin(lambda wait=wait: f'/dev/video99: no such file; check the path; it is '
                          f'opened again in {wait} s' in messages_of(node), 10)
    assert value_of(node, 'condition') == 'unreachable'


@pytest.fixture
def device():
    """A device that does not exist yet: its driver is a FIFO, as no test has a camera."""
    path = Path('/dev/shm') / f'mv_slapse_camera_{os.getpid()}'
    yield path
    path.unlink(missing_ok=True)


@pytest.mark.skipif(not os.access('/dev/shm', os.W_OK), reason='no place for a FIFO below /dev')
def test_a_camera_of_this_machine_that_comes_late_and_is_unplugged_is_opened_again(
        bench, tmp_path, stream, device):
    received = bench.listen(Correspondences, 'correspondences')
    node = bench.start(DecoderNode, source=str(device),
                       camera_info_url=str(tmp_path / 'camera.yaml'))
    assert bench.spin(lambda: 'no such file; check the path; it is opened again in'
                      in messages_of(node), 10)
    counts = []
    for _ in range(2):
        os.mkfifo(device)
        driver = Thread(target=device.write_bytes, args=(stream,), daemon=True)
        driver.start()
        assert bench.spin(lambda driver=driver: not driver.is_alive(), 20)
        device.unlink()
        assert bench.spin(lambda: 'it is opened again in' in messages_of(node), 20)
        assert value_of(node, 'condition') == 'unreachable'
        bench.spin(lambda: False, 0.5)
        counts.append(len(received))
    broken = [msg.reason for msg in received if msg.kind == SegmentKind.BROKEN]
    assert broken == ['the source broke off']
    assert counts[1] == 2 * counts[0] + 1 > 6


@pytest.mark.parametrize('protocol', ['tcp', 'rtsp'])
def test_a_stream_that_falls_silent_is_opened_again(bench, tmp_path, stream, monkeypatch,
                                                    protocol):
    monkeypatch.setattr(source, 'PATIENCE', 1.0)
    port = free_port()
    received = bench.listen(Correspondences, 'correspondences')
    node = bench.start(DecoderNode, source=f'{protocol}://127.0.0.1:{port}',
                       camera_info_url=str(tmp_path / 'camera.yaml'))
    with CAMERAS[protocol](port, stream, 1, held=30.0):
        assert bench.spin(lambda: received, 10)
        assert bench.spin(lambda: value_of(node, 'condition') == 'unreachable', 10)
    assert messages_of(node).count('it is opened again in') == 1


def test_a_device_that_is_no_camera_is_told_as_one(bench, tmp_path, stream):
    node = bench.start(DecoderNode, source='/dev/null',
                       camera_info_url=str(tmp_path / 'camera.yaml'))
    assert bench.spin(lambda: value_of(node, 'condition') == 'unreachable', 10)
    assert '/dev/null cannot be opened as a video' in messages_of(node)


def test_a_file_by_http_lasts_as_long_as_it_shows(bench, tmp_path):
    write_video(tmp_path / 'clip.mp4', clips.pictures(), clips.FPS)
    write_camera(tmp_path / 'camera.yaml', fields.camera_from_message(clips.camera_info()))
    handler = partial(SimpleHTTPRequestHandler, directory=str(tmp_path))
    with ThreadingHTTPServer(('127.0.0.1', 0), handler) as server:
        Thread(target=server.serve_forever, daemon=True).start()
        begin = time.monotonic()
        node = bench.start(
            DecoderNode, source=f'http://127.0.0.1:{server.server_port}/clip.mp4',
            source_rate=2.0, max_latency=0.5, camera_info_url=str(tmp_path / 'camera.yaml'))
        assert bench.spin(lambda: state(node) == 'ended', 20)
        server.shutdown()
    last = (len(clips.pictures()) - 1) / clips.FPS
    assert time.monotonic() - begin > 0.9 * last / 2
    assert not value_of(node, 'packets dropped by overload')


def test_a_stream_without_vectors_from_the_network_is_encoded_again(bench, tmp_path, stream):
    port, images = free_port(), clips.pictures()
    with av.open(str(tmp_path / 'hevc.ts'), 'w') as container:
        video = container.add_stream('libx265', rate=round(clips.FPS))
        video.width, video.height = clips.SIZE
        video.pix_fmt = 'yuv420p'
        video.options = {'x265-params': 'log-level=none:bframes=0', 'preset': 'ultrafast'}
        for image in images:
            container.mux(video.encode(av.VideoFrame.from_ndarray(image, 'gray').reformat(
                format='yuv420p')))
        container.mux(video.encode(None))
    received = bench.listen(Correspondences, 'correspondences')
    node = bench.start(DecoderNode, source=f'tcp://127.0.0.1:{port}',
                       camera_info_url=str(tmp_path / 'camera.yaml'))
    with network.camera(port, (tmp_path / 'hevc.ts').read_bytes(), held=3.0):
        assert bench.spin(lambda: received, 20)
    assert value_of(node, 'encoded again') == 'hevc'
