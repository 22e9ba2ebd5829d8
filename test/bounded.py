"""What a refusal may cost: CPU time and memory, as the kernel counts it."""

from contextlib import contextmanager
from pathlib import Path
import time

SECONDS, MEGABYTES = 1.0, 200.0
PROCESS = Path('/proc/self')


def _kilobytes(name: str) -> int:
    lines = (PROCESS / 'status').read_text().splitlines()
    return next(int(line.split()[1]) for line in lines if line.startswith(name))


@contextmanager
def refusal():
    """Assert that what runs within takes less."""
    (PROCESS / 'clear_refs').write_text('5')  # forgets the peak, proc(5)
    before, begin = _kilobytes('VmRSS'), time.process_time()
    yield
    assert time.process_time() - begin < SECONDS
    assert (_kilobytes('VmHWM') - before) / 1024 < MEGABYTES
