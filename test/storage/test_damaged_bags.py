"""Bags that are cut, flipped, or made to fill the memory: one kind of error each."""

import shutil
from struct import pack

import bounded
import lz4.frame
from mv_slapse import fields
from mv_slapse.codec.packet import Packet
from mv_slapse.errors import UnusableInput
from mv_slapse.geometry.camera import Camera
from mv_slapse.storage import bounded as limits
from mv_slapse.storage.bag_reader import BagReader
from mv_slapse.storage.bag_writer import BagWriter
from mv_slapse.video_messages import FFMPEG_PACKET, packet_to_fields
import numpy as np
import pytest
import zstandard

TOPIC = '/camera/image/ffmpeg'
CAMERA = Camera(64, 48, np.array([[50.0, 0, 32], [0, 50, 24], [0, 0, 1]]))
LARGE = 1 << 28


def write_bag(path, compressed):
    rng = np.random.default_rng(0)
    with BagWriter(path, compressed) as writer:
        writer.write('/camera/camera_info', 'sensor_msgs/msg/CameraInfo',
                     fields.camera_to_fields(CAMERA, 0, 'eye'), 0, latched=True)
        for k in range(8):
            packet = Packet(b'\x00\x00\x01\x00\x00\x08' + rng.bytes(200), k, k == 0, 'mpeg2video')
            writer.write(TOPIC, FFMPEG_PACKET, packet_to_fields(packet, (64, 48), k, 'eye'), k)
    return path


@pytest.fixture(scope='module', params=[False, True], ids=['plain', 'zstd'])
def bag(request, tmp_path_factory):
    return write_bag(tmp_path_factory.mktemp('bag') / 'bag', request.param)


def read(path):
    """Return how many packets are read, or the error."""
    try:
        reader = BagReader(path)
        reader.camera(reader.video_topic())
        return sum(1 for _ in reader.packets(reader.video_topic()))
    except UnusableInput as error:
        return error


@pytest.mark.parametrize('name', ['bag.mcap', 'metadata.yaml'])
@pytest.mark.parametrize('how', ['cut', 'flipped', 'zeros'])
def test_a_damaged_bag_is_read_as_far_as_it_goes_or_refused(bag, tmp_path, name, how):
    whole = (bag / name).read_bytes()
    rng = np.random.default_rng(1)
    for _ in range(12):
        shutil.rmtree(tmp_path / 'bag', ignore_errors=True)
        shutil.copytree(bag, tmp_path / 'bag')
        at = int(rng.integers(len(whole)))
        content = bytearray(whole)
        if how == 'cut':
            content = content[:at]
        elif how == 'zeros':
            content[at:at + 64] = bytes(len(content[at:at + 64]))
        else:
            content[at] ^= 1 << rng.integers(8)
        (tmp_path / 'bag' / name).write_bytes(content)
        read(tmp_path / 'bag')
        if name == 'bag.mcap':
            read(tmp_path / 'bag' / name)


def record(code, content):
    return pack('<BQ', code, len(content)) + content


def text(value):
    return pack('<I', len(value)) + value.encode()


def bomb(compression, honest):
    """Return an MCAP file of some kilobytes with a chunk of a quarter of a gigabyte."""
    data = {'zstd': lambda: zstandard.compress(bytes(LARGE)),
            'lz4': lambda: lz4.frame.compress(bytes(LARGE))}[compression]()
    size = LARGE if honest else 1 << 16
    chunk = pack('<QQQI', 0, 1, size, 0) + text(compression) + pack('<Q', len(data)) + data
    body = b'\x89MCAP0\r\n' + record(1, text('ros2') + text('')) + record(6, chunk)
    return body + record(2, bytes(20)) + b'\x89MCAP0\r\n'


@pytest.mark.parametrize('compression', ['zstd', 'lz4'])
@pytest.mark.parametrize('honest', [True, False])
@pytest.mark.parametrize('cut', [True, False])
def test_a_chunk_that_would_fill_the_memory_is_refused(tmp_path, compression, honest, cut):
    content = bomb(compression, honest)
    (tmp_path / 'a.mcap').write_bytes(content[:-20] if cut else content)
    del content
    with bounded.refusal():
        assert isinstance(read(tmp_path / 'a.mcap'), UnusableInput)


def test_a_compressed_file_that_would_fill_the_disk_is_refused(tmp_path, monkeypatch):
    monkeypatch.setattr(limits, 'LARGEST', 1 << 20)
    folder = write_bag(tmp_path / 'bag', False)
    with (folder / 'bag.mcap').open('ab') as file:
        file.truncate(1 << 26)
    packed = zstandard.compress((folder / 'bag.mcap').read_bytes())
    (folder / 'bag.mcap').unlink()
    (folder / 'bag.mcap.zstd').write_bytes(packed)
    metadata = (folder / 'metadata.yaml').read_text()
    metadata = metadata.replace('bag.mcap', 'bag.mcap.zstd').replace(
        "compression_format: ''", 'compression_format: zstd').replace(
        "compression_mode: ''", 'compression_mode: FILE')
    (folder / 'metadata.yaml').write_text(metadata)
    assert 'times' in str(read(folder))


def test_metadata_with_aliases_is_refused(bag, tmp_path):
    shutil.copytree(bag, tmp_path / 'bag')
    (tmp_path / 'bag' / 'metadata.yaml').write_text('a: &a [x]\nb: [*a, *a]\n')
    reader = read(tmp_path / 'bag')
    assert reader == 8 or 'aliases' in str(reader)
