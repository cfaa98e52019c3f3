"""Gives pieces of work to workers, in any order, until each is done; again if it is lost or late.

It runs in a thread of its own, so that workers have something to do while the network learns.
"""

import threading
import time
from collections import deque
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, field
from typing import Final, Self

from wcsim.errors import WorkersError
from wcsim.server.workers.machines import WorkerPool, WorkPiece, WorkResult, machine_from_worker

MOST_FAILURES: Final = 5
"""Deaths of workers at a piece, and times that it was late, before the run gives up."""
LEAST_LATE_S: Final = 180.0
# A piece is late after this many times the longest one so far.
_LATE_FACTOR: Final = 5.0
_NO_WORKER_S: Final = 600.0
_POLL_S: Final = 0.1
_CONTINUE: Final = (
    "finished work is saved: continue (a training: wcsim resume RUN; a test: --resume)"
)

Store = Callable[[str, bytes], object]
"""Called, in the scheduler's thread, with the key and data of each piece that is done."""


@dataclass(frozen=True, slots=True, kw_only=True)
class WorkerStatus:
    """A worker, and its piece."""

    name: str
    key: str  # "" for nothing
    for_s: float = 0.0


@dataclass(slots=True, kw_only=True)
class _Piece:
    work: WorkPiece
    failures: int = 0  # deaths of workers at it, and times that it was late
    times_late: int = 0
    lost_on: set[str] = field(default_factory=set)  # the machines of these workers


@dataclass(slots=True, kw_only=True)
class _Task:
    """A piece that a worker has."""

    piece: _Piece
    since_s: float
    # When its worker was last killed: the piece was late, and another worker has it. 0 for never.
    stopped_s: float = 0.0


class WorkScheduler:
    """Workers, and the work that is left; a context manager.

    Args:
        workers: Closed with the scheduler.
        store: Takes the results.
        least_late_s: No piece is late before that.
        no_worker_s: Time without any worker before the run gives up.
    """

    def __init__(
        self,
        workers: WorkerPool,
        store: Store,
        *,
        least_late_s: float = LEAST_LATE_S,
        no_worker_s: float = _NO_WORKER_S,
    ) -> None:
        self._workers = workers
        self._store = store
        self._no_worker_s = no_worker_s
        self._longest_s = least_late_s / _LATE_FACTOR
        self._waiting: deque[_Piece] = deque()
        self._running: dict[str, _Task] = {}  # by worker
        self._submitted: set[str] = set()
        self._done: set[str] = set()
        self._failure: BaseException | None = None
        self._last_worker_s = time.monotonic()  # or when there was last no work for one
        self._names: tuple[str, ...] = ()
        self._lock = threading.Condition()
        self._closing = threading.Event()
        self._thread = threading.Thread(target=self._run, name="scheduler", daemon=True)

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, *exception: object) -> None:
        self._closing.set()
        self._thread.join()
        self._workers.close()

    def submit(self, works: Sequence[WorkPiece]) -> None:
        """Have these done, after those submitted before; a key that was submitted is left out."""
        with self._lock:
            for work in works:
                if work.key not in self._submitted:
                    self._submitted.add(work.key)
                    self._waiting.append(_Piece(work=work))

    def wait(self, keys: Collection[str], timeout_s: float) -> frozenset[str]:
        """Those of the pieces that are done; waits a while for one of them.

        Raises:
            WorkersError: There is no worker left, or a piece was lost too often.
            Exception: One that a piece, or storing its result, raised.
        """
        with self._lock:
            self._lock.wait_for(
                lambda: self._failure is not None or not self._done.isdisjoint(keys), timeout_s
            )
            if self._failure is not None:
                raise self._failure
            return frozenset(self._done.intersection(keys))

    def workers_now(self) -> tuple[WorkerStatus, ...]:
        """Each worker, and its piece."""
        with self._lock:
            now_s = time.monotonic()
            found = []
            for name in self._names:
                task = self._running.get(name)
                if task is None:
                    found.append(WorkerStatus(name=name, key=""))
                else:
                    key = task.piece.work.key
                    found.append(WorkerStatus(name=name, key=key, for_s=now_s - task.since_s))
            return tuple(found)

    def _run(self) -> None:
        try:
            while not self._closing.is_set():
                self._assign()
                for result in self._workers.collect(_POLL_S):
                    self._settle(result)
                self._stop_late()
        except BaseException as error:
            with self._lock:
                self._failure = error
                self._lock.notify_all()

    def _assign(self) -> None:
        """Give each free worker a piece."""
        names = self._workers.names()
        assigned = []
        with self._lock:
            self._names = names
            if names or not self._waiting:
                self._last_worker_s = time.monotonic()
            elif time.monotonic() - self._last_worker_s > self._no_worker_s:
                raise WorkersError(
                    f"no machine has been there to work for {self._no_worker_s:.0f} s; start one; "
                    f"{_CONTINUE}"
                )
            for name in names:
                if name not in self._running and (piece := self._take_piece(name, names)):
                    self._running[name] = _Task(piece=piece, since_s=time.monotonic())
                    assigned.append((name, piece.work))
        for name, work in assigned:
            self._workers.begin(name, work)

    def _take_piece(self, name: str, names: Sequence[str]) -> _Piece | None:
        """The next piece for a worker.

        None that its machine has lost, unless all machines have.
        """
        own = machine_from_worker(name)
        machines = {machine_from_worker(other) for other in names}
        for index, piece in enumerate(self._waiting):
            if own not in piece.lost_on or machines <= piece.lost_on:
                del self._waiting[index]
                return piece
        return None

    def _settle(self, result: WorkResult) -> None:
        """Store a result, or have its piece done again."""
        task = self._running.pop(result.worker)
        if task.stopped_s:
            # Whatever the result is: the piece was given to another worker.
            return
        if result.error is not None:
            raise result.error
        if result.data is not None:
            self._store(result.key, result.data)
            with self._lock:
                self._longest_s = max(self._longest_s, time.monotonic() - task.since_s)
                self._done.add(result.key)
                self._lock.notify_all()
        elif result.counts:
            self._fail(task.piece, result.worker, f"{result.lost}; check disk space and memory")
        else:
            self._do_again(task.piece)

    def _stop_late(self) -> None:
        """Have late pieces done again: their workers hang, or a signal stopped them."""
        now_s = time.monotonic()
        late_s = _LATE_FACTOR * self._longest_s
        for name, task in list(self._running.items()):
            for_s = now_s - task.since_s
            piece = task.piece
            if task.stopped_s:
                # Kill it again after a while: the order may be lost, or there was no process yet.
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
            self._workers.stop(name)

    def _fail(self, piece: _Piece, worker: str, why: str) -> None:
        piece.failures += 1
        piece.lost_on.add(machine_from_worker(worker))
        if piece.failures >= MOST_FAILURES:
            raise WorkersError(
                f"{piece.work.key} was started {MOST_FAILURES} times and never finished; the last "
                f"time on {worker}, where {why}; {_CONTINUE}"
            )
        self._do_again(piece)

    def _do_again(self, piece: _Piece) -> None:
        with self._lock:
            self._waiting.appendleft(piece)
