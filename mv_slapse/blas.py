"""One BLAS thread while the core counts, whatever the program around it has asked for.

With several threads the BLAS library shares a product out among them, and the last bits of its
sums depend on how many there are: among planes that fit equally well another one is then chosen.
Matrices here are small, so that threads cost more than they bring (ten times the CPU was
measured). An environment variable comes too late where numpy is loaded before this package, and
threadpoolctl obeys only the first thread of a program that sets a number, which need not be ours.
"""

from collections.abc import Callable
import ctypes
from functools import wraps
from itertools import product
from threading import Lock
from typing import NamedTuple

import numpy as np

#: functions that set and tell the number, of OpenBLAS as its builds name them, MKL and BLIS
FUNCTIONS = (*((f'{before}openblas_set_num_threads{after}',
                f'{before}openblas_get_num_threads{after}')
               for before, after in product(('', 'scipy_'), ('', '64_', '_64'))),
             ('MKL_Set_Num_Threads', 'MKL_Get_Max_Threads'),
             ('bli_thread_set_num_threads', 'bli_thread_get_num_threads'))


class Library(NamedTuple):
    """A BLAS library of this process: the functions for its number of threads."""

    set_threads: Callable[[int], None]
    threads: Callable[[], int]


def libraries() -> list[Library]:
    """Return the BLAS library of numpy; none where it cannot be told a number."""
    # A look-up in a module's handle goes through the libraries that the module links.
    handle = ctypes.CDLL(np.linalg._umath_linalg.__file__)
    return [Library(getattr(handle, set_), getattr(handle, get)) for set_, get in FUNCTIONS
            if hasattr(handle, set_) and hasattr(handle, get)]


class _Limit:
    """A context within which the BLAS libraries of this process run one thread.

    The number of threads belongs to the process. So the last one out gives the program the number
    back that the first one in found: contexts may lie in one another, and several threads of the
    program may be within one at a time.
    """

    def __init__(self):
        self._libraries = libraries()
        self._lock = Lock()
        self._entered = 0
        self._before: list[int] = []

    def __enter__(self):
        """Set one thread, unless another context has done so."""
        with self._lock:
            if not self._entered:
                self._before = [library.threads() for library in self._libraries]
                for library in self._libraries:
                    library.set_threads(1)
            self._entered += 1

    def __exit__(self, *_):
        """Set what was there before, unless another context is still entered."""
        with self._lock:
            self._entered -= 1
            if not self._entered:
                for library, threads in zip(self._libraries, self._before, strict=True):
                    library.set_threads(threads)


_LIMIT = _Limit()


def one_thread(verb: Callable) -> Callable:
    """Return a function that does the same with one BLAS thread, and then restores the number."""
    @wraps(verb)
    def limited(*args, **kwargs):
        """Do it within the limit."""
        with _LIMIT:
            return verb(*args, **kwargs)
    return limited
