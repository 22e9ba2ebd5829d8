"""The heap of a process that may run for days."""

from contextlib import suppress
import ctypes

# Of glibc's <malloc.h>: sizes of free memory at the heap's end, and of a block, that go back.
M_TRIM_THRESHOLD, M_MMAP_THRESHOLD = -1, -3
THRESHOLD = 1 << 16  # bytes: smaller ones leave holes of 4 MB in all, those up to 256 KiB of 6 MB,
# and with 1 MiB at the end a node's memory swings by 3 MB from minute to minute


def give_back_large_blocks():
    """Have large blocks given back to the system, whatever was freed before.

    glibc raises its threshold for blocks of their own to the largest that was freed. Blocks of a
    megabyte then lie in the heap among small ones that stay, and it grows by MB an hour. It costs
    2 % of the time. Other C libraries have no such threshold, and nothing is done.
    """
    with suppress(AttributeError, OSError):
        for setting in (M_MMAP_THRESHOLD, M_TRIM_THRESHOLD):
            ctypes.CDLL(None).mallopt(setting, THRESHOLD)


def give_back_free_pages():
    """Give the system back what is free between blocks that stay.

    Where a run makes and drops arrays of all sizes for hours, such pages become more by a MB an
    hour. Other C libraries than glibc cannot, and nothing is done.
    """
    with suppress(AttributeError, OSError):
        ctypes.CDLL(None).malloc_trim(0)
