"""The heap of a long run."""

import os
import subprocess
import sys

import pytest

# Blocks of a megabyte that are freed, then others with something small behind each that stays.
PROGRAM = """
import ctypes, sys
from mv_slapse.heap import give_back_large_blocks
libc = ctypes.CDLL(None)
libc.malloc.restype = ctypes.c_void_p
libc.free.argtypes = [ctypes.c_void_p]
if sys.argv[1] == 'set':
    give_back_large_blocks()
def held():
    return int(open('/proc/self/statm').read().split()[1]) * 4096 / 1e6
def touched(size):
    block = libc.malloc(ctypes.c_size_t(size))
    ctypes.memset(block, 1, size)
    return block
libc.free(touched(20_000_000))
before = held()
blocks = []
for _ in range(50):
    blocks.append(touched(1_000_000))
    touched(1000)
for block in blocks:
    libc.free(block)
print(held() - before)
"""


@pytest.mark.skipif(not sys.platform.startswith('linux'), reason='reads /proc')
def test_large_blocks_go_back_to_the_system():
    def grown(how):
        """Return by how much such a program grows [MB]."""
        return float(subprocess.run([sys.executable, '-c', PROGRAM, how], check=True, env=env,
                                    capture_output=True, text=True).stdout)

    # Dask sets thresholds for its workers, and leaves them behind.
    env = {name: value for name, value in os.environ.items() if not name.startswith('MALLOC_')}

    assert grown('set') < 0.5
    assert grown('not') > 20  # else the test does not test


# Pages that are free between blocks that stay.
BETWEEN = """
import ctypes, sys
from mv_slapse.heap import give_back_free_pages
def held():
    return int(open('/proc/self/statm').read().split()[1]) * 4096 / 1e6
libc = ctypes.CDLL(None)
libc.malloc.restype = ctypes.c_void_p
libc.free.argtypes = [ctypes.c_void_p]
blocks = [libc.malloc(ctypes.c_size_t(50_000)) for _ in range(800)]
for block in blocks:
    ctypes.memset(block, 1, 50_000)
for block in blocks[::2]:
    libc.free(block)
before = held()
give_back_free_pages()
print(before - held())
"""


@pytest.mark.skipif(not sys.platform.startswith('linux'), reason='reads /proc')
def test_pages_that_are_free_between_blocks_go_back_to_the_system():
    env = {name: value for name, value in os.environ.items() if not name.startswith('MALLOC_')}
    back = subprocess.run([sys.executable, '-c', BETWEEN], check=True, env=env,
                          capture_output=True, text=True).stdout
    assert float(back) > 15  # of 20 MB
