"""The heap of a process that may run for days."""

from contextlib import suppress
import ctypes

# Of glibc's <malloc.h>: sizes [bytes] from which free memory at the heap's end, and a block, go
# back. What went back is mapped again by page faults: 230 for each frame of 640x480 with 64 KiB
# for both, which was a twentieth of a node's time, 50 with these. Smaller blocks leave holes
# of 6 MB in all, those below 64 KiB of 4 MB.
M_TRIM_THRESHOLD, M_MMAP_THRESHOLD = -1, -3
THRESHOLDS = {M_TRIM_THRESHOLD: 1 << 20, M_MMAP_THRESHOLD: 1 << 18}


def give_back_large_blocks():
    """Have large blocks given back to the system, whatever was freed before.

    glibc raises its threshold for blocks of their own to the largest that was freed. Blocks of a
    megabyte then lie in the heap among small ones that stay, and it grows by MB an hour. Other C
    libraries have no such threshold, and nothing is done.
    """
    with suppress(AttributeError, OSError):
        for setting, size in THRESHOLDS.items():
            ctypes.CDLL(None).mallopt(setting, size)


def give_back_free_pages():
    """Give the system back what is free between blocks that stay.

    Where a run makes and drops arrays of all sizes for hours, such pages become more by a MB an
    hour. Other C libraries than glibc cannot, and nothing is done.
    """
    with suppress(AttributeError, OSError):
        ctypes.CDLL(None).malloc_trim(0)
