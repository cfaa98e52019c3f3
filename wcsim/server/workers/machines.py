"""A piece of work, and its workers: processes of this machine, or CPUs of a Ray cluster.

The rest of wcsim need not know which. On a cluster, the input files of a piece lie in a temporary
folder. It is removed with the piece; after a kill, with the next piece on that machine.
"""

import re
import socket
from collections.abc import Callable, Mapping
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass, field
from pathlib import Path
from time import sleep
from typing import Any, Final, Protocol

from wcsim.core.processes import kill_workers, start_single_worker_pool
from wcsim.core.reading import escape
from wcsim.errors import ConfigError, check_installed

LOGS: Final = "cluster"
"""Folder, in that of a run or a result, for what Ray printed and which worker had which piece."""

LOCAL: Final = "local"
"""The address of a cluster that is made here."""
_ADDRESS: Final = re.compile(r"(\[[0-9A-Fa-f:.]+\]|[A-Za-z0-9_.-]+):(\d{1,5})")
_REACH_TIMEOUT_S: Final = 5.0

ToLocalPath = Callable[[str], str]
"""The path, on the machine of the worker, of what the sending machine calls by this address."""

Call = Callable[[Any, ToLocalPath], bytes]
"""A function of a module that does a piece of work; returns compressed bytes."""

Facts = Mapping[str, str | int | float]
Report = Callable[[str], object]


@dataclass(frozen=True, slots=True, kw_only=True)
class WorkInputFiles:
    """Files below a folder that a piece of work reads; they are sent to machines without them."""

    address: str  # what the piece calls them
    folder: Path
    names: tuple[str, ...]  # of files in it
    inner: str = ""  # what the address means in it: "" is the folder


Needs = Callable[[Any], tuple[WorkInputFiles, ...]]


def _no_files(_piece: Any) -> tuple[WorkInputFiles, ...]:
    return ()


@dataclass(frozen=True, slots=True, kw_only=True)
class WorkPiece:
    """One piece. Its key is the same on every machine, and each time that it is done."""

    key: str
    call: Call
    piece: Any  # what is sent
    needs: Needs = _no_files


@dataclass(frozen=True, slots=True, kw_only=True)
class WorkResult:
    """The end of a piece: `data`, or an `error` that is final, or neither: the piece is lost."""

    worker: str
    key: str
    data: bytes | None = None
    error: BaseException | None = None
    lost: str = ""  # why
    # Whether the piece may have killed the worker; False where its machine was disconnected.
    counts: bool = True
    facts: Facts = field(default_factory=dict)  # for the log


class WorkerPool(Protocol):
    """Each does one piece at a time. Workers may be added or removed at any time."""

    def names(self) -> tuple[str, ...]:
        """Those of now, busy or not. Raises WorkersError when it can no longer be known."""

    def begin(self, worker: str, work: WorkPiece) -> None:
        """Give a piece to a worker that has none."""

    def collect(self, timeout_s: float) -> list[WorkResult]:
        """The pieces that have ended; waits a while for one. Raises WorkersError as `names`."""

    def stop(self, worker: str) -> None:
        """Kill a worker; its piece is then collected as lost."""

    def close(self) -> None:
        """Kill all workers."""


class _ProcessWorkers:
    """`count` processes, each started when it first has something to do."""

    def __init__(self, count: int) -> None:
        self._names = tuple(f"process {number + 1}" for number in range(count))
        self._pools: dict[str, ProcessPoolExecutor] = {}
        self._running: dict[Future[bytes], tuple[str, str]] = {}

    def names(self) -> tuple[str, ...]:
        """All of them: one that has died is started again with its next piece."""
        return self._names

    def begin(self, worker: str, work: WorkPiece) -> None:
        """Give a piece to a process."""
        try:
            future = self._pool(worker).submit(work.call, work.piece, str)
        except BrokenProcessPool:
            # It died while it had nothing to do.
            self._drop(worker)
            future = self._pool(worker).submit(work.call, work.piece, str)
        self._running[future] = worker, work.key

    def collect(self, timeout_s: float) -> list[WorkResult]:
        """The pieces that have ended; waits a while for one."""
        if not self._running:
            sleep(timeout_s)
            return []
        results = []
        for future in wait(self._running, timeout_s, FIRST_COMPLETED).done:
            worker, key = self._running.pop(future)
            error = future.exception()
            if error is None:
                results.append(WorkResult(worker=worker, key=key, data=future.result()))
            elif isinstance(error, BrokenProcessPool):
                self._drop(worker)
                results.append(WorkResult(worker=worker, key=key, lost="its process died"))
            else:
                results.append(WorkResult(worker=worker, key=key, error=error))
        return results

    def stop(self, worker: str) -> None:
        """Kill a process."""
        if worker in self._pools:
            kill_workers(self._pools[worker])

    def close(self) -> None:
        """Kill all of them."""
        for worker in list(self._pools):
            self.stop(worker)
            self._drop(worker)
        self._running.clear()

    def _pool(self, worker: str) -> ProcessPoolExecutor:
        if worker not in self._pools:
            self._pools[worker] = start_single_worker_pool()
        return self._pools[worker]

    def _drop(self, worker: str) -> None:
        self._pools.pop(worker).shutdown(wait=False, cancel_futures=True)


@dataclass(frozen=True, slots=True, kw_only=True)
class WorkerPoolSettings:
    """Where workers run."""

    count: int = 1  # processes, here or in a cluster that is made here
    cluster: str = ""  # "" for none, `local` for one that is made here, or HOST:PORT of a Ray head
    report: Report = lambda text: None  # of machines that join, leave, or cannot be used

    def open(self, folder: Path) -> WorkerPool:
        """Start the workers; `folder` is that of the run, for the logs of a cluster.

        Raises:
            ConfigError: There is no Ray, or no cluster at that address, or no node can be used.
        """
        if not self.cluster:
            return _ProcessWorkers(self.count)
        from wcsim.server.workers.ray_workers import RayWorkerPool

        return RayWorkerPool(self.cluster, self.count, folder / LOGS, self.report)


HERE: Final = WorkerPoolSettings()
"""One process of this machine."""


def require_reachable_cluster(address: str) -> None:
    """Refuse what is no address of a cluster, or one without an answer. Raises ConfigError."""
    found = _ADDRESS.fullmatch(address)
    if address != LOCAL and (found is None or not 0 < int(found[2]) < 1 << 16):
        raise ConfigError(
            f"--cluster {escape(address, 80)!r}: expected `local`, or HOST:PORT as "
            "`ray start --head` prints it, such as 10.0.0.1:6379"
        )
    check_installed("--cluster needs Ray", "cluster", "ray")
    if found is not None:
        try:
            socket.create_connection(
                (found[1].strip("[]"), int(found[2])), _REACH_TIMEOUT_S
            ).close()
        except OSError as error:
            raise ConfigError(
                f"--cluster {address}: no answer within {_REACH_TIMEOUT_S:g} s "
                f"({error.strerror or error}); start a Ray head there with "
                "`ray start --head --port=6379`, and check the firewall"
            ) from None


def machine_from_worker(worker: str) -> str:
    """The machine of a worker, as ADDRESS of ADDRESS/NUMBER; "" for a process of this one.

    >>> machine_from_worker("10.0.0.2/3"), machine_from_worker("process 1")
    ('10.0.0.2', '')
    """
    return worker.rpartition("/")[0]
