"""Sees to it that every piece of work is done: by whoever is free, in any order, and again if it was lost or is late.

It goes on in a thread of its own, so that workers have something to do while the network learns.
"""

from __future__ import annotations

import threading
import time
from collections import Counter, defaultdict, deque
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass
from typing import Final

from wcsim.errors import WorkersError
from wcsim.server.workers.machines import Work, WorkEnd, Workers

MOST_DEATHS: Final = 5  # of workers at the same piece, or times that it was late, before the run gives up
LATE: Final = 5.0  # times the longest piece so far: then it is done again by another one
LEAST_LATE_S: Final = 180.0
NOBODY_S: Final = 600.0  # without any worker before the run gives up
_LOOK_S: Final = 0.1
_KEPT: Final = "finished work is saved: continue (a training: wcsim resume RUN; a test: --resume)"

Keep = Callable[[str, bytes], object]
"""Told, in the crew's thread, of each piece by its key, before anybody else hears of it."""


@dataclass(frozen=True, slots=True, kw_only=True)
class WorkerNow:
    """A worker, and what it is at."""

    name: str
    key: str  # "" for nothing
    for_s: float = 0.0


@dataclass(slots=True, kw_only=True)
class _Task:
    """A piece that somebody is at."""

    work: Work
    since_s: float
    late: bool = False  # somebody else is asked for it
    stopped_s: float = 0.0  # when its worker was last told to be killed


class Crew:
    """Workers, and the work that is left; a context manager.

    Args:
        workers: Who does it; closed with the crew.
        keep: Where what comes back goes.
        least_late_s: No piece is late before that.
        nobody_s: So long it is waited for a first worker.
    """

    def __init__(
        self, workers: Workers, keep: Keep, *, least_late_s: float = LEAST_LATE_S, nobody_s: float = NOBODY_S
    ) -> None:
        self._workers, self._keep, self._nobody_s = workers, keep, nobody_s
        self._longest_s = least_late_s / LATE
        self._left: deque[Work] = deque()
        self._at: dict[str, _Task] = {}
        self._asked: set[str] = set()
        self._done: set[str] = set()
        self._deaths = Counter[str]()
        self._lost_on = defaultdict[str, set[str]](set)  # by piece, the machines that have lost it, or were late
        self._times_late = Counter[str]()
        self._failed: BaseException | None = None
        self._somebody_s = time.monotonic()
        self._names: tuple[str, ...] = ()
        self._lock = threading.Condition()
        self._closing = threading.Event()
        self._thread = threading.Thread(target=self._work, name="crew", daemon=True)

    def __enter__(self) -> Crew:
        self._thread.start()
        return self

    def __exit__(self, *exception: object) -> None:
        self._closing.set()
        self._thread.join()
        self._workers.close()

    def ask(self, works: Sequence[Work]) -> None:
        """Have these done, after what was asked for before; what was asked for already is not asked for again."""
        with self._lock:
            for work in works:
                if work.key not in self._asked:
                    self._asked.add(work.key)
                    self._left.append(work)

    def come(self, keys: Collection[str], timeout_s: float) -> frozenset[str]:
        """Those of the pieces that are done; waits a while for one of them.

        Raises:
            WorkersError: There is nobody left to do them, or a piece was lost too often.
            Exception: What doing or keeping one of them raised.
        """
        with self._lock:
            self._lock.wait_for(lambda: self._failed is not None or not self._done.isdisjoint(keys), timeout_s)
            if self._failed is not None:
                raise self._failed
            return frozenset(self._done.intersection(keys))

    def now(self) -> tuple[WorkerNow, ...]:
        """Who is at what."""
        with self._lock:
            now_s, found = time.monotonic(), {name: WorkerNow(name=name, key="") for name in self._names}
            for name in found.keys() & self._at.keys():
                task = self._at[name]
                found[name] = WorkerNow(name=name, key=task.work.key, for_s=now_s - task.since_s)
            return tuple(found.values())

    def _work(self) -> None:
        try:
            while not self._closing.is_set():
                self._give_out()
                for ended in self._workers.ended(_LOOK_S):
                    self._take_back(ended)
                self._hurry()
        except BaseException as error:
            with self._lock:
                self._failed = error
                self._lock.notify_all()

    def _give_out(self) -> None:
        names = self._workers.names()
        given = []
        with self._lock:
            self._names = names
            if names or not self._left:
                self._somebody_s = time.monotonic()
            elif time.monotonic() - self._somebody_s > self._nobody_s:
                raise WorkersError(f"no machine has been there to work for {self._nobody_s:.0f} s; start one; {_KEPT}")
            for name in names:
                if name not in self._at and (work := self._next_for(name, names)) is not None:
                    self._at[name] = _Task(work=work, since_s=time.monotonic())
                    given.append((name, work))
        for name, work in given:
            self._workers.begin(name, work)

    def _next_for(self, name: str, names: Sequence[str]) -> Work | None:
        """The next piece for a worker, but none that its machine has lost while there is another that has not."""
        own, all_of_them = _machine_of(name), {_machine_of(other) for other in names}
        for place, work in enumerate(self._left):
            lost_on = self._lost_on[work.key]
            if own not in lost_on or all_of_them <= lost_on:
                del self._left[place]
                return work
        return None

    def _take_back(self, ended: WorkEnd) -> None:
        task = self._at.pop(ended.worker)
        key = ended.key
        if key in self._done:
            return  # somebody else was faster
        if ended.error is not None:
            raise ended.error
        if ended.data is not None:
            self._keep(key, ended.data)
            with self._lock:
                self._longest_s = max(self._longest_s, time.monotonic() - task.since_s)
                self._done.add(key)
                self._left = deque(work for work in self._left if work.key != key)  # it was late, and came
                self._lock.notify_all()
            return
        if ended.counts and not task.late:
            self._deaths[key] += 1
            self._lost_on[key].add(_machine_of(ended.worker))
        if self._deaths[key] >= MOST_DEATHS:
            raise WorkersError(
                f"{key} was started {MOST_DEATHS} times and never finished; the last time on {ended.worker}, where "
                f"{ended.lost}; check disk space and memory; {_KEPT}"
            )
        if not task.late:
            with self._lock:
                self._left.appendleft(task.work)

    def _hurry(self) -> None:
        """Ask somebody else for what is late: a worker that hangs, or was stopped, holds its piece."""
        now_s = time.monotonic()
        for name, task in list(self._at.items()):
            key = task.work.key
            if task.late:
                if now_s - task.stopped_s > LATE * self._longest_s:  # it was not heard, or there was nobody yet to kill
                    task.stopped_s = now_s
                    self._workers.stop(name)
            elif now_s - task.since_s > LATE * self._longest_s * 2 ** self._times_late[key]:
                if key not in self._done:  # an earlier attempt may have come all the same
                    self._ask_again(name, task.work, now_s - task.since_s)
                task.late, task.stopped_s = True, now_s
                self._workers.stop(name)

    def _ask_again(self, name: str, work: Work, for_s: float) -> None:
        """Have a piece that is late done by somebody else."""
        if self._times_late[work.key] + 1 >= MOST_DEATHS:
            raise WorkersError(
                f"{work.key} was started {MOST_DEATHS} times and never finished, the last time on {name} within "
                f"{for_s:.0f} s; check what that machine is doing; {_KEPT}"
            )
        self._times_late[work.key] += 1
        self._lost_on[work.key].add(_machine_of(name))
        with self._lock:
            self._left.appendleft(work)


def _machine_of(worker: str) -> str:
    """The machine of a worker, as ADDRESS of ADDRESS/NUMBER; "" for a process of this one.

    >>> _machine_of("10.0.0.2/3"), _machine_of("process 1")
    ('10.0.0.2', '')
    """
    return worker.rpartition("/")[0]
