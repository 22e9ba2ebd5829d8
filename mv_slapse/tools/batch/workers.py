"""Worker processes: some of this machine, or those of a Dask scheduler that runs already.

Dask is optional: it is imported where workers are asked for, and missed with a clear word. A task
is a function call; whoever submits it gets its value, or its error, back in the order of ending.
"""

from collections.abc import Callable, Iterator
from contextlib import contextmanager, ExitStack
from dataclasses import dataclass
from functools import partial
import importlib.util
import itertools
import logging
import os
import time
from typing import Any
import uuid

import cv2
from mv_slapse.errors import MvSlapseError, UsageError

EXTRA = "pip install 'dask>=2024.8' 'distributed>=2024.8'"
LEAST_MEMORY = 300 << 20  # bytes; with less a worker ends as soon as it has loaded its libraries
CONNECT = 30.0  # s until a scheduler must have answered
REPLACED = 5.0  # s until another worker takes the place of one that could not start
RECENT = 1.0  # s that the number of threads is believed for
LOOPBACK = '127.0.0.1'
DASHBOARD = 8787  # Dask's own port; another one where it is taken
CHANGE = 'mv_slapse_change'  # name of the plugin that changes a worker
#: what a cluster of our own does otherwise than Dask's default
CONFIG = {
    # A worker that dies must not count against tasks that only waited for it: ours count their
    # starts themselves, see task.py.
    'distributed.scheduler.allowed-failures': 10,
    'distributed.scheduler.worker-saturation': 1.0,
    # ... nor may one be given up that takes long to start anew on a machine with much to do.
    'distributed.deploy.lost-worker-timeout': '1 day',
    'distributed.worker.daemon': True,
    # Of what Dask's developers look at; the rest would grow over thousands of tasks.
    'distributed.admin.low-level-log-length': 100,
    'distributed.admin.log-length': 100,
}


class MissingDask(MvSlapseError):  # noqa: N818 (the installation is incomplete)
    """Dask is not installed."""


class UnusableCluster(MvSlapseError):  # noqa: N818 (the cluster is at fault)
    """A scheduler that does not answer, does so no more, or whose workers do not suit."""


@dataclass(frozen=True)
class Workers:
    """Who does the work.

    Attributes
    ----------
    count : int
        Processes of this machine, one thread each; 0 takes one a core.
    nice : int
        Added to their niceness.
    change : function without arguments, or None
        Called once in each process before it works; it can be pickled.
    memory_limit : str
        Of each process, as ``2GiB``; empty: an equal share of the machine's. One that needs more
        is ended.
    scheduler : str
        Address of a running scheduler, whose workers are taken in place of processes of this
        machine; empty for none.
    """

    count: int = 0
    nice: int = 0
    change: Callable[[], None] | None = None
    memory_limit: str = ''
    scheduler: str = ''


class Pool:
    """Workers that wait for tasks; see ``open_pool``."""

    def __init__(self, client: Any):
        """Take a connected client."""
        from distributed import as_completed
        self._client, self._address = client, client.scheduler.address
        self._tags: dict[Any, Any] = {}
        self._ended = as_completed([], loop=client.loop)
        self._call, self._numbers = uuid.uuid4().hex[:12], itertools.count()
        self._threads, self._asked = 0, -RECENT

    @property
    def running(self) -> int:
        """How many tasks have not ended."""
        return len(self._tags)

    @property
    def threads(self) -> int:
        """How many tasks can run at once, as the scheduler said a moment ago."""
        if time.monotonic() > self._asked + RECENT:
            with self._needed():
                self._threads = sum(self._client.nthreads().values())
            self._asked = time.monotonic()
        return self._threads

    @property
    def dashboard(self) -> str:
        """Where the scheduler's pages are; empty where it has none."""
        services = self._client.scheduler_info().get('services', {})
        return self._client.dashboard_link if 'dashboard' in services and _has_bokeh() else ''

    def submit(self, tag: Any, function: Callable, *args: Any, priority: int = 0):
        """Hand a task over; ``results`` tells how it ended. A higher priority comes first."""
        with self._needed():
            future = self._client.submit(
                _alone, function, *args, priority=priority, pure=False,
                # of one group, so that Dask keeps back what the workers have no hand free for
                key=(f'mv_slapse-{self._call}', next(self._numbers)))
        self._tags[future] = tag
        self._ended.add(future)

    def results(self) -> Iterator[tuple[Any, Any]]:
        """Yield the tag and the value, or the exception, of each task that ends, until none runs.

        More tasks may be submitted meanwhile.

        Raises
        ------
        UnusableCluster
            Where the scheduler is lost.
        """
        while self._tags:
            batch = self._ended.next_batch(block=True)
            futures = [future for future in batch if future.done()]
            # A worker that dies takes the values along that nobody has fetched: they come again.
            self._ended.update(set(batch).difference(futures))
            values = self._values(futures)
            if any(future.cancelled() for future in futures):
                raise self._lost()
            for future, value in zip(futures, values, strict=True):
                future.release()
                yield self._tags.pop(future), value

    def _values(self, futures: list[Any]) -> list[Any]:
        """Return what tasks gave; asked for at once, since each question costs milliseconds."""
        try:
            return self._client.gather(futures)
        except Exception:  # of a task, whatever it raised
            return [_value(future) for future in futures]

    def ended_for_memory(self) -> set[str]:
        """Return the addresses of the workers that were ended for what memory they took."""
        with self._needed():
            events = self._client.get_events('worker-restart-memory') or ()
        return {event['worker'] for _, event in events}

    @contextmanager
    def _needed(self) -> Iterator[None]:
        """Tell that the scheduler is lost where a question to it fails."""
        from distributed.client import ClosedClientError
        try:
            yield
        except (OSError, ClosedClientError) as error:
            raise self._lost() from error

    def _lost(self) -> UnusableCluster:
        return UnusableCluster(
            f'the scheduler {self._address} is lost; what was done is whole, and the same call '
            'goes on where this one ended')


def require_dask():
    """Do nothing where Dask is installed.

    Raises
    ------
    MissingDask
    """
    missing = [name for name in ('dask', 'distributed') if importlib.util.find_spec(name) is None]
    if missing:
        raise MissingDask(f'{" and ".join(missing)} is not installed, which shares the work out; '
                          f'install it with: {EXTRA}')


@contextmanager
def open_pool(workers: Workers) -> Iterator[Pool]:
    """Start, or connect to, the workers; they end, or are left, when the context does.

    Raises
    ------
    MissingDask, UnusableCluster, UsageError
    """
    require_dask()
    import dask
    from distributed import Client
    with ExitStack() as stack, dask.config.set(CONFIG):
        address = workers.scheduler or stack.enter_context(_local_cluster(workers))
        try:
            client = stack.enter_context(Client(address, timeout=CONNECT, set_as_default=False))
        except (OSError, TimeoutError, ValueError) as error:
            raise UnusableCluster(f'no Dask scheduler answers at {workers.scheduler}: {error}; '
                                  'start one with: dask scheduler') from None
        if workers.scheduler:
            _check(client)
            stack.enter_context(_changed(client, workers.change))
        else:
            client.register_plugin(_plugin(workers.nice, workers.change), CHANGE)
        yield Pool(client)


def cores() -> int:
    """Return how many cores this process may use, as its container and affinity say."""
    from dask.system import CPU_COUNT
    return CPU_COUNT


def worker_address() -> str:
    """Return the address of the worker that runs this, empty outside of one."""
    if importlib.util.find_spec('distributed') is None:
        return ''
    from distributed import get_worker
    try:
        return get_worker().address
    except ValueError:
        return ''


def died(error: Any) -> bool:
    """Return whether a task ended because workers died that had it."""
    return type(error).__name__ == 'KilledWorker'


def _alone(function: Callable, *args: Any) -> Any:
    """Call a function with one thread for OpenCV; Dask's nannies see to the other libraries."""
    cv2.setNumThreads(1)
    return function(*args)


def _value(future: Any) -> Any:
    try:
        return future.result()
    except Exception as error:
        return error


def _has_bokeh() -> bool:
    return importlib.util.find_spec('bokeh') is not None


@contextmanager
def _local_cluster(workers: Workers) -> Iterator[Any]:
    """Start processes of this machine that nobody from elsewhere can reach."""
    from distributed import LocalCluster
    from tornado.ioloop import PeriodicCallback
    count = workers.count or cores()
    with LocalCluster(
            n_workers=0, threads_per_worker=1, processes=True,
            memory_limit=_memory(workers.memory_limit, count), host=LOOPBACK,
            silence_logs=logging.CRITICAL,
            dashboard_address=f'{LOOPBACK}:{DASHBOARD if _has_bokeh() else 0}') as cluster:
        replacing = PeriodicCallback(partial(_replace, cluster), 1e3 * REPLACED)
        cluster.loop.add_callback(replacing.start)
        # Asked for only now, so that one that dies while it starts does not end the cluster.
        cluster.scale(count)
        try:
            yield cluster
        finally:
            cluster.loop.add_callback(replacing.stop)


def _memory(limit: str, count: int) -> int:
    """Return the bytes that each process may take: a given limit, or an equal share."""
    from dask.utils import parse_bytes
    from distributed.system import MEMORY_LIMIT
    try:
        size = parse_bytes(limit) if limit else MEMORY_LIMIT // count
    except (ValueError, OverflowError):
        raise UsageError(f'--memory-limit {limit!r} is no size; write it as 2GiB') from None
    if size < LEAST_MEMORY and limit:
        raise UsageError(f'--memory-limit {limit} is too little: a worker with its libraries '
                         f'takes {LEAST_MEMORY >> 20} MiB before it has read anything')
    if size < LEAST_MEMORY:
        raise UsageError(
            f'{count} workers have {MEMORY_LIMIT >> 20} MiB together, and each takes '
            f'{LEAST_MEMORY >> 20} MiB before it has read anything; start at most '
            f'{max(MEMORY_LIMIT // LEAST_MEMORY, 1)}, or give each more with --memory-limit')
    return size


def _replace(cluster: Any):
    """Start others for workers that did not come up; those that die Dask starts anew itself."""
    ended = [name for name, worker in cluster.workers.items()
             if worker.status.name in ('closed', 'failed')]
    for name in ended:
        del cluster.workers[name]
    if ended:
        cluster.scale(len(cluster.worker_spec))


def _check(client: Any):
    """Refuse workers that share memory and the processor's clock among several tasks."""
    wide = [address for address, n in client.nthreads().items() if n > 1]
    if wide:
        raise UnusableCluster(f'worker {wide[0]} has several threads, which would mix memory and '
                              'CPU time of several recordings; start it with: dask worker '
                              '--nworkers auto --nthreads 1')


@contextmanager
def _changed(client: Any, change: Callable[[], None] | None) -> Iterator[None]:
    """Change the workers of somebody else's cluster; they start anew before and after."""
    if change is None:
        yield
        return
    client.restart(wait_for_workers=False)  # the old ones have ended; new ones come when they can
    client.register_plugin(_plugin(0, change), CHANGE)
    try:
        yield
    finally:
        client.unregister_worker_plugin(CHANGE)
        client.restart(wait_for_workers=False)


def _plugin(nice: int, change: Callable[[], None] | None) -> Any:
    """Return what Dask has each worker do first."""
    from distributed import WorkerPlugin

    class Start(WorkerPlugin):
        """Be nice, and change what is to be changed."""

        def setup(self, worker: Any):
            """Do it, in the process of a worker."""
            os.nice(nice)
            if change:
                change()

    return Start()
