"""One BLAS thread while the core counts, whatever the program around it has asked for.

With several threads the BLAS library shares a product out among them, and the last bits of its
sums depend on how many there are: among planes that fit equally well another one is then chosen.
Matrices here are small, so that threads cost more than they bring (ten times the CPU was
measured). An environment variable comes too late where numpy is loaded before this package.
"""

from collections.abc import Callable
from functools import wraps
from threading import Lock

import numpy as np  # noqa: F401 - what is to be limited has to be loaded
import scipy.linalg  # noqa: F401 - likewise: wheels of scipy bring a BLAS library of their own
from threadpoolctl import ThreadpoolController


class _Limit:
    """A context within which the BLAS libraries of this process run one thread.

    The number of threads belongs to the process. So the first one in sets it, and the last one
    out gives the program the number back that it had: contexts may lie in one another, and
    several threads of the program may be within one at a time.
    """

    def __init__(self):
        self._lock = Lock()
        self._entered = 0
        self._libraries: list | None = None
        self._before: list[tuple] = []

    def __enter__(self):
        """Set one thread, unless another context has."""
        with self._lock:
            if not self._entered:
                self._before = [(library, library.get_num_threads()) for library in self._found()]
                for library, threads in self._before:
                    if threads != 1:
                        library.set_num_threads(1)
            self._entered += 1

    def __exit__(self, *_):
        """Set what was there before, unless another context is still entered."""
        with self._lock:
            self._entered -= 1
            if not self._entered:
                for library, threads in self._before:
                    if threads != 1:
                        library.set_num_threads(threads)

    def _found(self) -> list:
        # Looking through all shared libraries takes a millisecond: once is enough.
        if self._libraries is None:
            self._libraries = ThreadpoolController().select(user_api='blas').lib_controllers
        return self._libraries


_LIMIT = _Limit()


def one_thread(verb: Callable) -> Callable:
    """Return a function that does the same with one BLAS thread, and then restores the number."""
    @wraps(verb)
    def limited(*args, **kwargs):
        with _LIMIT:
            return verb(*args, **kwargs)
    return limited
