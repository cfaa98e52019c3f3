"""Sees to it that every piece of work is done: by whoever is free, in any order, and again if it was lost or is late.

It goes on in a thread of its own, so that workers have something to do while the network learns.
"""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, field
from typing import Final

from wcsim.errors import WorkersError
from wcsim.server.workers.machines import Work, WorkEnd, Workers

MOST_FAILURES: Final = (
    5  # deaths of workers at a piece, and times that it was late, before the run gives up
)
LATE: Final = 5.0  # times the longest piece so far: then its worker is killed, and it is done again
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
class _Piece:
    """A piece that was asked for."""

    work: Work
    failures: int = 0  # deaths of workers at it, and times that it was late
    times_late: int = 0
    lost_on: set[str] = field(default_factory=set)  # the machines of these workers


@dataclass(slots=True, kw_only=True)
class _Task:
    """A piece that somebody is at."""

    piece: _Piece
    since_s: float
    stopped_s: float = 0.0  # when its worker was last told to be killed: it was late, and somebody else has the piece


class Crew:
    """Workers, and the work that is left; a context manager.

    Args:
        workers: Who does it; closed with the crew.
        keep: Where what comes back goes.
        least_late_s: No piece is late before that.
        nobody_s: So long it is waited for a first worker.
    """

    def __init__(
        self,
        workers: Workers,
        keep: Keep,
        *,
        least_late_s: float = LEAST_LATE_S,
        nobody_s: float = NOBODY_S,
    ) -> None:
        self._workers, self._keep, self._nobody_s = workers, keep, nobody_s
        self._longest_s = least_late_s / LATE
        self._left: deque[_Piece] = deque()
        self._at: dict[str, _Task] = {}
        self._asked: set[str] = set()
        self._done: set[str] = set()
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
                    self._left.append(_Piece(work=work))

    def come(self, keys: Collection[str], timeout_s: float) -> frozenset[str]:
        """Those of the pieces that are done; waits a while for one of them.

        Raises:
            WorkersError: There is nobody left to do them, or a piece was lost too often.
            Exception: What doing or keeping one of them raised.
        """
        with self._lock:
            self._lock.wait_for(
                lambda: self._failed is not None or not self._done.isdisjoint(keys), timeout_s
            )
            if self._failed is not None:
                raise self._failed
            return frozenset(self._done.intersection(keys))

    def now(self) -> tuple[WorkerNow, ...]:
        """Who is at what."""
        with self._lock:
            now_s, found = (
                time.monotonic(),
                {name: WorkerNow(name=name, key="") for name in self._names},
            )
            for name in found.keys() & self._at.keys():
                task = self._at[name]
                found[name] = WorkerNow(
                    name=name, key=task.piece.work.key, for_s=now_s - task.since_s
                )
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
                raise WorkersError(
                    f"no machine has been there to work for {self._nobody_s:.0f} s; start one; {_KEPT}"
                )
            for name in names:
                if name not in self._at and (piece := self._next_for(name, names)) is not None:
                    self._at[name] = _Task(piece=piece, since_s=time.monotonic())
                    given.append((name, piece.work))
        for name, work in given:
            self._workers.begin(name, work)

    def _next_for(self, name: str, names: Sequence[str]) -> _Piece | None:
        """The next piece for a worker, but none that its machine has lost while there is another that has not."""
        own, all_of_them = _machine_of(name), {_machine_of(other) for other in names}
        for place, piece in enumerate(self._left):
            if own not in piece.lost_on or all_of_them <= piece.lost_on:
                del self._left[place]
                return piece
        return None

    def _take_back(self, ended: WorkEnd) -> None:
        task = self._at.pop(ended.worker)
        if task.stopped_s:
            return  # whatever it is: somebody else has the piece
        if ended.error is not None:
            raise ended.error
        if ended.data is not None:
            self._keep(ended.key, ended.data)
            with self._lock:
                self._longest_s = max(self._longest_s, time.monotonic() - task.since_s)
                self._done.add(ended.key)
                self._lock.notify_all()
        elif ended.counts:
            self._fail(task.piece, ended.worker, f"{ended.lost}; check disk space and memory")
        else:
            self._do_again(task.piece)

    def _hurry(self) -> None:
        """Give up what is late: a worker that hangs, or was stopped, holds its piece."""
        now_s, late_s = time.monotonic(), LATE * self._longest_s
        for name, task in list(self._at.items()):
            for_s, piece = now_s - task.since_s, task.piece
            if task.stopped_s:
                if now_s - task.stopped_s <= late_s:
                    continue
            elif for_s <= late_s * 2**piece.times_late:
                continue
            else:
                piece.times_late += 1
                self._fail(
                    piece,
                    name,
                    f"it was not done within {for_s:.0f} s; check what that machine is doing",
                )
            task.stopped_s = now_s
            self._workers.stop(
                name
            )  # and again while it was not heard, or there was nobody yet to kill

    def _fail(self, piece: _Piece, worker: str, why: str) -> None:
        piece.failures += 1
        piece.lost_on.add(_machine_of(worker))
        if piece.failures >= MOST_FAILURES:
            raise WorkersError(
                f"{piece.work.key} was started {MOST_FAILURES} times and never finished; the last time on {worker}, "
                f"where {why}; {_KEPT}"
            )
        self._do_again(piece)

    def _do_again(self, piece: _Piece) -> None:
        with self._lock:
            self._left.appendleft(piece)


def _machine_of(worker: str) -> str:
    """The machine of a worker, as ADDRESS of ADDRESS/NUMBER; "" for a process of this one.

    >>> _machine_of("10.0.0.2/3"), _machine_of("process 1")
    ('10.0.0.2', '')
    """
    return worker.rpartition("/")[0]
