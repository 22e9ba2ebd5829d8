"""Whom the work is given to, and what is said where nobody can take it."""

import importlib.util
import os
import signal
from threading import Thread
import time

from mv_slapse.errors import UsageError
from mv_slapse.tools.batch import workers
from mv_slapse.tools.batch.workers import MissingDask, open_pool, UnusableCluster, Workers
import psutil
import pytest


def test_a_missing_dask_is_told_with_its_cure(monkeypatch):
    find = importlib.util.find_spec
    monkeypatch.setattr(workers.importlib.util, 'find_spec',
                        lambda name: None if name == 'distributed' else find(name))
    with pytest.raises(MissingDask, match='^distributed is not installed.*pip install'), \
            open_pool(Workers(1)):
        pass


@pytest.mark.parametrize(('limit', 'told'), [('much', 'no size'), ('1e400', 'no size'),
                                              ('10MiB', 'too little')])
def test_a_memory_limit_that_cannot_be_is_refused(limit, told):
    with pytest.raises(UsageError, match=told), open_pool(Workers(1, memory_limit=limit)):
        pass


@pytest.mark.parametrize(('given', 'count'), [(1, 1), (0, 3)])
def test_all_the_memory_is_shared_by_the_workers_that_there_are(monkeypatch, given, count):
    monkeypatch.setattr('dask.system.CPU_COUNT', 3)
    monkeypatch.setattr('distributed.system.MEMORY_LIMIT', 3 << 30)
    with open_pool(Workers(given)) as pool:
        pool.submit('here', workers.worker_address)
        assert len(list(pool.results())) == 1
        found = pool._client.scheduler_info()['workers'].values()
    assert {worker['memory_limit'] for worker in found} == {(3 << 30) // count}


def test_shares_that_are_too_small_are_refused_with_what_to_do(monkeypatch):
    monkeypatch.setattr('distributed.system.MEMORY_LIMIT', 1 << 30)
    told = '4 workers have 1024 MiB together.* start at most 3, or'
    with pytest.raises(UsageError, match=told), open_pool(Workers(4)):
        pass


def test_a_scheduler_that_does_not_answer_is_told(monkeypatch):
    monkeypatch.setattr(workers, 'CONNECT', 0.5)
    with pytest.raises(UnusableCluster, match='no Dask scheduler answers at tcp://127.0.0.1:9'), \
            open_pool(Workers(scheduler='tcp://127.0.0.1:9')):
        pass


def test_a_worker_that_dies_while_it_starts_is_replaced(monkeypatch):
    monkeypatch.setattr(workers, 'REPLACED', 0.2)
    killed = []

    def kill():
        """Kill the first process of a worker that appears."""
        before, end = set(psutil.Process().children(recursive=True)), time.monotonic() + 30
        while not killed and time.monotonic() < end:
            for child in psutil.Process().children(recursive=True):
                if child not in before and 'spawn_main' in ' '.join(child.cmdline()):
                    child.kill()
                    killed.append(child)
                    break

    killer = Thread(target=kill)
    killer.start()
    with open_pool(Workers(1)) as pool:
        killer.join()
        pool.submit('here', abs, -3)
        assert list(pool.results()) == [('here', 3)]
    assert killed


def test_a_value_that_dies_with_its_worker_is_computed_again(tmp_path):
    def number() -> int:
        """Return which run this is; the later ones take a while."""
        ran = len(list(tmp_path.iterdir()))
        (tmp_path / str(os.getpid())).touch()
        time.sleep(ran)
        return ran

    with open_pool(Workers(1)) as pool:
        pool.submit('here', number)
        (future,) = pool._tags
        while not pool._ended.has_ready():
            time.sleep(0.01)
        os.kill(int(next(tmp_path.iterdir()).name), signal.SIGKILL)
        while future.done():
            time.sleep(0.01)
        assert list(pool.results()) == [('here', 1)]


def test_a_task_has_one_thread(pool):
    def threads():
        """Return how many threads libraries would use."""
        import cv2
        return cv2.getNumThreads(), os.environ['OPENBLAS_NUM_THREADS'], os.getpid()

    pool.submit('here', threads)
    [(tag, (of_opencv, of_blas, process))] = pool.results()
    assert (tag, of_opencv, of_blas) == ('here', 1, '1')
    assert process != os.getpid()


def test_workers_of_others_are_changed_and_come_back_as_they_were():
    from distributed import LocalCluster

    def mark():
        """Leave a mark in the process."""
        os.environ['MV_SLAPSE_MARK'] = 'changed'

    def marked():
        """Return the mark."""
        return os.environ.get('MV_SLAPSE_MARK'), workers.worker_address()

    with LocalCluster(n_workers=1, threads_per_worker=1, dashboard_address=None) as cluster:
        address = cluster.scheduler_address
        for change, mark_of_it in ((mark, 'changed'), (None, None)):
            with open_pool(Workers(scheduler=address, change=change)) as pool:
                pool.submit(0, marked)
                [(_, (found, worker))] = pool.results()
                assert found == mark_of_it
                assert worker
        cluster.scale(0)
    with pytest.raises(UnusableCluster):
        open_pool(Workers(scheduler=address)).__enter__()


def test_a_worker_of_several_threads_is_refused():
    from distributed import LocalCluster
    with LocalCluster(n_workers=1, threads_per_worker=2, dashboard_address=None, processes=False,
                      protocol='tcp') as cluster, \
            pytest.raises(UnusableCluster, match='--nthreads 1'), \
            open_pool(Workers(scheduler=cluster.scheduler_address)):
        pass
