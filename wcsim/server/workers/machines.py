"""A piece of work, and where it is done: in processes of this machine, or on those of a Ray cluster.

The rest of wcsim need not know where. A worker works in a folder named by its process, which goes with the piece, or
with the next on the machine.
"""

from __future__ import annotations

import signal
from collections.abc import Callable, Mapping
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass, field
from multiprocessing import get_context
from os import getpid
from pathlib import Path
from time import sleep
from typing import Any, Final, Protocol

from wcsim.core.processes import (
    die_with_parent,
    hear_of_deaths,
    name_semaphores,
    unheard_by_children,
)

At = Callable[[str], str]
"""Where that which the machine that sends calls by this address lies on the machine that works."""

Call = Callable[[Any, At], bytes]
"""A function of a module: does a piece of work; what comes back is one compressed piece of bytes."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Parcel:
    """Files below a folder that a piece of work reads; they travel to machines that have no disk in common."""

    address: str  # what the piece calls it
    folder: Path
    names: tuple[str, ...]  # of files in it
    inner: str = ""  # what the address means in it: "" is the folder


Needs = Callable[[Any], tuple[Parcel, ...]]


def _nothing_needed(_piece: Any) -> tuple[Parcel, ...]:
    """What a piece needs that is made of words alone."""
    return ()


@dataclass(frozen=True, slots=True, kw_only=True)
class Work:
    """One piece, under a key that says what it is wherever it is done, and however often."""

    key: str
    call: Call
    piece: Any  # what is sent
    needs: Needs = _nothing_needed


Facts = Mapping[str, str | int | float]


@dataclass(frozen=True, slots=True, kw_only=True)
class WorkEnd:
    """What a worker has come to with a piece: `data`, or an `error` that is final, or neither: the piece is lost."""

    worker: str
    key: str
    data: bytes | None = None
    error: BaseException | None = None
    lost: str = ""  # why
    counts: bool = (
        True  # whether the piece may have killed the worker, rather than its machine have gone
    )
    facts: Facts = field(default_factory=dict)  # for the log


class Workers(Protocol):
    """Those who do the work, one piece at a time each; who they are may change at any time."""

    def names(self) -> tuple[str, ...]:
        """Who there is now, busy or not. Raises WorkersError when it can no longer be known."""

    def begin(self, worker: str, work: Work) -> None:
        """Give a piece to a worker that has none."""

    def ended(self, timeout_s: float) -> list[WorkEnd]:
        """What has come back; waits a while for it. Raises WorkersError as `names`."""

    def stop(self, worker: str) -> None:
        """End what a worker is at; it is heard of as lost."""

    def close(self) -> None:
        """End all at once."""


class OneProcess(ProcessPoolExecutor):
    """A process, started at once, that is there until this one ends, however that comes about."""

    def __init__(self) -> None:
        # A process that waits for work would not notice that nobody is left to give it any.
        name_semaphores()
        super().__init__(
            1,
            mp_context=get_context("spawn"),
            initializer=die_with_parent,
            initargs=(signal.SIGKILL,),
        )
        with unheard_by_children():
            self.submit(getpid)
        hear_of_deaths(self)

    def kill(self) -> None:
        """Kill the process; who waits for what it is at hears a BrokenProcessPool."""
        for process in list((self._processes or {}).values()):
            process.kill()


class _ProcessWorkers:
    """So many processes, each started when it first has something to do.

    Args:
        count: How many.
    """

    def __init__(self, count: int) -> None:
        self._names = tuple(f"process {number + 1}" for number in range(count))
        self._pools: dict[str, OneProcess] = {}
        self._under_way: dict[Future[bytes], tuple[str, str]] = {}

    def names(self) -> tuple[str, ...]:
        """All of them: one that has died is started again with its next piece."""
        return self._names

    def begin(self, worker: str, work: Work) -> None:
        """Give a piece to a process."""
        try:
            future = self._pool(worker).submit(work.call, work.piece, str)
        except BrokenProcessPool:  # it died while it had nothing to do
            self._drop(worker)
            future = self._pool(worker).submit(work.call, work.piece, str)
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
        if worker in self._pools:
            self._pools[worker].kill()

    def close(self) -> None:
        """Kill all of them."""
        for worker in list(self._pools):
            self.stop(worker)
            self._drop(worker)
        self._under_way.clear()

    def _pool(self, worker: str) -> OneProcess:
        if worker not in self._pools:
            self._pools[worker] = OneProcess()
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


LOGS: Final = "cluster"  # of a run or a result: its folder for what Ray said, and who did what

Say = Callable[[str], object]


@dataclass(frozen=True, slots=True, kw_only=True)
class Machines:
    """Who is asked for workers."""

    count: int = 1  # processes, here or in a cluster that is made here
    cluster: str = ""  # "" for none, `local` for one that is made here, or HOST:PORT of a Ray head
    say: Say = lambda told: None  # of what machines come, go, or cannot be used

    def open(self, folder: Path) -> Workers:
        """The workers; `folder` is that of the run, for the logs of a cluster.

        Raises:
            ConfigError: There is no Ray, or no cluster at that address, or none of its nodes can be used.
        """
        if not self.cluster:
            return _ProcessWorkers(self.count)
        from wcsim.server.workers.ray_workers import RayWorkers

        return RayWorkers(self.cluster, self.count, folder / LOGS, self.say)


HERE: Final = Machines()
"""One process of this machine."""
