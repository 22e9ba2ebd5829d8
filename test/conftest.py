"""What all tests share: seeds, the real sequences, and a ROS of their own."""

from contextlib import ExitStack
import os
from pathlib import Path
import sys

# Before numpy is loaded: threads of several workers wait for each other, ten times as long.
os.environ.setdefault('OPENBLAS_NUM_THREADS', '1')

import numpy as np  # noqa: E402
import pytest  # noqa: E402

ROOT = Path(__file__).resolve().parents[1]
# The real sequences; an empty MV_SLAPSE_TEST_DATA hides them, as a stranger has it.
DATA = Path(os.environ.get('MV_SLAPSE_TEST_DATA', ROOT.parent / 'shared' / 'data') or os.devnull)

# Before rclpy is loaded, and for the processes that tests start.
os.environ.setdefault('ROS_AUTOMATIC_DISCOVERY_RANGE', 'LOCALHOST')
os.environ.setdefault('ROS_PYTHON_CHECK_FIELDS', '1')
# The processes that tests start by the hundred would compile numpy and rclpy each time.
os.environ.pop('PYTHONDONTWRITEBYTECODE', None)
if Path(sys.prefix, 'share', 'ament_index').is_dir():
    os.environ.setdefault('AMENT_PREFIX_PATH', sys.prefix)
# What takes longest comes first, so that no worker is left alone with it at the end; what computes
# among what waits.
LONGEST = ('test_wheel.py', 'test_batch.py', 'test_evaluate.py', 'test_workers.py', 'simulation',
           'test_demo.py', 'system', 'test_reproducibility.py', 'nodes', 'benchmarks', 'batch',
           'reliability', 'storage', 'tools', 'kernels', 'movers')


def pytest_collection_modifyitems(items):
    """Sort tests by the files and rooms that take longest."""
    def place(item):
        """Return the place of a test's file or room."""
        names = item.path.relative_to(ROOT / 'test').parts
        return min((LONGEST.index(name) for name in names if name in LONGEST),
                   default=len(LONGEST))

    items.sort(key=place)


@pytest.fixture(params=range(5), ids='seed{}'.format)
def rng(request):
    """Generator of each of five seeds."""
    return np.random.default_rng(request.param)


@pytest.fixture(scope='session')
def data():
    """Folder of the real sequences; skips where they are absent."""
    if not DATA.is_dir():
        pytest.skip('the real sequences (../shared/data) are absent or hidden')
    return DATA


@pytest.fixture(scope='module')
def ros_domain():
    """ROS domain that no other test module on this machine uses; set for child processes."""
    coordinator = pytest.importorskip('domain_coordinator')
    with ExitStack() as stack, pytest.MonkeyPatch.context() as patch:
        domain = stack.enter_context(coordinator.domain_id())
        patch.setenv('ROS_DOMAIN_ID', str(domain))
        yield domain
