"""Workers that are processes of this machine; one that dies takes its own piece with it, and is started again."""

from __future__ import annotations

import signal
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from multiprocessing import get_context
from time import sleep

from wcsim.server.launch.parent_death import die_with_parent
from wcsim.server.launch.stop_signals import unheard_by_children
from wcsim.server.workers.work_folders import work_folder
from wcsim.server.workers.worker_api import Work, WorkEnd


class ProcessWorkers:
    """So many processes, each started when it first has something to do.

    Args:
        count: How many.
    """

    def __init__(self, count: int) -> None:
        self._names = tuple(f"process {number + 1}" for number in range(count))
        self._pools: dict[str, ProcessPoolExecutor] = {}
        self._under_way: dict[Future[bytes], tuple[str, str]] = {}

    def names(self) -> tuple[str, ...]:
        """All of them: one that has died is started again with its next piece."""
        return self._names

    def begin(self, worker: str, work: Work) -> None:
        """Give a piece to a process."""
        with unheard_by_children():
            try:
                future = self._pool(worker).submit(_do, work)
            except BrokenProcessPool:  # it died while it had nothing to do
                self._drop(worker)
                future = self._pool(worker).submit(_do, work)
        self._under_way[future] = worker, work.key

    def ended(self, timeout_s: float) -> list[WorkEnd]:
        """What has come back; waits a while for it."""
        if not self._under_way:
            sleep(timeout_s)
            return []
        done, _ = wait(self._under_way, timeout=timeout_s, return_when=FIRST_COMPLETED)
        return [self._ended(future, *self._under_way.pop(future)) for future in done]

    def stop(self, worker: str) -> None:
        """Kill a process."""
        pool = self._pools.get(worker)
        for process in list((pool._processes or {}).values()) if pool is not None else ():
            process.kill()

    def close(self) -> None:
        """Kill all of them."""
        for worker in list(self._pools):
            self.stop(worker)
            self._drop(worker)
        self._under_way.clear()

    def _pool(self, worker: str) -> ProcessPoolExecutor:
        if worker not in self._pools:
            # A process that waits for work would not notice that nobody is left to give it any.
            self._pools[worker] = ProcessPoolExecutor(
                1, mp_context=get_context("spawn"), initializer=die_with_parent, initargs=(signal.SIGKILL,)
            )
        return self._pools[worker]

    def _drop(self, worker: str) -> None:
        self._pools.pop(worker).shutdown(wait=False, cancel_futures=True)

    def _ended(self, future: Future[bytes], worker: str, key: str) -> WorkEnd:
        error = future.exception()
        if error is None:
            return WorkEnd(worker=worker, key=key, data=future.result())
        if isinstance(error, BrokenProcessPool):
            self._drop(worker)
            return WorkEnd(worker=worker, key=key, lost="its process died")
        return WorkEnd(worker=worker, key=key, error=error)


def _do(work: Work) -> bytes:
    """In the process."""
    with work_folder():
        return work.call(work.piece, str)
