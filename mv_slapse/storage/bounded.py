"""Bounds on what a bag may make of a few bytes, for rosbags and mcap decompress without any."""

from io import BytesIO, RawIOBase
from pathlib import Path
from typing import Any

import lz4.frame
from mcap.records import Chunk
from mv_slapse.errors import UnusableInput
from mv_slapse.storage import yaml_files
from rosbags.rosbag2 import reader, storage_mcap
import zstandard

LARGEST = 1 << 26  # bytes of a chunk or message; a picture of 4096x2160 in colour has 27 MB
SWELLING = 200  # times a compressed file may grow: video hardly does, text twentyfold
LARGEST_METADATA = 1 << 19  # bytes


def check_metadata(path: Path):
    """Refuse a metadata.yaml with aliases, or too large or deep, before rosbags reads it.

    Raises
    ------
    ValueError
        Saying what is wrong.
    """
    if (path / 'metadata.yaml').is_file():
        yaml_files.load(path / 'metadata.yaml', LARGEST_METADATA)


def uncompressed(chunk: Chunk) -> Chunk:
    """Return a chunk of mcap with its records uncompressed."""
    open_up = {'': lambda data, _: data, 'zstd': zstd, 'lz4': lz4_frames}[chunk.compression]
    chunk.data, chunk.compression = open_up(chunk.data, chunk.uncompressed_size), ''
    return chunk


def zstd(data: bytes, size: int = LARGEST) -> bytes:
    """Return Zstandard data uncompressed, ``size`` bytes at most."""
    _check(size)
    stream = zstandard.ZstdDecompressor().stream_reader(BytesIO(data), read_across_frames=True)
    return _checked(stream.read(size + 1), size)


def lz4_frames(data: bytes, size: int = LARGEST) -> bytes:
    """Return LZ4 data uncompressed, ``size`` bytes at most."""
    _check(size)
    return _checked(lz4.frame.LZ4FrameDecompressor().decompress(data, size + 1), size)


class _Zstd:
    """What rosbags uses of its module zstd, with bounds."""

    def __init__(self, module: Any):
        self._module = module

    def decompress(self, data: bytes) -> bytes:
        """Return the content of a compressed message."""
        return zstd(data)

    def open(self, file: Any, mode: str) -> '_Measured':
        """Return the content of a compressed file, as a file."""
        size = Path(file.name).stat().st_size
        return _Measured(self._module.open(file, mode), SWELLING * size + LARGEST)


class _Measured(RawIOBase):
    """A file that ends with an error where it is longer than it may be."""

    def __init__(self, file: Any, left: int):
        self._file, self._left = file, left

    def read(self, n: int = -1) -> bytes:
        """Read on."""
        data = self._file.read(n)
        self._left -= len(data)
        if self._left < 0:
            raise UnusableInput(f'a compressed file grows more than {SWELLING} times; no bag of '
                                'a robot does')
        return data

    def close(self):
        """Close the file."""
        self._file.close()
        super().close()


def _check(size: int):
    if size > LARGEST:
        raise UnusableInput(f'a compressed part of {size} bytes is larger than the {LARGEST} that '
                            'are allowed; record with smaller chunks')


def _checked(data: bytes, size: int) -> bytes:
    if len(data) > size:
        raise UnusableInput(f'a compressed part has more than the {size} bytes that it may have')
    return data


storage_mcap.DECOMPRESSORS.update({'zstd': zstd, 'lz4': lz4_frames})
reader.zstd = _Zstd(reader.zstd)
